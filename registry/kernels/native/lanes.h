// Between rows of PyTorch, (batch, features), and blocks of lanes, (features, block) each.
#pragma once
#include "products.h"

// A square of the machine's vectors, its rows to columns; both advance by their strides a row.
template <class R> static inline void turn(const R* from, size_t from_stride, R* to, size_t to_stride) {
  constexpr int V = Width<R>::vector;
  Vector<R> square[V];
  for (int k = 0; k < V; k++) square[k] = load(from + k * from_stride);
  transpose<R>(square);
  for (int k = 0; k < V; k++) store(to + k * to_stride, square[k]);
}

// out (count, block) = columns 0 .. count of rows b·block .. of src (batch, stride); zero where there is no such row.
template <class R> static inline void lanes_in(const R* src, size_t stride, int count, int b, int batch, R* out) {
  constexpr int V = Width<R>::vector, W = Width<R>::block;
  const R* first = src + (size_t)b * W * stride;
  const int rows = std::min(W, batch - b * W);
  int i = 0;
  for (; rows == W && i + V <= count; i += V)
    for (int lane = 0; lane < W; lane += V) turn(first + lane * stride + i, stride, out + i * W + lane, W);
  for (; i < count; i++)
    for (int lane = 0; lane < W; lane++) out[i * W + lane] = lane < rows ? first[lane * stride + i] : R(0);
}

// The way back.
template <class R> static inline void lanes_out(const R* src, int count, int b, int batch, R* out, size_t stride) {
  constexpr int V = Width<R>::vector, W = Width<R>::block;
  R* first = out + (size_t)b * W * stride;
  const int rows = std::min(W, batch - b * W);
  int i = 0;
  for (; rows == W && i + V <= count; i += V)
    for (int lane = 0; lane < W; lane += V) turn(src + i * W + lane, W, first + lane * stride + i, stride);
  for (; i < count; i++)
    for (int lane = 0; lane < rows; lane++) first[lane * stride + i] = src[i * W + lane];
}
