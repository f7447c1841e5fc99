// Matrix products with lanes of the batch side by side.
//
// The batch goes through in blocks of `Width::block` lanes; an array of F features is (blocks, F, block). The smaller
// operand, a weight, is packed so that a product reads it from front to back.
#pragma once
#include <algorithm>
#include <climits>
#include <cstddef>

#include "vectors.h"

// Hands out parts of one buffer; without a buffer it only counts.
template <class R> struct Arena {
  R* base;
  size_t used = 0;
  R* take(size_t count) {
    R* part = base ? base + used : nullptr;
    used += (count + 63) / 64 * 64;
    return part;
  }
};

// What is read soon, in memory far away. Products, which wait for no memory, ask for it on their way.
struct Soon {
  struct Part {
    const char *at, *end;
  } parts[3] = {};
  template <class R> static Part part(const R* p, size_t count) {
    return {reinterpret_cast<const char*>(p), reinterpret_cast<const char*>(p + count)};
  }
  // Where the next `lines` cache lines to ask for begin, or null.
  const char* take(int lines) {
    for (Part& p : parts)
      if (p.at < p.end) return (p.at += 64 * lines) - 64 * lines;
    return nullptr;
  }
};

// sums (ROWS, block) += A (ROWS, K) X (K, block); A is stored column after column. soon: K lines to ask for.
template <class R, int ROWS, bool ASK = false>
static inline void accumulate(int K, const R* __restrict a, const R* __restrict x, Pair<R> (&sums)[ROWS],
                              const char* soon = nullptr) {
  for (int k = 0; k < K; k++, a += ROWS, x += Width<R>::block) {
    if constexpr (ASK) __builtin_prefetch(soon + 64 * (size_t)k, 0, 2);
    const Pair<R> lanes(x);
#pragma GCC unroll 16
    for (int r = 0; r < ROWS; r++) sums[r] = sums[r] + a[r] * lanes;
  }
}

// A weight (rows, K) in panels of at most TILE_ROWS rows, each stored column after column.
template <class R> struct Packed {
  int rows, K;
  R* data;
  Packed(int rows, int K, Arena<R>& arena) : rows(rows), K(K), data(arena.take((size_t)rows * K)) {}

  // get(r, k): the weight at row r and column k.
  template <class Get> void pack(Get get) {
    R* at = data;
    for (int r = 0; r < rows; r += TILE_ROWS)
      for (int k = 0; k < K; k++)
        for (int i = r; i < std::min(rows, r + TILE_ROWS); i++) *at++ = get(i, k);
  }

  // out (blocks, rows, block) = A x + start, a number a row or null; x and out advance by their strides a block.
  // Panels that begin after the first `wanted` rows are left out.
  void multiply(int blocks, const R* x, size_t x_stride, R* out, size_t out_stride, const R* start = nullptr,
                int wanted = INT_MAX, Soon soon = {}) const {
    for (int r = 0; r < std::min(rows, wanted); r += TILE_ROWS)
      for (int b = 0; b < blocks; b++)
        panel<TILE_ROWS>(std::min(TILE_ROWS, rows - r), data + (size_t)r * K, x + b * x_stride,
                         out + b * out_stride + (size_t)r * Width<R>::block, start ? start + r : nullptr, soon.take(K));
  }

 private:
  template <int ROWS>
  void panel(int count, const R* a, const R* x, R* out, const R* start, const char* soon) const {
    if constexpr (ROWS > 1)
      if (count < ROWS) return panel<ROWS - 1>(count, a, x, out, start, soon);
    Pair<R> sums[ROWS];
#pragma GCC unroll 16
    for (int r = 0; r < ROWS; r++) sums[r] = start ? start[r] : R(0);
    if (soon)
      accumulate<R, ROWS, true>(K, a, x, sums, soon);
    else
      accumulate<R, ROWS>(K, a, x, sums);
#pragma GCC unroll 16
    for (int r = 0; r < ROWS; r++) sums[r].store_to(out + r * Width<R>::block);
  }
};

