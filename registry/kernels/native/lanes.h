// Between rows of PyTorch, (batch, features), and blocks of lanes, (features, block) each.
#pragma once
#include "products.h"

// As call.py describes it: the models themselves may lie apart.
struct Weight {
  const void* data;
  int64_t stride;  // numbers from a model to the next
};

// out (count, block) = columns 0 .. count of rows b·block .. of src (batch, stride); zero where there is no such row.
template <class R> static inline void lanes_in(const R* src, size_t stride, int count, int b, int batch, R* out) {
  constexpr int V = Width<R>::vector, W = Width<R>::block;
  const R* first = src + (size_t)b * W * stride;
  const int rows = std::min(W, batch - b * W);
  int i = 0;
  for (; rows == W && i + V <= count; i += V)
    for (int lane = 0; lane < W; lane += V) {
      Vector<R> square[V];
      for (int k = 0; k < V; k++) square[k] = load(first + (lane + k) * stride + i);
      transpose<R>(square);
      for (int k = 0; k < V; k++) store(out + (i + k) * W + lane, square[k]);
    }
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
    for (int lane = 0; lane < W; lane += V) {
      Vector<R> square[V];
      for (int k = 0; k < V; k++) square[k] = load(src + (i + k) * W + lane);
      transpose<R>(square);
      for (int k = 0; k < V; k++) store(first + (lane + k) * stride + i, square[k]);
    }
  for (; i < count; i++)
    for (int lane = 0; lane < rows; lane++) first[lane * stride + i] = src[i * W + lane];
}
