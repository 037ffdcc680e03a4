// Vectors of rows, and functions of them, for the machine that compiles this. Lanes are rows.

#if defined(__AVX512F__) && defined(__AVX512DQ__)
#define WIDTH 16
#elif defined(__AVX2__)
#define WIDTH 8
#else
#define WIDTH 4
#endif

typedef float F __attribute__((ext_vector_type(WIDTH)));
typedef double D __attribute__((ext_vector_type(WIDTH)));
typedef int I __attribute__((ext_vector_type(WIDTH)));
typedef unsigned U __attribute__((ext_vector_type(WIDTH)));
typedef long long L __attribute__((ext_vector_type(WIDTH)));
typedef I B;
typedef float Fu __attribute__((ext_vector_type(WIDTH), aligned(4)));
typedef int Iu __attribute__((ext_vector_type(WIDTH), aligned(4)));
typedef unsigned Uu __attribute__((ext_vector_type(WIDTH), aligned(4)));
typedef unsigned char Bytes __attribute__((ext_vector_type(WIDTH), aligned(1)));
#define ELEMENTWISE(name) __builtin_elementwise_##name
#define EACH_LANE for (int l = 0; l < WIDTH; l++)
#define APART static __attribute__((noinline))
#define HERE static inline __attribute__((always_inline))

extern "C" {
float fmodf(float, float); float powf(float, float); float atan2f(float, float);
float log1pf(float); float expm1f(float); float sinf(float); float cosf(float); float tanf(float); float tanhf(float);
float asinf(float); float acosf(float); float atanf(float); float erff(float); float cbrtf(float);
}

HERE I lanes() {
  I r;
  EACH_LANE r[l] = l;
  return r;
}

// Memory: contiguous rows, rows at a distance, and entries of tables.

HERE F load_F(const float* p) { return *(const Fu*)p; }
HERE I load_I(const int* p) { return *(const Iu*)p; }
HERE U load_U(const unsigned* p) { return *(const Uu*)p; }
HERE B load_B(const unsigned char* p) { return __builtin_convertvector(*(const Bytes*)p, I) != I(0); }
HERE void store_F(float* p, F v) { *(Fu*)p = v; }
HERE void store_I(int* p, I v) { *(Iu*)p = v; }
HERE void store_U(unsigned* p, U v) { *(Uu*)p = v; }
HERE void store_B(unsigned char* p, B v) { *(Bytes*)p = __builtin_convertvector(v & I(1), Bytes); }

// Entries of tables. On AVX2 eight scalar loads are 2.4 times as fast as a gather instruction (AMD), so the places are
// written to memory once for all components.
#if WIDTH == 16
typedef float F16 __attribute__((vector_size(64)));
typedef int I16 __attribute__((vector_size(64)));
typedef I Places;
HERE Places placed(I i) { return i; }
HERE F gather_F(const float* p, Places i) {
  return (F)__builtin_ia32_gathersiv16sf((F16)F(0.0f), p, (I16)i, (unsigned short)-1, 4);
}
HERE I gather_I(const int* p, Places i) {
  return (I)__builtin_ia32_gathersiv16si((I16)I(0), p, (I16)i, (unsigned short)-1, 4);
}
APART B gather_B(const unsigned char* p, Places i) { B r; EACH_LANE r[l] = p[i[l]] ? -1 : 0; return r; }
#else
struct alignas(4 * WIDTH) Places { int of[WIDTH]; };
HERE Places placed(I i) { Places k; *(I*)k.of = i; return k; }
#if WIDTH == 8
#define AT_PLACES(p, k) {p[k.of[0]], p[k.of[1]], p[k.of[2]], p[k.of[3]], p[k.of[4]], p[k.of[5]], p[k.of[6]], p[k.of[7]]}
#else
#define AT_PLACES(p, k) {p[k.of[0]], p[k.of[1]], p[k.of[2]], p[k.of[3]]}
#endif
HERE F gather_F(const float* p, const Places& k) { return F AT_PLACES(p, k); }
HERE I gather_I(const int* p, const Places& k) { return I AT_PLACES(p, k); }
HERE B gather_B(const unsigned char* p, const Places& k) { return I AT_PLACES(p, k) != I(0); }
#endif
HERE U gather_U(const unsigned* p, const Places& k) { return (U)gather_I((const int*)p, k); }