// The gradient of a weight, dW (rows, K + 1) += Σ over lanes of dG xᵀ, its last column that of a bias.
template <class R> struct WeightGradient {
  static constexpr int W = Width<R>::block;
  int rows, K, tiles;
  R *sums, *turned;
  // lanes: the most blocks × block lanes that `add` is given at once.
  WeightGradient(int rows, int K, int most_blocks, Arena<R>& arena)
      : rows(rows), K(K), tiles((K + W) / W), sums(arena.take((size_t)tiles * rows * W)),
        turned(arena.take((size_t)most_blocks * W * W)) {}

  void clear() { std::fill_n(sums, (size_t)tiles * rows * W, R(0)); }

  // g(i), x(i): block i of dG (rows, block) and of x (K, block).
  template <class G, class X> void add(int blocks, G g, X x) {
    for (int q = 0; q < tiles; q++) {
      const int columns = std::min(W, K - q * W);
      for (int i = 0; i < blocks; i++) turn(x(i) + (size_t)q * W * W, columns, turned + (size_t)i * W * W);
      for (int r = 0; r < rows; r += TILE_ROWS) {
        R* to = sums + ((size_t)q * rows + r) * W;
        if (columns + 1 > Width<R>::vector)
          tile<TILE_ROWS, 2>(std::min(TILE_ROWS, rows - r), blocks, [&](int i) { return g(i) + (size_t)r * W; }, to);
        else
          tile<TILE_ROWS, 1>(std::min(TILE_ROWS, rows - r), blocks, [&](int i) { return g(i) + (size_t)r * W; }, to);
      }
    }
  }

  R at(int r, int k) const { return sums[((size_t)(k / W) * rows + r) * W + k % W]; }

 private:
  // A tile (columns, block) turned to (block, block), with a column of ones after the last one.
  static void turn(const R* x, int columns, R* out) {
    constexpr int V = Width<R>::vector;
    for (int q = 0; q < W; q += V)
      for (int b = 0; b < W; b += V) {
        Vector<R> square[V];
        for (int k = 0; k < V; k++)
          square[k] = q + k < columns ? load(x + (q + k) * W + b) : fill(R(q + k == columns));
        transpose<R>(square);
        for (int k = 0; k < V; k++) store(out + (b + k) * W + q, square[k]);
      }
  }

  template <int ROWS, int VECTORS, class G> void tile(int count, int blocks, G g, R* to) {
    if constexpr (ROWS > 1)
      if (count < ROWS) return tile<ROWS - 1, VECTORS>(count, blocks, g, to);
    constexpr int V = Width<R>::vector;
    for (int i = 0; i < ROWS * W; i += 64 / sizeof(R)) __builtin_prefetch(to + i, 1);  // of a wide layer: far away
    Vector<R> acc[ROWS][VECTORS] = {};  // added to what was there at the end only: a long sum in parts rounds less
    const R* x = turned;
    for (int i = 0; i < blocks; i++) {
      const R* row = g(i);
      for (int lane = 0; lane < W; lane++, x += W, row++) {
        Vector<R> operand[VECTORS];
#pragma GCC unroll 2
        for (int v = 0; v < VECTORS; v++) operand[v] = load(x + v * V);
#pragma GCC unroll 16
        for (int r = 0; r < ROWS; r++) {
          const Vector<R> w = fill(row[r * W]);
#pragma GCC unroll 2
          for (int v = 0; v < VECTORS; v++) acc[r][v] += w * operand[v];
        }
      }
    }
#pragma GCC unroll 16
    for (int r = 0; r < ROWS; r++)
#pragma GCC unroll 2
      for (int v = 0; v < VECTORS; v++) store(to + r * W + v * V, load(to + r * W + v * V) + acc[r][v]);
  }
};
