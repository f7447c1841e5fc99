// Vectors of the machine's registers, and the gate functions on them. No -ffast-math: NaN stays NaN.
#pragma once
#include <cstdint>
#include <cstring>

#if defined(__AVX512F__)
constexpr int REGISTER_BYTES = 64, TILE_ROWS = 12;  // 24 sums, two operands and a factor in 32 registers
#elif defined(__AVX__)
constexpr int REGISTER_BYTES = 32, TILE_ROWS = 4;
#else
constexpr int REGISTER_BYTES = 16, TILE_ROWS = 4;
#endif

template <class R> struct Width {
  static constexpr int vector = REGISTER_BYTES / sizeof(R);
  static constexpr int block = 2 * vector;  // lanes that go through the loop side by side; divides 32
  typedef R type __attribute__((vector_size(REGISTER_BYTES)));
};
template <class R> using Vector = typename Width<R>::type;

template <class R> static inline Vector<R> load(const R* p) {
  Vector<R> v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
template <class R> static inline void store(R* p, Vector<R> v) { std::memcpy(p, &v, sizeof v); }
template <class R> static inline Vector<R> fill(R x) { return x - Vector<R>{}; }
template <class R> static inline R sum(Vector<R> v) {
  R s = 0;
  for (int i = 0; i < Width<R>::vector; i++) s += v[i];
  return s;
}

template <class R> struct Exponent;
template <> struct Exponent<float> {
  typedef int32_t bits;
  static constexpr float magic = 12582912.f, limit = 126;  // 1.5 * 2^23: its last bits are whole numbers
  static constexpr bits bias = 127, shift = 23;
};
template <> struct Exponent<double> {
  typedef int64_t bits;
  static constexpr double magic = 6755399441055744., limit = 1022;
  static constexpr bits bias = 1023, shift = 52;
};

// 2^r, |r| <= 1/2: Taylor, remainder below a rounding of the type.
static inline Vector<float> power(Vector<float> r) {
  Vector<float> s = r * r;
  Vector<float> a = 6.9314718056e-1f * r + 1.f, b = 5.5504108665e-2f * r + 2.4022650696e-1f;
  Vector<float> c = 1.3333558146e-3f * r + 9.6181291076e-3f, d = 1.5252733804e-5f * r + 1.5403530393e-4f;
  return ((d * s + c) * s + b) * s + a;
}
static inline Vector<double> power(Vector<double> r) {
  constexpr double c[] = {1.3691488853904128e-12, 2.5678435993488206e-11, 4.4455382718708116e-10,
                          7.054911620801123e-9,   1.0178086009239699e-7,  1.3215486790144309e-6,
                          1.5252733804059841e-5,  1.5403530393381609e-4,  1.3333558146428443e-3,
                          9.618129107628477e-3,   5.550410866482158e-2,   2.402265069591007e-1,
                          6.931471805599453e-1,   1.};
  Vector<double> p = fill(c[0]);
  for (int i = 1; i < 14; i++) p = p * r + c[i];
  return p;
}

// exp(a x), at most 2^limit and at least its inverse. The scale multiplies: a NaN cannot lose its exponent.
template <class R> static inline Vector<R> exp_of(Vector<R> x, R a) {
  typedef Exponent<R> E;
  typedef typename E::bits Bits __attribute__((vector_size(REGISTER_BYTES)));
  Vector<R> y = x * (a * R(1.4426950408889634074));
  y = y < -E::limit ? fill<R>(-E::limit) : y;
  y = y > E::limit ? fill<R>(E::limit) : y;
  Vector<R> n = y + E::magic;
  typename E::bits zero;
  const R magic = E::magic;
  std::memcpy(&zero, &magic, sizeof zero);
  Bits i;
  std::memcpy(&i, &n, sizeof i);
  i = (i - zero + E::bias) << E::shift;
  Vector<R> scale;
  std::memcpy(&scale, &i, sizeof scale);
  return power(y - (n - E::magic)) * scale;
}
template <class R> static inline Vector<R> sigmoid(Vector<R> x) { return R(1) / (R(1) + exp_of<R>(x, R(-1))); }
template <class R> static inline Vector<R> tanh_of(Vector<R> x) { return R(1) - R(2) / (R(1) + exp_of<R>(x, R(2))); }