APART void scatter_F(float* p, int step, F v) { EACH_LANE p[l * step] = v[l]; }
HERE void scatter_I(int* p, int step, I v) { scatter_F((float*)p, step, (F)v); }
HERE void scatter_U(unsigned* p, int step, U v) { scatter_F((float*)p, step, (F)v); }
APART void scatter_B(unsigned char* p, int step, B v) { EACH_LANE p[l * step] = v[l] != 0; }
// Lanes in order: rows may share an entry.
APART void add_F(float* p, I i, F v) { EACH_LANE p[i[l]] += v[l]; }
APART void add_I(int* p, I i, I v) { EACH_LANE p[i[l]] += v[l]; }
APART float total_F(F v) { float s = 0.0f; EACH_LANE s += v[l]; return s; }
APART int total_I(I v) { int s = 0; EACH_LANE s += v[l]; return s; }

// Choices and comparisons. NaN stays NaN.

HERE F v_select(B c, F a, F b) { return c ? a : b; }
HERE I v_select(B c, I a, I b) { return c ? a : b; }
HERE U v_select(B c, U a, U b) { return c ? a : b; }
HERE F v_max(F a, F b) { return a != a ? a : (a > b ? a : b); }
HERE F v_min(F a, F b) { return a != a ? a : (a < b ? a : b); }
HERE I v_max(I a, I b) { return ELEMENTWISE(max)(a, b); }
HERE I v_min(I a, I b) { return ELEMENTWISE(min)(a, b); }
HERE U v_max(U a, U b) { return ELEMENTWISE(max)(a, b); }
HERE U v_min(U a, U b) { return ELEMENTWISE(min)(a, b); }
HERE F v_sign(F a) { return a > F(0.0f) ? F(1.0f) : (a < F(0.0f) ? F(-1.0f) : a); }
HERE I v_sign(I a) { return a > I(0) ? I(1) : (a < I(0) ? I(-1) : I(0)); }
HERE U v_sign(U a) { return a > U(0) ? U(1) : U(0); }

// Whole numbers, with XLA's answers where C++ has none.

HERE I v_div(I a, I b) {
  const B zero = b == I(0), whole = a == I(1 << 31) & b == I(-1);
  const I q = a / (zero | whole ? I(1) : b);
  return zero ? I(-1) : q;
}
HERE U v_div(U a, U b) { const B zero = b == U(0); return zero ? U(~0u) : a / (zero ? U(1) : b); }
HERE I v_rem(I a, I b) {
  const B zero = b == I(0), whole = a == I(1 << 31) & b == I(-1);
  const I r = a % (zero | whole ? I(1) : b);
  return zero ? a : r;
}
HERE U v_rem(U a, U b) { const B zero = b == U(0); return zero ? a : a % (zero ? U(1) : b); }
APART F v_rem(F a, F b) { F r; EACH_LANE r[l] = fmodf(a[l], b[l]); return r; }
HERE U v_shift_left(U a, U b) { return b < U(32) ? a << (b & U(31)) : U(0); }
HERE I v_shift_left(I a, I b) { return (I)v_shift_left((U)a, (U)b); }
HERE U v_shift_right_logical(U a, U b) { return b < U(32) ? a >> (b & U(31)) : U(0); }
HERE I v_shift_right_logical(I a, I b) { return (I)v_shift_right_logical((U)a, (U)b); }
// Numbers in the order of IEEE's totalOrder: -0 before 0, and NaNs at the ends.
HERE I v_order(F a) { return (I)a ^ (((I)a >> 31) & I(0x7fffffff)); }
HERE I v_order(I a) { return a; }
HERE U v_order(U a) { return a; }
HERE I v_shift_right_arithmetic(I a, I b) { return a >> (I)v_min((U)b, U(31)); }
HERE U v_shift_right_arithmetic(U a, U b) { return (U)v_shift_right_arithmetic((I)a, (I)b); }  // of the sign bit, as XLA

