// The whole sequence of a stacked LSTM with delayed output feedback, for one model after another.
#include "models.h"
#include "stack.h"

namespace {

// Filled by lstm.py, field by field.
struct Call {
  int64_t models, batch, steps, inputs, outputs, taps, layers, cells, mask_lanes, keep, input_gradient, increments;
  const void *u, *state, *forced, *mask;
  void *y, *end_state;
  const void *dy, *d_end_state;
  void *du, *d_state;
  const Weight* weights;  // of every layer: input, recurrent, bias, peephole; then of the read-out: weight, bias
  void* const* gradients;  // of the same, models one after the other
  void *kept, *scratch;
  int64_t kept_size, scratch_size;  // numbers: of one model, of all
};

// A row of the state: [D − 1 inputs | D outputs | m | c], newest first. What enters the first layer: [D·ỹ | D·u].
template <class R> class Run {
  static constexpr int W = Width<R>::block;
  const Call& c;
  const int n, m, D, B, T, blocks;
  const size_t past_u, past_y, states, size;  // numbers of a row of the state
  Arena<R> kept, scratch;
  Stack<R> stack;
  Readout<R> readout;
  R *y, *dy, *d_taps;

  static StackShape shape(const Call& c, int blocks) {
    const int fed = int(c.taps * c.outputs), u = int(c.taps * c.inputs);
    return {int(c.layers), int(c.cells), blocks, int(c.steps), fed + u, u, c.input_gradient || c.taps > 1 ? fed + u : fed,
            c.keep != 0};
  }

 public:
  Run(const Call& c, int model)
      : c(c), n(int(c.outputs)), m(int(c.inputs)), D(int(c.taps)), B(int(c.batch)), T(int(c.steps)), blocks((B + W - 1) / W),
        past_u((size_t)(D - 1) * m), past_y((size_t)D * n), states(c.layers * c.cells), size(past_u + past_y + 2 * states),
        kept{out<R>(c.kept, model, c.kept_size)}, scratch{static_cast<R*>(c.scratch)}, stack(shape(c, blocks), kept, scratch),
        readout(n, int(c.cells), blocks, scratch), y(scratch.take((size_t)n * W)),
        dy(scratch.take((size_t)blocks * n * W)), d_taps(scratch.take((size_t)blocks * (D + 1) * (n + m) * W)) {}

  void sizes(Call& to) const { to.kept_size = kept.used, to.scratch_size = scratch.used; }

  Mask<R> mask(int t, int model) const {
    if (!c.mask) return {};
    const size_t step = (size_t)c.cells * c.mask_lanes;  // of (L, T, M, H, lanes)
    return {static_cast<const R*>(c.mask) + (t * c.models + model) * step, size_t(c.mask_lanes), T * c.models * step};
  }

  void pack(int model, bool backward) {
    std::vector<LayerWeights<R>> layers;
    for (int l = 0; l < c.layers; l++) {
      const Weight* w = c.weights + 4 * l;
      layers.push_back({in<R>(w[0], model), in<R>(w[1], model), in<R>(w[2], model), in<R>(w[3], model)});
    }
    stack.pack(layers.data(), backward);
    const Weight* head = c.weights + 4 * c.layers;
    if (n) readout.pack(in<R>(head[0], model), in<R>(head[1], model));
  }

  void forward(int model) {
    const R *u = in<R>(c.u, model, (size_t)B * T * m), *forced = in<R>(c.forced, model, (size_t)B * T * n);
    const R* state = in<R>(c.state, model, B * size);
    R *outputs = out<R>(c.y, model, (size_t)B * T * n), *end = out<R>(c.end_state, model, B * size);
    pack(model, false);
    stack.states_in(state + past_u + past_y, state + past_u + past_y + states, size, B, 0);
    for (int b = 0; b < blocks; b++) {
      lanes_in(state + past_u, size, int(past_y), b, B, stack.entering(0, b));
      lanes_in(state, size, int(past_u), b, B, stack.entering(0, b) + (past_y + m) * W);
    }
    for (int t = 0; t < T; t++) {
      for (int b = 0; b < blocks; b++)
        lanes_in(u + (size_t)t * m, (size_t)T * m, m, b, B, stack.entering(t, b) + past_y * W);
      stack.forward(t, mask(t, model));
      for (int b = 0; b < blocks; b++) {
        const R* x = stack.entering(t, b);
        R* next = stack.entering(t + 1, b);
        std::copy_n(x + past_y * W, past_u * W, next + (past_y + m) * W);
        if (!n) continue;
        readout.forward(stack.top(t, b, mask(t, model)), y);
        for (int i = 0; c.increments && i < n * W; i++) y[i] += x[i];
        lanes_out(y, n, b, B, outputs + (size_t)t * n, (size_t)T * n);
        if (forced)
          lanes_in(forced + (size_t)t * n, (size_t)T * n, n, b, B, next);
        else
          std::copy_n(y, (size_t)n * W, next);
        std::copy_n(x, (past_y - n) * W, next + (size_t)n * W);
      }
    }
    for (int b = 0; b < blocks; b++) {
      lanes_out(stack.entering(T, b) + (past_y + m) * W, int(past_u), b, B, end, size);
      lanes_out(stack.entering(T, b), int(past_y), b, B, end + past_u, size);
    }
    stack.states_out(end + past_u + past_y, end + past_u + past_y + states, size, B, T);
  }

  // The gradients of the taps, newest first, are those of the step after, each one tap earlier, and this step's own.
  void backward(int model) {
    const size_t one = (size_t)n * W, all = (D + 1) * one, u_one = (size_t)m * W, u_all = (D + 1) * u_one;
    const R *given = in<R>(c.dy, model, (size_t)B * T * n), *ends = in<R>(c.d_end_state, model, B * size);
    R *du = out<R>(c.du, model, (size_t)B * T * m), *d_state = out<R>(c.d_state, model, B * size);
    R* const d_inputs = d_taps + blocks * all;
    pack(model, true);
    stack.begin(ends ? ends + past_u + past_y : nullptr, ends ? ends + past_u + past_y + states : nullptr, size, B);
    readout.begin();
    std::fill_n(d_taps, blocks * (all + u_all), R(0));  // a row of zeros follows the last tap
    for (int b = 0; ends && b < blocks; b++) {
      lanes_in(ends + past_u, size, int(past_y), b, B, d_taps + b * all);
      lanes_in(ends, size, int(past_u), b, B, d_inputs + b * u_all + u_one);
    }
    for (int t = T - 1; t >= 0; t--) {
      const R* d_top = nullptr;
      if (n) {
        for (int b = 0; b < blocks; b++) {
          R *d = dy + b * one, *taps = d_taps + b * all;
          if (given)
            lanes_in(given + (size_t)t * n, (size_t)T * n, n, b, B, d);
          else
            std::fill_n(d, one, R(0));
          if (!c.forced)
            for (size_t i = 0; i < one; i++) d[i] += taps[i];
          std::copy_n(taps + one, D * one, taps);
          for (size_t i = 0; c.increments && i < one; i++) taps[i] += d[i];
        }
        stack.see(t, mask(t, model));
        d_top = readout.backward(dy, one, [&](int b) { return stack.top(t, b, mask(t, model)); });
      }
      const bool inputs_too = du || t < D - 1;
      stack.backward(t, d_top, mask(t, model), int(inputs_too ? past_y + past_u + m : past_y));
      for (int b = 0; b < blocks; b++) {
        const R* d = stack.d_entering(b);
        for (size_t i = 0; i < D * one; i++) d_taps[b * all + i] += d[i];
        R* taps = d_inputs + b * u_all;
        std::copy_n(taps + u_one, D * u_one, taps);
        if (!inputs_too) continue;
        for (size_t i = 0; i < D * u_one; i++) taps[i] += d[D * one + i];
        if (du) lanes_out(taps, m, b, B, du + (size_t)t * m, (size_t)T * m);
      }
    }
    for (int b = 0; b < blocks; b++) {
      lanes_out(d_taps + b * all, int(past_y), b, B, d_state + past_u, size);
      lanes_out(d_inputs + b * u_all + u_one, int(past_u), b, B, d_state, size);
    }
    stack.end(d_state + past_u + past_y, d_state + past_u + past_y + states, size, B);
    std::vector<LayerGradients<R>> layers;
    const size_t H = c.cells, H4 = 4 * H;
    for (int l = 0; l < c.layers; l++) {
      void* const* g = c.gradients + 4 * l;
      const size_t k = l ? H : past_y + past_u + m;
      layers.push_back({out<R>(g[0], model, H4 * k), out<R>(g[1], model, H4 * H), out<R>(g[2], model, H4),
                        out<R>(g[3], model, 3 * H)});
    }
    stack.gradients(layers.data());
    void* const* head = c.gradients + 4 * c.layers;
    if (n) readout.gradients(out<R>(head[0], model, n * H), out<R>(head[1], model, n));
  }
};

}  // namespace

EXPORT(lstm)
