// A multi-layer perceptron, affine maps with tanh between them, for one model after another.
#include <vector>

#include "lanes.h"
#include "models.h"

namespace {

// Filled by mlp.py, field by field.
struct Call {
  int64_t models, batch, layers, input_gradient;
  const void* x;
  void* y;
  const void* dy;
  void* dx;
  const int64_t* widths;   // of the input, then of every layer
  const Weight* weights;   // of every layer: weight (n, k), bias (n,)
  void* const* gradients;  // of the same, models one after the other
  void *kept, *scratch;
  int64_t kept_size, scratch_size;  // numbers: of one model, of all
};

template <class R> class Run {
  static constexpr int W = Width<R>::block;
  typedef Pair<R> Lanes;
  struct Layer {
    int k, n;
    R *x, *y;  // what enters (blocks, k, block) and leaves (blocks, n, block)
    Packed<R> forward, backward;
    R* dy;
    WeightGradient<R> gradient;
  };
  const Call& c;
  const int B, blocks;
  Arena<R> kept, scratch;
  std::vector<Layer> layers;
  R* dx;


 public:
  Run(const Call& c, int model)
      : c(c), B(int(c.batch)), blocks((B + W - 1) / W), kept{out<R>(c.kept, model, c.kept_size)},
        scratch{static_cast<R*>(c.scratch)} {
    const size_t lanes = (size_t)blocks * W;
    R* x = kept.take(c.widths[0] * lanes);
    for (int l = 0; l < c.layers; l++) {
      const int k = int(c.widths[l]), n = int(c.widths[l + 1]);
      R* y = (l + 1 < c.layers ? kept : scratch).take(n * lanes);
      layers.push_back({k, n, x, y, Packed<R>(n, k, scratch), Packed<R>(k, n, scratch), scratch.take(n * lanes),
                        WeightGradient<R>(n, k, blocks, scratch)});
      x = y;
    }
    dx = scratch.take(c.widths[0] * lanes);
  }

  void sizes(Call& to) const { to.kept_size = kept.used, to.scratch_size = scratch.used; }

  void forward(int model) {
    const int K = layers.front().k, n = layers.back().n;
    for (int b = 0; b < blocks; b++)
      lanes_in(in<R>(c.x, model, (size_t)B * K), K, K, b, B, layers.front().x + (size_t)b * K * W);
    for (size_t l = 0; l < layers.size(); l++) {
      Layer& y = layers[l];
      const R *w = in<R>(c.weights[2 * l], model), *bias = in<R>(c.weights[2 * l + 1], model);
      y.forward.pack([&](int r, int k) { return w[(size_t)r * y.k + k]; });
      y.forward.multiply(blocks, y.x, (size_t)y.k * W, y.y, (size_t)y.n * W, bias);
      for (size_t i = 0; l + 1 < layers.size() && i < (size_t)blocks * y.n * W; i += W)
        tanh_of<R>(Lanes(y.y + i)).store_to(y.y + i);
    }
    for (int b = 0; b < blocks; b++)
      lanes_out(layers.back().y + (size_t)b * n * W, n, b, B, out<R>(c.y, model, (size_t)B * n), n);
  }

  void backward(int model) {
    const int K = layers.front().k, n = layers.back().n;
    for (int b = 0; b < blocks; b++)
      lanes_in(in<R>(c.dy, model, (size_t)B * n), n, n, b, B, layers.back().dy + (size_t)b * n * W);
    for (size_t l = layers.size(); l-- > 0;) {
      Layer& y = layers[l];
      y.gradient.clear();
      y.gradient.add(blocks, [&](int b) { return y.dy + (size_t)b * y.n * W; },
                     [&](int b) { return y.x + (size_t)b * y.k * W; });
      R *dw = out<R>(c.gradients[2 * l], model, (size_t)y.n * y.k), *db = out<R>(c.gradients[2 * l + 1], model, y.n);
      for (int r = 0; r < y.n; r++) {
        for (int k = 0; k < y.k; k++) dw[(size_t)r * y.k + k] = y.gradient.at(r, k);
        db[r] = y.gradient.at(r, y.k);
      }
      if (!l && !c.input_gradient) return;
      R* d = l ? layers[l - 1].dy : dx;
      const R* w = in<R>(c.weights[2 * l], model);
      y.backward.pack([&](int k, int r) { return w[(size_t)r * y.k + k]; });
      y.backward.multiply(blocks, y.dy, (size_t)y.n * W, d, (size_t)y.k * W);
      for (size_t i = 0; l && i < (size_t)blocks * y.k * W; i += W)
        (Lanes(d + i) * (R(1) - Lanes(y.x + i) * Lanes(y.x + i))).store_to(d + i);
    }
    for (int b = 0; b < blocks; b++) lanes_out(dx + (size_t)b * K * W, K, b, B, out<R>(c.dx, model, (size_t)B * K), K);
  }

};

}  // namespace

EXPORT(mlp)
