// What a kernel tells the handler that all kernels share.

union Sums { float* floats; int* ints; };

struct Kernel {
  void (*body)(const char* const* P, const int64_t* const* D, char* const* R, Sums* S, const int64_t* T, int64_t rows,
               int64_t start, int64_t end);
  int64_t reads, writes, sums, width;
  const bool* whole;  // of each sum: whether it is of integers
};
