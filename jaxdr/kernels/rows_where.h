// The numbers of the rows where a mask is true, in order, then a number that fills the rest: counted, then written.

#define MOST_TASKS 64

struct Compaction {
  const unsigned char* mask;
  int* out;
  int64_t rows, size, share;
  int64_t before[MOST_TASKS + 1];  // first how many rows each task has, then how many come before it
};

static int64_t end_of(const Compaction* c, int64_t task) {
  const int64_t end = (task + 1) * c->share;
  return end < c->rows ? end : c->rows;
}
static void count_rows(void* data, int64_t task) {
  Compaction* c = (Compaction*)data;
  const int64_t end = end_of(c, task);
  int64_t i = task * c->share, found = 0;
  for (; i + 8 <= end; i += 8) {  // a true byte is 1
    uint64_t eight;
    __builtin_memcpy(&eight, c->mask + i, 8);
    found += __builtin_popcountll(eight);
  }
  for (; i < end; i++) found += c->mask[i];
  c->before[task] = found;
}
static void write_rows(void* data, int64_t task) {
  Compaction* c = (Compaction*)data;
  const int64_t end = end_of(c, task);
  int64_t place = c->before[task];
  for (int64_t i = task * c->share; i < end && place < c->size; i++)
    if (c->mask[i]) c->out[place++] = (int)i;
}

extern "C" XLA_FFI_Error* jaxdr_handler(XLA_FFI_CallFrame* f) {
  if (is_question(f)) return nullptr;
  Compaction c;
  c.mask = (const unsigned char*)argument(f, 0)->data;
  c.rows = argument(f, 0)->dims[0];
  c.out = (int*)result(f, 0)->data;
  c.size = result(f, 0)->dims[0];
  const int fill = (int)number(f, 0);
  c.share = (c.rows + MOST_TASKS - 1) / MOST_TASKS;
  if (c.share < 4096) c.share = 4096;
  const int64_t tasks = (c.rows + c.share - 1) / c.share;
  in_parallel(f, tasks, &count_rows, &c);
  int64_t total = 0;
  for (int64_t task = 0; task < tasks; task++) {
    const int64_t found = c.before[task];
    c.before[task] = total;
    total += found;
  }
  in_parallel(f, tasks, &write_rows, &c);
  for (int64_t i = total; i < c.size; i++) c.out[i] = fill;
  return nullptr;
}