HERE F to_F(I a) { return __builtin_convertvector(a, F); }
HERE F to_F(U a) { return __builtin_convertvector(a, F); }
HERE I to_I(U a) { return (I)a; }
HERE U to_U(I a) { return (U)a; }
HERE I to_I(F a) {
  const I whole = __builtin_convertvector(ELEMENTWISE(max)(ELEMENTWISE(min)(a, F(2147483520.0f)), F(-2147483648.0f)), I);
  return a != a ? I(0) : (a > F(2147483520.0f) ? I(2147483647) : whole);
}
HERE U to_U(F a) {
  const F high = F(2147483648.0f), kept = ELEMENTWISE(max)(ELEMENTWISE(min)(a, F(4294967040.0f)), F(0.0f));
  const B large = kept >= high;
  const U whole = (U)__builtin_convertvector(large ? kept - high : kept, I) + (large ? U(1u << 31) : U(0));
  return a != a ? U(0) : (a > F(4294967040.0f) ? U(~0u) : whole);
}
// Booleans have their own names, since they share a type with int32.
#define of_bool_F(a) ((a) ? F(1.0f) : F(0.0f))
#define of_bool_I(a) ((a) & I(1))
#define of_bool_U(a) ((U)((a) & I(1)))
HERE B to_B(F a) { return a != F(0.0f); }
HERE B to_B(I a) { return a != I(0); }
HERE B to_B(U a) { return a != U(0); }

// Elementary functions, to 2 or 3 units in the last place (tests/kernels). Polynomials are those of Cephes (Moshier).

HERE F v_exp(F x) {
  const F low = ELEMENTWISE(max)(ELEMENTWISE(min)(x, F(89.0f)), F(-104.0f));
  const F q = ELEMENTWISE(floor)(low * F(1.44269504f) + F(0.5f));
  const F r = low - q * F(0.693359375f) - q * F(-2.12194440e-4f);
  const F y = ((((((F(1.9875691500e-4f) * r + F(1.3981999507e-3f)) * r + F(8.3334519073e-3f)) * r + F(4.1665795894e-2f)) * r
    + F(1.6666665459e-1f)) * r + F(5.0000001201e-1f)) * (r * r) + r + F(1.0f));
  // Two factors: subnormal results, and 2^128.
  const I n = __builtin_convertvector(q, I), half = n >> I(1);
  const F s = y * (F)((half + I(127)) << I(23)) * (F)((n - half + I(127)) << I(23));
  return x != x ? x : (x > F(88.7228394f) ? F(__builtin_inff()) : (x < F(-103.972084f) ? F(0.0f) : s));
}
HERE F v_exp2(F x) {
  const F low = ELEMENTWISE(max)(ELEMENTWISE(min)(x, F(129.0f)), F(-151.0f)), q = ELEMENTWISE(floor)(low + F(0.5f));
  const I n = __builtin_convertvector(q, I), half = n >> I(1);
  const F y = v_exp((low - q) * F(0.693147181f));
  const F s = y * (F)((half + I(127)) << I(23)) * (F)((n - half + I(127)) << I(23));
  return x != x ? x : (x >= F(128.0f) ? F(__builtin_inff()) : s);
}
HERE F v_log(F x) {
  const B tiny = x < F(1.17549435e-38f);
  const F scaled = tiny ? x * F(8388608.0f) : x;
  const I bits = (I)scaled;
  I e = ((bits >> I(23)) & I(255)) - I(126) - (tiny ? I(23) : I(0));
  F m = (F)((bits & I(0x007fffff)) | I(0x3f000000));
  const B small = m < F(0.707106781f);
  e = small ? e - I(1) : e;
  m = small ? m + m - F(1.0f) : m - F(1.0f);
  const F z = m * m, f = __builtin_convertvector(e, F);
  F y = ((((((((F(7.0376836292e-2f) * m + F(-1.1514610310e-1f)) * m + F(1.1676998740e-1f)) * m + F(-1.2420140846e-1f)) * m
    + F(1.4249322787e-1f)) * m + F(-1.6668057665e-1f)) * m + F(2.0000714765e-1f)) * m + F(-2.4999993993e-1f)) * m
    + F(3.3333331174e-1f)) * m * z;
  y = y + f * F(-2.12194440e-4f) - F(0.5f) * z;
  const F found = m + y + f * F(0.693359375f);
  return ((x < F(0.0f)) | (x != x)) ? F(__builtin_nanf("")) : (x == F(0.0f) ? F(-__builtin_inff()) : (x == F(__builtin_inff()) ? x : found));
}

