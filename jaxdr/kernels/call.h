// A kernel as XLA calls it: operands, tasks, and sums in an order that does not depend on the threads.

// Rows are divided into tasks. Tasks of kernels with sums have sums of their own, which are added in order.
#define TASK_ROWS 2048
#define SUM_TASKS 16
#define ARRAY(type, count) ((type*)__builtin_alloca(sizeof(type) * (size_t)(count)))

struct Call {
  const Kernel* kernel;
  const char** P;
  const int64_t** D;
  char** R;
  int64_t *T, *size;
  char* sums;  // of all tasks
  int64_t task_size, rows, task_rows;
};

static void clear(char* p, int64_t bytes) { __builtin_memset(p, 0, bytes); }

static void run(void* call, int64_t task) {
  const Call* c = (Call*)call;
  const int64_t start = task * c->task_rows, end = start + c->task_rows < c->rows ? start + c->task_rows : c->rows;
  Sums* own = ARRAY(Sums, c->kernel->sums);
  if (c->kernel->sums) {
    char* p = c->sums + task * c->task_size;
    clear(p, c->task_size);
    for (int64_t k = 0; k < c->kernel->sums; k++) {
      own[k].floats = (float*)p;
      p += 4 * c->size[k];
    }
  }
  c->kernel->body(c->P, c->D, c->R, own, c->T, c->rows, start, end);
}

extern "C" XLA_FFI_Error* jaxdr_run(XLA_FFI_CallFrame* f, const Kernel* kernel) {
  if (is_question(f)) return nullptr;
  const int64_t reads = kernel->reads, writes = kernel->writes, sums = kernel->sums;
  Call c = {kernel, ARRAY(const char*, reads), ARRAY(const int64_t*, reads), ARRAY(char*, writes),
            ARRAY(int64_t, sums), ARRAY(int64_t, sums)};
  for (int i = 0; i < reads; i++) {
    c.P[i] = (const char*)argument(f, i)->data;
    c.D[i] = argument(f, i)->dims;
  }
  for (int i = 0; i < writes; i++) c.R[i] = (char*)result(f, i)->data;
  c.rows = number(f, 0);
  c.task_rows = TASK_ROWS;
  if (sums) {
    const int64_t share = (c.rows + SUM_TASKS - 1) / SUM_TASKS;
    c.task_rows = (share + kernel->width - 1) / kernel->width * kernel->width;
    for (int k = 0; k < sums; k++) {
      XLA_FFI_Buffer* b = result(f, writes + k);
      c.size[k] = 1;
      for (int64_t d = 0; d < b->rank; d++) c.size[k] *= b->dims[d];
      c.T[k] = b->rank ? b->dims[0] : 1;
      c.task_size += 4 * c.size[k];
    }
  }
  const int64_t tasks = (c.rows + c.task_rows - 1) / c.task_rows;
  if (sums) c.sums = (char*)malloc(c.task_size * tasks);
  in_parallel(f, tasks, &run, &c);
  int64_t place = 0;
  for (int k = 0; k < sums; k++) {
    char* out = (char*)result(f, writes + k)->data;
    clear(out, 4 * c.size[k]);
    for (int64_t task = 0; task < tasks; task++) {
      const char* part = c.sums + task * c.task_size + place;
      if (kernel->whole[k])
        for (int64_t i = 0; i < c.size[k]; i++) ((int*)out)[i] += ((const int*)part)[i];
      else
        for (int64_t i = 0; i < c.size[k]; i++) ((float*)out)[i] += ((const float*)part)[i];
    }
    place += 4 * c.size[k];
  }
  free(c.sums);
  return nullptr;
}
