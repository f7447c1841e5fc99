// Vectors of the machine's registers, and the gate functions on them. No -ffast-math: NaN stays NaN.
#pragma once
#include <cstdint>
#include <cstring>
#include <utility>
#if defined(__AVX512F__)
#include <immintrin.h>
#endif

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
  static constexpr float magic = 12582912.f + 127, limit = 125;  // 1.5 · 2^23: its last bits are whole numbers
  static constexpr int shift = 23;
};
template <> struct Exponent<double> {
  typedef int64_t bits;
  static constexpr double magic = 6755399441055744. + 1023, limit = 1020;
  static constexpr int shift = 52;
};

// Of each pair of groups of S lanes: the first ones of a and b, or the second ones.
template <class R, int S, bool SECOND, int... LANE>
static inline Vector<R> interleave(Vector<R> a, Vector<R> b, std::integer_sequence<int, LANE...>) {
  constexpr int V = Width<R>::vector;
#if defined(__clang__)
  return __builtin_shufflevector(a, b, (LANE & S ? V + LANE - (SECOND ? 0 : S) : LANE + (SECOND ? S : 0))...);
#else
  typedef typename Exponent<R>::bits Bits __attribute__((vector_size(REGISTER_BYTES)));
  return __builtin_shuffle(a, b, Bits{(LANE & S ? V + LANE - (SECOND ? 0 : S) : LANE + (SECOND ? S : 0))...});
#endif
}
// Rows to columns, in place.
template <class R, int S = 1> static inline void transpose(Vector<R> (&rows)[Width<R>::vector]) {
  constexpr int V = Width<R>::vector;
  if constexpr (S < V) {
#pragma GCC unroll 16
    for (int i = 0; i < V; i++)
      if (!(i & S)) {
        const auto lanes = std::make_integer_sequence<int, V>();
        const Vector<R> a = rows[i], b = rows[i + S];
        rows[i] = interleave<R, S, false>(a, b, lanes);
        rows[i + S] = interleave<R, S, true>(a, b, lanes);
      }
    transpose<R, 2 * S>(rows);
  }
}

// y within ±limit; NaN stays.
template <class R> static inline Vector<R> clamp(Vector<R> y, R limit) {
#if defined(__AVX512F__)  // of two operands with a NaN among them these take the second
  if constexpr (sizeof(R) == 4)
    return (Vector<R>)_mm512_min_ps((__m512)fill(limit), _mm512_max_ps((__m512)fill(-limit), (__m512)y));
  else
    return (Vector<R>)_mm512_min_pd((__m512d)fill(limit), _mm512_max_pd((__m512d)fill(-limit), (__m512d)y));
#else
  y = y < -limit ? fill<R>(-limit) : y;
  return y > limit ? fill<R>(limit) : y;
#endif
}

// The lanes of a block: two vectors, each operation on both before the next one, which hides how long it takes.
template <class R> struct Pair {
  Vector<R> v[2];
  Pair() = default;
  Pair(R x) : v{fill(x), fill(x)} {}
  Pair(Vector<R> a, Vector<R> b) : v{a, b} {}
  explicit Pair(const R* p) : v{load(p), load(p + Width<R>::vector)} {}
  void store_to(R* p) const { store(p, v[0]), store(p + Width<R>::vector, v[1]); }
  Vector<R> both() const { return v[0] + v[1]; }
  friend Pair operator+(const Pair& x, const Pair& y) { return {x.v[0] + y.v[0], x.v[1] + y.v[1]}; }
  friend Pair operator-(const Pair& x, const Pair& y) { return {x.v[0] - y.v[0], x.v[1] - y.v[1]}; }
  friend Pair operator*(const Pair& x, const Pair& y) { return {x.v[0] * y.v[0], x.v[1] * y.v[1]}; }
  friend Pair operator/(const Pair& x, const Pair& y) { return {x.v[0] / y.v[0], x.v[1] / y.v[1]}; }
};

// 2^r − 1, |r| <= 1/2; error 2e-9 of 2^r, below a rounding of the type (doubles: Taylor).
template <class R> static inline Pair<R> power_less_one(const Pair<R>& r) {
  if constexpr (sizeof(R) == 4) {
    Pair<R> p = 1.5353361785e-4f * r + 1.3398874455e-3f;
    p = p * r + 9.6184373585e-3f, p = p * r + 5.5503324710e-2f, p = p * r + 2.4022647914e-1f;
    return (p * r + 6.9314720286e-1f) * r;
  } else {
    constexpr double c[] = {1.3691488853904128e-12, 2.5678435993488206e-11, 4.4455382718708116e-10,
                            7.054911620801123e-9,   1.0178086009239699e-7,  1.3215486790144309e-6,
                            1.5252733804059841e-5,  1.5403530393381609e-4,  1.3333558146428443e-3,
                            9.618129107628477e-3,   5.550410866482158e-2,   2.402265069591007e-1,
                            6.931471805599453e-1};
    Pair<R> p = c[0];
    for (int i = 1; i < 13; i++) p = p * r + c[i];
    return p * r;
  }
}

// exp(a x) + sign, sign ±1, the exponent kept in ±limit. The scale multiplies: a NaN cannot lose its exponent.
template <class R> [[gnu::always_inline]] static inline Pair<R> exponential(Pair<R> x, R a, R sign) {
  typedef Exponent<R> E;
  typedef typename E::bits Bits __attribute__((vector_size(REGISTER_BYTES)));
  const R per = a * R(1.4426950408889634074);
  for (auto& v : x.v) v = clamp<R>(v, E::limit / (per < 0 ? -per : per));
  const Pair<R> n = x * per + E::magic;
  Pair<R> scale;
  for (int k = 0; k < 2; k++) {
    Bits i;
    std::memcpy(&i, &n.v[k], sizeof i);
    i <<= E::shift;
    std::memcpy(&scale.v[k], &i, sizeof i);
  }
  return power_less_one<R>(x * per - (n - E::magic)) * scale + (scale + sign);
}

template <class R> [[gnu::always_inline]] static inline Pair<R> sigmoid_of(const Pair<R>& x) {
  return R(1) / exponential<R>(x, -1, 1);
}
template <class R> [[gnu::always_inline]] static inline Pair<R> tanh_of(const Pair<R>& x) {
  const Pair<R> e = exponential<R>(x, 2, -1);
  return e / (e + R(2));
}
