// Running sums along one axis of an array. Sums of floats are kept in double, so they do not lose small numbers.

template <typename T, typename Total>
static void running_sums(const T* from, T* to, int64_t count, int64_t length, int64_t inner, bool reverse) {
  for (int64_t i = 0; i < count; i++) {
    const int64_t first = i / inner * length * inner + i % inner;
    Total total = 0;
    for (int64_t k = 0; k < length; k++) {
      const int64_t at = first + (reverse ? length - 1 - k : k) * inner;
      total += (Total)from[at];
      to[at] = (T)total;
    }
  }
}

extern "C" XLA_FFI_Error* jaxdr_handler(XLA_FFI_CallFrame* f) {
  if (is_question(f)) return nullptr;
  const XLA_FFI_Buffer* given = argument(f, 0);
  const int64_t axis = number(f, 0), reverse = number(f, 1);
  int64_t count = 1, inner = 1;
  for (int64_t d = 0; d < given->rank; d++)
    if (d != axis) count *= given->dims[d];
  for (int64_t d = axis + 1; d < given->rank; d++) inner *= given->dims[d];
  const int64_t length = given->dims[axis];
  void* to = result(f, 0)->data;
  if (given->dtype == XLA_FFI_DataType_F32)
    running_sums<float, double>((const float*)given->data, (float*)to, count, length, inner, reverse);
  else  // whole numbers wrap around
    running_sums<unsigned, unsigned>((const unsigned*)given->data, (unsigned*)to, count, length, inner, reverse);
  return nullptr;
}
