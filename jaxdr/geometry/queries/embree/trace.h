// Ray queries as XLA calls them: the tree of a mesh is found by the mesh's content, and rays are divided over threads.

// Trees that are there. Python owns the table, and changes it only while `writing`.
struct Tree {
  const float* vertices;
  const int* faces;
  int64_t vertex_count, face_count;
  void* scene;   // RTCScene
  int64_t used;  // a later use has a larger number
};
static Tree* trees;
static int64_t tree_count, uses;
static int (*build)(const float*, int64_t, const int*, int64_t);  // Python: add a tree to the table
static void (*intersect)(void* scene, void* ray, void* arguments);
static void (*occlude)(void* scene, void* ray, void* arguments);

extern "C" void jaxdr_set_functions(void* b, void* i, void* o) {
  build = (int (*)(const float*, int64_t, const int*, int64_t))b;
  intersect = (void (*)(void*, void*, void*))i;
  occlude = (void (*)(void*, void*, void*))o;
}
extern "C" void jaxdr_set_trees(Tree* table, int64_t count) {
  trees = table;
  tree_count = count;
}

// Calls that read the table, and -1 while it is written.
static int64_t readers;
static void reading() {
  for (int turn = 0;; turn++) {
    int64_t now = __atomic_load_n(&readers, __ATOMIC_RELAXED);
    if (now >= 0 && __atomic_compare_exchange_n(&readers, &now, now + 1, true, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED)) return;
    wait_a_little(turn);
  }
}
static void read() { __atomic_fetch_sub(&readers, 1, __ATOMIC_RELEASE); }
extern "C" void jaxdr_writing() {
  for (int turn = 0;; turn++) {
    int64_t nobody = 0;
    if (__atomic_compare_exchange_n(&readers, &nobody, -1, true, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED)) return;
    wait_a_little(turn);
  }
}
extern "C" void jaxdr_written() { __atomic_store_n(&readers, 0, __ATOMIC_RELEASE); }

static bool same(const int* a, const int* b, int64_t count) {
  int differ = 0;
  for (int64_t i = 0; i < count && !differ; i += 1024)
    for (int64_t k = i; k < (i + 1024 < count ? i + 1024 : count); k++) differ |= a[k] ^ b[k];
  return !differ;
}

struct Query {
  void* scene;
  const float *origin, *direction, *reach;
  int *face;
  float *t, *barycentric;
  unsigned char* occluded;
  int64_t rays;
};

#define TASK_RAYS 1024

// RTCRayHit of Embree 4, which begins with RTCRay.
struct alignas(16) RayHit {
  float origin[3], tnear, direction[3], time, tfar;
  unsigned mask, id, flags;
  float normal[3], u, v;
  unsigned prim, geom, inst, inst_prim;
};

static void trace(void* query, int64_t task) {
  const Query* q = (const Query*)query;
  const int64_t first = task * TASK_RAYS, last = first + TASK_RAYS < q->rays ? first + TASK_RAYS : q->rays;
  for (int64_t i = first; i < last; i++) {
    RayHit ray;
    for (int d = 0; d < 3; d++) {
      ray.origin[d] = q->origin[3 * i + d];
      ray.direction[d] = q->direction[3 * i + d];
    }
    ray.tnear = ray.time = 0.0f;
    ray.tfar = q->reach[i];
    ray.mask = ~0u;
    ray.id = ray.flags = 0;
    ray.prim = ray.geom = ray.inst = ray.inst_prim = ~0u;
    const bool there = ray.tfar > 0.0f;
    if (q->occluded) {
      if (there) occlude(q->scene, &ray, nullptr);
      q->occluded[i] = there && ray.tfar < 0.0f;  // Embree marks rays that something lies on
      continue;
    }
    if (there) intersect(q->scene, &ray, nullptr);
    const bool hit = ray.geom != ~0u;
    q->face[i] = hit ? (int)ray.prim : -1;
    q->t[i] = hit ? ray.tfar : 3.0e38f;
    // Rounding may put a hit outside of its face.
    const float u = hit ? ray.u : 1.0f / 3.0f, v = hit ? ray.v : 1.0f / 3.0f;
    const float a = u + v < 1.0f ? 1.0f - u - v : 0.0f, b = u > 0.0f ? u : 0.0f, c = v > 0.0f ? v : 0.0f;
    const float sum = a + b + c;
    q->barycentric[3 * i] = a / sum;
    q->barycentric[3 * i + 1] = b / sum;
    q->barycentric[3 * i + 2] = c / sum;
  }
}

static XLA_FFI_Error* answer(XLA_FFI_CallFrame* f, Query q) {
  const float* vertices = (const float*)argument(f, 0)->data;
  const int* faces = (const int*)argument(f, 1)->data;
  const int64_t vertex_count = argument(f, 0)->dims[0], face_count = argument(f, 1)->dims[0];
  q.origin = (const float*)argument(f, 2)->data;
  q.direction = (const float*)argument(f, 3)->data;
  q.reach = (const float*)argument(f, 4)->data;
  q.rays = argument(f, 4)->dims[0];
  for (;;) {
    reading();
    Tree* found = nullptr;
    for (int64_t i = 0; i < tree_count && !found; i++) {
      Tree* tree = trees + i;
      if (tree->vertex_count == vertex_count && tree->face_count == face_count &&
          same((const int*)tree->vertices, (const int*)vertices, 3 * vertex_count) &&
          same(tree->faces, faces, 3 * face_count))
        found = tree;
    }
    if (found) {
      __atomic_store_n(&found->used, __atomic_add_fetch(&uses, 1, __ATOMIC_RELAXED), __ATOMIC_RELAXED);
      q.scene = found->scene;
      break;
    }
    read();
    if (build(vertices, vertex_count, faces, face_count)) {
      XLA_FFI_Error_Create_Args error = {sizeof error, nullptr, "jaxdr: Embree's tree of a mesh can't be built",
                                         XLA_FFI_Error_Code_INTERNAL};
      return f->api->XLA_FFI_Error_Create(&error);
    }
  }
  in_parallel(f, (q.rays + TASK_RAYS - 1) / TASK_RAYS, &trace, &q);
  read();
  return nullptr;
}

extern "C" XLA_FFI_Error* jaxdr_closest_hit(XLA_FFI_CallFrame* f) {
  if (is_question(f)) return nullptr;
  Query q = {};
  q.face = (int*)result(f, 0)->data;
  q.t = (float*)result(f, 1)->data;
  q.barycentric = (float*)result(f, 2)->data;
  return answer(f, q);
}
extern "C" XLA_FFI_Error* jaxdr_occluded(XLA_FFI_CallFrame* f) {
  if (is_question(f)) return nullptr;
  Query q = {};
  q.occluded = (unsigned char*)result(f, 0)->data;
  return answer(f, q);
}
