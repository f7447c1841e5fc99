// The whole sequence of a stacked LSTM with delayed output feedback, for one model after another.
#include "stack.h"

namespace {

struct Weight {
  const void* data;
  int64_t stride;  // numbers from a model to the next
};

// Filled by lstm.py, field by field.
struct Call {
  int64_t models, batch, steps, inputs, outputs, taps, layers, cells, mask_lanes, keep, input_gradient;
  const void *u, *fed, *hidden, *cell, *forced, *mask;
  void *y, *end_hidden, *end_cell;
  const void *dy, *d_end_hidden, *d_end_cell;
  void *du, *d_fed, *d_hidden, *d_cell;
  const Weight* weights;  // of every layer: input, recurrent, bias, peephole; then of the read-out: weight, bias
  void* const* gradients;  // of the same, models one after the other
  void *kept, *scratch;
  int64_t kept_size, scratch_size;  // numbers: of one model, of all
};

template <class R> class Run {
  static constexpr int W = Width<R>::block;
  const Call& c;
  const int n, m, D, B, T, blocks;
  Arena<R> kept, scratch;
  Stack<R> stack;
  Readout<R> readout;
  R *y, *dy, *d_taps;

  static StackShape shape(const Call& c, int blocks) {
    const int fed = int(c.taps * c.outputs), m = int(c.inputs);
    return {int(c.layers), int(c.cells), blocks, int(c.steps), fed + m, m, c.input_gradient ? fed + m : fed, c.keep != 0};
  }
  template <class P> P* part(P* base, size_t model, size_t size) const { return base ? base + model * size : nullptr; }
  const R* in(const void* p, int model, size_t size) const { return part(static_cast<const R*>(p), model, size); }
  R* out(void* p, int model, size_t size) const { return part(static_cast<R*>(p), model, size); }
  const R* weight(int i, int model) const { return in(c.weights[i].data, model, c.weights[i].stride); }

 public:
  Run(const Call& c, int model)
      : c(c), n(int(c.outputs)), m(int(c.inputs)), D(int(c.taps)), B(int(c.batch)), T(int(c.steps)), blocks((B + W - 1) / W),
        kept{out(c.kept, model, c.kept_size)}, scratch{static_cast<R*>(c.scratch)}, stack(shape(c, blocks), kept, scratch),
        readout(n, int(c.cells), blocks, scratch), y(scratch.take((size_t)n * W)),
        dy(scratch.take((size_t)blocks * n * W)), d_taps(scratch.take((size_t)blocks * (D + 1) * n * W)) {}

  void sizes(Call& to) const { to.kept_size = kept.used, to.scratch_size = scratch.used; }

  Mask<R> mask(int t, int model) const {
    if (!c.mask) return {};
    const size_t step = (size_t)c.cells * c.mask_lanes;  // of (L, T, M, H, lanes)
    return {static_cast<const R*>(c.mask) + (t * c.models + model) * step, size_t(c.mask_lanes), T * c.models * step};
  }

  void pack(int model, bool backward) {
    std::vector<LayerWeights<R>> layers;
    for (int l = 0; l < c.layers; l++)
      layers.push_back({weight(4 * l, model), weight(4 * l + 1, model), weight(4 * l + 2, model), weight(4 * l + 3, model)});
    stack.pack(layers.data(), backward);
    if (n) readout.pack(weight(4 * int(c.layers), model), weight(4 * int(c.layers) + 1, model));
  }

  void forward(int model) {
    const size_t size = (size_t)c.layers * c.cells * B, taps = (size_t)D * n * W;
    const R *u = in(c.u, model, (size_t)B * T * m), *forced = in(c.forced, model, (size_t)B * T * n);
    const R* fed = in(c.fed, model, (size_t)B * D * n);
    R* outputs = out(c.y, model, (size_t)B * T * n);
    pack(model, false);
    stack.states_in(in(c.hidden, model, size), in(c.cell, model, size), B, 0);
    for (int t = 0; t < T; t++) {
      for (int b = 0; b < blocks; b++) {
        R* x = stack.entering(t, b);
        if (t == 0) lanes_in(fed, (size_t)D * n, D * n, b, B, x);
        lanes_in(u + (size_t)t * m, (size_t)T * m, m, b, B, x + taps);
      }
      stack.forward(t, mask(t, model));
      for (int b = 0; n && b < blocks; b++) {
        readout.forward(stack.top(t, b, mask(t, model)), y);
        lanes_out(y, n, b, B, outputs + (size_t)t * n, (size_t)T * n);
        if (!D || t + 1 == T) continue;
        const R* x = stack.entering(t, b);
        R* next = stack.entering(t + 1, b);
        if (forced)
          lanes_in(forced + (size_t)t * n, (size_t)T * n, n, b, B, next);
        else
          std::copy_n(y, (size_t)n * W, next);
        std::copy_n(x, (size_t)(D - 1) * n * W, next + (size_t)n * W);
      }
    }
    stack.states_out(out(c.end_hidden, model, size), out(c.end_cell, model, size), B, T);
  }

  void backward(int model) {
    const size_t size = (size_t)c.layers * c.cells * B, one = (size_t)n * W, all = (D + 1) * one;
    const R* given = in(c.dy, model, (size_t)B * T * n);
    R* du = out(c.du, model, (size_t)B * T * m);
    pack(model, true);
    stack.begin(in(c.d_end_hidden, model, size), in(c.d_end_cell, model, size), B);
    readout.begin();
    std::fill_n(d_taps, blocks * all, R(0));  // of the taps of the step after, newest first, and a row of zeros
    for (int t = T - 1; t >= 0; t--) {
      const R* d_top = nullptr;
      if (n) {
        for (int b = 0; b < blocks; b++) {
          R *d = dy + b * one, *taps = d_taps + b * all;
          lanes_in(given + (size_t)t * n, (size_t)T * n, n, b, B, d);
          if (D && !c.forced)
            for (size_t i = 0; i < one; i++) d[i] += taps[i];
          std::copy_n(taps + one, D * one, taps);  // a tap of the step after is the one before it of this step
        }
        stack.see(t, mask(t, model));
        d_top = readout.backward(dy, one, [&](int b) { return stack.top(t, b, mask(t, model)); });
      }
      stack.backward(t, d_top, mask(t, model));
      for (int b = 0; b < blocks; b++) {
        const R* d = stack.d_entering(b);
        for (size_t i = 0; i < D * one; i++) d_taps[b * all + i] += d[i];
        if (du) lanes_out(d + D * one, m, b, B, du + (size_t)t * m, (size_t)T * m);
      }
    }
    for (int b = 0; b < blocks; b++)
      lanes_out(d_taps + b * all, D * n, b, B, out(c.d_fed, model, (size_t)B * D * n), (size_t)D * n);
    stack.end(out(c.d_hidden, model, size), out(c.d_cell, model, size), B);
    std::vector<LayerGradients<R>> layers;
    const size_t H = c.cells, H4 = 4 * H;
    for (int l = 0; l < c.layers; l++) {
      void* const* g = c.gradients + 4 * l;
      const size_t k = l ? H : D * n + m;
      layers.push_back({out(g[0], model, H4 * k), out(g[1], model, H4 * H), out(g[2], model, H4), out(g[3], model, 3 * H)});
    }
    stack.gradients(layers.data());
    void* const* head = c.gradients + 4 * c.layers;
    if (n) readout.gradients(out(head[0], model, n * H), out(head[1], model, n));
  }
};

template <class R> void sizes(Call* c) { Run<R>(*c, 0).sizes(*c); }
template <class R> void forward(const Call* c) {
  for (int model = 0; model < c->models; model++) Run<R>(*c, model).forward(model);
}
template <class R> void backward(const Call* c) {
  for (int model = 0; model < c->models; model++) Run<R>(*c, model).backward(model);
}

}  // namespace

extern "C" {
void lstm_sizes_f(Call* c) { sizes<float>(c); }
void lstm_sizes_d(Call* c) { sizes<double>(c); }
void lstm_forward_f(const Call* c) { forward<float>(c); }
void lstm_forward_d(const Call* c) { forward<double>(c); }
void lstm_backward_f(const Call* c) { backward<float>(c); }
void lstm_backward_d(const Call* c) { backward<double>(c); }
}
