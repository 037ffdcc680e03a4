// Work divided between the threads of XLA, in calls from XLA that end when all of it is done.

extern "C" {
void* malloc(size_t);
void free(void*);
#if defined(__linux__) || defined(__APPLE__)
int sched_yield();
#endif
}

struct Work {
  void (*run)(void* data, int64_t task);
  void* data;
  int64_t tasks, next, done, users;
};

// Do tasks until none is left. Data is not touched after the last task: it may be gone.
static void take_tasks(Work* w) {
  for (int64_t task; (task = __atomic_fetch_add(&w->next, 1, __ATOMIC_RELAXED)) < w->tasks;) {
    w->run(w->data, task);
    __atomic_fetch_add(&w->done, 1, __ATOMIC_RELEASE);
  }
}
static void leave(Work* w) {
  if (__atomic_sub_fetch(&w->users, 1, __ATOMIC_ACQ_REL) == 0) free(w);
}
static void help(void* w) {
  take_tasks((Work*)w);
  leave((Work*)w);
}

static bool failed(const XLA_FFI_Api* api, XLA_FFI_Error* error) {
  if (!error) return false;
  XLA_FFI_Error_Destroy_Args destroy = {sizeof destroy, nullptr, error};
  api->XLA_FFI_Error_Destroy(&destroy);
  return true;
}

static void wait_a_little(int turn) {
#if defined(__linux__) || defined(__APPLE__)
  if (turn > 1000) {  // a helper has lost its core
    sched_yield();
    return;
  }
#endif
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

static void in_parallel(XLA_FFI_CallFrame* f, int64_t tasks, void (*run)(void*, int64_t), void* data) {
  if (tasks < 1) return;
  int64_t threads = 1;
  XLA_FFI_ThreadPool_NumThreads_Args count = {sizeof count, nullptr, f->ctx, &threads};
  if (failed(f->api, f->api->XLA_FFI_ThreadPool_NumThreads(&count))) threads = 1;  // there is no pool
  const int64_t helpers = (threads < tasks ? threads : tasks) - 1;
  Work* w = (Work*)malloc(sizeof(Work));
  *w = Work{run, data, tasks, 0, 0, helpers + 1};
  for (int64_t i = 0; i < helpers; i++) {
    XLA_FFI_ThreadPool_Schedule_Args schedule = {sizeof schedule, nullptr, f->ctx, &help, w};
    if (failed(f->api, f->api->XLA_FFI_ThreadPool_Schedule(&schedule))) leave(w);
  }
  take_tasks(w);
  for (int turn = 0; __atomic_load_n(&w->done, __ATOMIC_ACQUIRE) < tasks; turn++) wait_a_little(turn);
  leave(w);
}

// XLA asks a handler for its version before the first call.
static bool is_question(XLA_FFI_CallFrame* f) {
  if (!f->extension_start || f->extension_start->type != XLA_FFI_Extension_Metadata) return false;
  XLA_FFI_Metadata* m = ((XLA_FFI_Metadata_Extension*)f->extension_start)->metadata;
  m->api_version.major_version = XLA_FFI_API_MAJOR;
  m->api_version.minor_version = XLA_FFI_API_MINOR;
  m->traits = 0;
  return true;
}
static XLA_FFI_Buffer* argument(XLA_FFI_CallFrame* f, int i) { return (XLA_FFI_Buffer*)f->args.args[i]; }
static XLA_FFI_Buffer* result(XLA_FFI_CallFrame* f, int i) { return (XLA_FFI_Buffer*)f->rets.rets[i]; }
// An attribute that is a whole number; attributes come in the order of their names.
static int64_t number(XLA_FFI_CallFrame* f, int i) {
  return *(int64_t*)((XLA_FFI_Scalar*)f->attrs.attrs[i])->value;
}
