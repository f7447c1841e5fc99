// The matrix products of a recurrent layer alone, operands in place: what no loop around them can undercut.
#include "products.h"

namespace {

// Filled by products.py, field by field.
struct Call {
  int64_t columns, rows, batch, steps, backward;
  const float *weight, *x, *g;  // (rows, columns); operands (steps, blocks, columns, block) and (steps, blocks, rows, block)
  float *out, *dx;              // (blocks, rows, block), (blocks, columns, block)
  void *kept, *scratch;
  int64_t kept_size, scratch_size;
};

class Run {
  static constexpr int W = Width<float>::block;
  const Call& c;
  const int K, n, blocks;
  Arena<float> kept;
  Packed<float> forward_, backward_;
  WeightGradient<float> gradient;

 public:
  explicit Run(const Call& c)
      : c(c), K(int(c.columns)), n(int(c.rows)), blocks(int((c.batch + W - 1) / W)), kept{static_cast<float*>(c.kept)},
        forward_(n, K, kept), backward_(K, n, kept), gradient(n, K, int(c.steps) * blocks, kept) {}

  void sizes(Call& to) const { to.kept_size = kept.used, to.scratch_size = 0; }
  void pack() {
    forward_.pack([&](int r, int k) { return c.weight[(size_t)r * K + k]; });
    backward_.pack([&](int r, int k) { return c.weight[(size_t)k * K + r]; });
    gradient.clear();
  }
  void multiply() {
    const size_t x_step = (size_t)blocks * K * W, g_step = (size_t)blocks * n * W;
    for (int t = 0; t < c.steps; t++) {
      forward_.multiply(blocks, c.x + t * x_step, (size_t)K * W, c.out, (size_t)n * W);
      if (c.backward) backward_.multiply(blocks, c.g + t * g_step, (size_t)n * W, c.dx, (size_t)K * W);
    }
    if (c.backward)
      gradient.add(int(c.steps) * blocks, [&](int i) { return c.g + (size_t)i * n * W; },
                   [&](int i) { return c.x + (size_t)i * K * W; });
  }
};

}  // namespace

extern "C" {
int64_t products_block_f() { return Width<float>::block; }
void products_sizes_f(Call* c) { Run(*c).sizes(*c); }
void products_pack_f(const Call* c) { Run(*c).pack(); }
void products_multiply_f(const Call* c) { Run(*c).multiply(); }
}
