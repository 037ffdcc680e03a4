// Keys that follow from a key, as `jaxdr.transport.keys` derives them: split, or with a number folded in.

static void mix(unsigned* w) {
  w[0] += w[1] * w[3];
  w[1] += w[2] * w[0];
  w[2] += w[0] * w[1];
  w[3] += w[1] * w[2];
}
static void derive(const unsigned* key, unsigned number, unsigned purpose, unsigned* out) {
  unsigned w[4] = {key[0] + number, key[1], key[2], key[3] ^ purpose};
  for (int i = 0; i < 4; i++) w[i] = w[i] * 1664525u + 1013904223u;
  mix(w);
  for (int i = 0; i < 4; i++) w[i] ^= w[i] >> 16;
  mix(w);
  for (int i = 0; i < 4; i++) out[i] = w[i] % (w[i] | 0xffff0000u);
}

extern "C" XLA_FFI_Error* jaxdr_handler(XLA_FFI_CallFrame* f) {
  if (is_question(f)) return nullptr;
  const unsigned* key = (const unsigned*)argument(f, 0)->data;
  unsigned* out = (unsigned*)result(f, 0)->data;
  if (f->args.size > 1) {
    derive(key, *(const unsigned*)argument(f, 1)->data, 0x85ebca6bu, out);
    return nullptr;
  }
  int64_t count = 1;
  for (int64_t d = 0; d < result(f, 0)->rank - 1; d++) count *= result(f, 0)->dims[d];
  for (int64_t i = 0; i < count; i++) derive(key, (unsigned)i, 0x9e3779b9u, out + 4 * i);
  return nullptr;
}
