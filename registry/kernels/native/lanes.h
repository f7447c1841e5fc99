// Between rows of PyTorch, (batch, features), and blocks of lanes, (features, block) each.
#pragma once
#include "products.h"

// out (count, block) = columns 0 .. count of rows b·block .. of src (batch, stride); zero where there is no such row.
template <class R> static inline void lanes_in(const R* src, size_t stride, int count, int b, int batch, R* out) {
  constexpr int W = Width<R>::block;
  for (int lane = 0; lane < W; lane++) {
    const int row = b * W + lane;
    if (row < batch)
      for (int i = 0; i < count; i++) out[i * W + lane] = src[row * stride + i];
    else
      for (int i = 0; i < count; i++) out[i * W + lane] = 0;
  }
}

// The way back.
template <class R> static inline void lanes_out(const R* src, int count, int b, int batch, R* out, size_t stride) {
  constexpr int W = Width<R>::block;
  for (int lane = 0; lane < W && b * W + lane < batch; lane++)
    for (int i = 0; i < count; i++) out[(b * W + lane) * stride + i] = src[i * W + lane];
}