// Sine and cosine: x minus quarter turns in float64, up to 2^20 of them; library functions beyond.
APART F far_sin(F x) { EACH_LANE x[l] = sinf(x[l]); return x; }
APART F far_cos(F x) { EACH_LANE x[l] = cosf(x[l]); return x; }
HERE bool any(B c) { return __builtin_reduce_or(c) != 0; }
HERE F turned(F x, int quarters) {
  const D d = __builtin_convertvector(x, D), q = ELEMENTWISE(roundeven)(d * D(0.63661977236758138));
  const F r = __builtin_convertvector((d - q * D(1.5707963267341256)) - q * D(6.0771005065061922e-11), F);
  const I n = __builtin_convertvector(q, I) + I(quarters);
  const F z = r * r;
  const F s = ((F(-1.9515295891e-4f) * z + F(8.3321608736e-3f)) * z + F(-1.6666654611e-1f)) * z * r + r;
  const F c = ((F(2.443315711809948e-5f) * z + F(-1.388731625493765e-3f)) * z + F(4.166664568298827e-2f)) * z * z
    - F(0.5f) * z + F(1.0f);
  const F v = (n & I(1)) != I(0) ? c : s;
  return (n & I(2)) != I(0) ? -v : v;
}
HERE F v_sin(F x) {
  // A small angle is its own sine, and keeps the sign of zero. A lane does not depend on others.
  const B near = ELEMENTWISE(abs)(x) < F(1.0e6f);
  const F r = ELEMENTWISE(abs)(x) < F(1.0e-4f) ? x : turned(near ? x : F(0.0f), 0);
  return any(~near) ? (near ? r : far_sin(x)) : r;
}
HERE F v_cos(F x) {
  const B near = ELEMENTWISE(abs)(x) < F(1.0e6f);
  const F r = turned(near ? x : F(0.0f), 1);
  return any(~near) ? (near ? r : far_cos(x)) : r;
}

HERE F v_logistic(F x) { return F(1.0f) / (F(1.0f) + v_exp(-x)); }
#define BY_LIBRARY(name) APART F v_##name(F x) { EACH_LANE x[l] = name##f(x[l]); return x; }
BY_LIBRARY(log1p) BY_LIBRARY(expm1) BY_LIBRARY(tan) BY_LIBRARY(tanh) BY_LIBRARY(asin) BY_LIBRARY(acos)
BY_LIBRARY(atan) BY_LIBRARY(erf) BY_LIBRARY(cbrt)
APART F v_pow(F x, F y) { EACH_LANE x[l] = powf(x[l], y[l]); return x; }
APART F v_atan2(F y, F x) { EACH_LANE y[l] = atan2f(y[l], x[l]); return y; }

// Random bits of the words of a key and a place below 2^32 (Salmon et al. 2011): 20 rounds, both words of the result.
HERE U v_threefry(U key0, U key1, U place) {
  const U keys[3] = {key0, key1, key0 ^ key1 ^ U(0x1BD11BDAu)};
  const unsigned turns[8] = {13, 15, 26, 6, 17, 29, 16, 24};
  U a = key0, b = place + key1;
#pragma unroll
  for (int group = 0; group < 5; group++) {
#pragma unroll
    for (int i = 0; i < 4; i++) {
      const unsigned turn = turns[4 * (group % 2) + i];
      a += b;
      b = ((b << U(turn)) | (b >> U(32 - turn))) ^ a;
    }
    a += keys[(group + 1) % 3];
    b += keys[(group + 2) % 3] + U(group + 1);
  }
  return a ^ b;
}
