// LSTM layers in series with diagonal peepholes, and a linear read-out: a step forward, a step back.
//
// Equations: registry/kernels/lstm.py. What a layer multiplies is (blocks, H + k, block), rows [m | what enters]; its
// gates are (blocks, 4H, block), the four of a cell one after the other, so that a tile of the product holds whole
// cells and is finished while it is in registers.
#pragma once
#include <vector>

#include "lanes.h"

template <class R> struct LayerWeights {
  const R *input, *recurrent, *bias, *peephole;  // (4H, k), (4H, H), (4H,), (3, H)
};
template <class R> struct LayerGradients {
  R *input, *recurrent, *bias, *peephole;
};

struct StackShape {
  int layers, cells, blocks, steps;
  int entering;   // rows that enter the first layer
  int leading;    // this many columns of its input weights belong to its last rows
  int wanted;     // rows from the first on whose gradient may be wanted
  bool keep;      // for a way back
};

// What dropout lets through in one step: (layers, H, lanes), or no dropout.
template <class R> struct Mask {
  const R* data = nullptr;
  size_t lanes = 0, layer_stride = 0;
  const R* at(int layer, int b) const { return data ? data + layer * layer_stride + (size_t)b * Width<R>::block : nullptr; }
};

template <class R> class Stack {
  static constexpr int V = Width<R>::vector, W = Width<R>::block;
  typedef Pair<R> Lanes;

  struct Layer {
    int k, width;
    R *x, *g, *c;  // histories
    Packed<R> forward, backward;
    R *start, *peephole;
    R *dx, *dc, *dg, *d_peephole;
    WeightGradient<R> gradient;
  };
  std::vector<Layer> layers;
  R* seen;  // the last layer's outputs after dropout

 public:
  const StackShape s;
  const int chunk;  // steps whose weight gradients are taken at once: about 256 rows, while they are in the cache

  Stack(const StackShape& s, Arena<R>& kept, Arena<R>& scratch)
      : s(s), chunk(std::max(1, 256 / std::max(1, s.blocks * W))) {
    const size_t slots = s.keep ? s.steps + 1 : 2, H = s.cells, block = (size_t)s.blocks * W;
    Arena<R> none{nullptr};
    layers.reserve(s.layers);
    for (int l = 0; l < s.layers; l++) {
      const int k = l ? s.cells : s.entering, width = s.cells + k;
      Arena<R>& back = s.keep ? scratch : none;
      layers.push_back({k, width, kept.take(slots * width * block), s.keep ? kept.take(s.steps * 4 * H * block) : nullptr,
                        kept.take(slots * H * block), Packed<R>(4 * s.cells, width, scratch),
                        Packed<R>(l ? width : s.cells + s.wanted, 4 * s.cells, back), scratch.take(4 * H),
                        scratch.take(3 * H), back.take(width * block), back.take(H * block),
                        back.take(chunk * 4 * H * block), back.take(3 * H * V),
                        WeightGradient<R>(4 * s.cells, width, chunk * s.blocks, back)});
    }
    seen = scratch.take(H * block);
  }

  void pack(const LayerWeights<R>* weights, bool backward) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++) {
      Layer& y = layers[l];
      const LayerWeights<R>& w = weights[l];
      const int k = y.k, turn = l ? 0 : s.leading;
      auto at = [&](int gate_row, int column) {
        const size_t row = (size_t)(gate_row % 4) * H + gate_row / 4;
        return column < H ? w.recurrent[row * H + column] : w.input[row * k + (column - H + turn) % k];
      };
      if (backward)
        y.backward.pack([&](int r, int c) { return at(c, r); });
      else
        y.forward.pack(at);
      for (int r = 0; r < 4 * H; r++) y.start[r] = w.bias[(r % 4) * H + r / 4];
      std::copy_n(w.peephole, 3 * H, y.peephole);
    }
  }

  size_t slot(int t) const { return s.keep ? t : t & 1; }
  R* x(int layer, int t, int b) { return layers[layer].x + (slot(t) * s.blocks + b) * layers[layer].width * W; }
  R* cell(int layer, int t, int b) { return layers[layer].c + (slot(t) * s.blocks + b) * s.cells * W; }
  // What enters the first layer at step t.
  R* entering(int t, int b) { return x(0, t, b) + (size_t)s.cells * W; }

  // m and c of all layers, layers·H each, in rows that are `stride` apart: into step t, or from it.
  void states_in(const R* hidden, const R* cells, size_t stride, int batch, int t) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++)
      for (int b = 0; b < s.blocks; b++) {
        lanes_in(hidden + l * H, stride, H, b, batch, x(l, t, b));
        lanes_in(cells + l * H, stride, H, b, batch, cell(l, t, b));
      }
  }
  void states_out(R* hidden, R* cells, size_t stride, int batch, int t) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++)
      for (int b = 0; b < s.blocks; b++) {
        lanes_out(x(l, t, b), H, b, batch, hidden + l * H, stride);
        lanes_out(cell(l, t, b), H, b, batch, cells + l * H, stride);
      }
  }

  // From step t to t + 1; what enters is in place.
  void forward(int t, const Mask<R>& mask = {}) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++) {
      Layer& y = layers[l];
      for (int j = 0; j < H; j += TILE_ROWS / 4)
        for (int b = 0; b < s.blocks; b++) {
          const size_t at = (size_t)j * W;
          R* up = l + 1 < s.layers ? entering_layer(l + 1, t, b) : mask.data ? seen + (size_t)b * H * W : nullptr;
          const R* m = mask.at(l, b);
          gates<TILE_ROWS>(std::min(TILE_ROWS, 4 * (H - j)), y, j, x(l, t, b), cell(l, t, b) + at, cell(l, t + 1, b) + at,
                           y.g ? y.g + ((size_t)t * s.blocks + b) * 4 * H * W + 4 * at : nullptr, x(l, t + 1, b) + at,
                           up ? up + at : nullptr, m ? m + j * mask.lanes : nullptr, mask.lanes, b == 0 && s.blocks > 1);
        }
    }
  }

  // What the read-out sees after step t, block b: (H, block).
  const R* top(int t, int b, const Mask<R>& mask = {}) {
    return mask.data ? seen + (size_t)b * s.cells * W : x(s.layers - 1, t + 1, b);
  }
  void see(int t, const Mask<R>& mask) {
    for (int b = 0; mask.data && b < s.blocks; b++) {
      const R *m = x(s.layers - 1, t + 1, b), *through = mask.at(s.layers - 1, b);
      R* to = seen + (size_t)b * s.cells * W;
      for (int j = 0; j < s.cells; j++)
        for (int i = 0; i < W; i++) to[j * W + i] = m[j * W + i] * through[j * mask.lanes + i];
    }
  }

  // Starts the way back from the gradients of the last states, if they have any.
  void begin(const R* d_hidden, const R* d_cells, size_t stride, int batch) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++) {
      Layer& y = layers[l];
      y.gradient.clear();
      std::fill_n(y.d_peephole, (size_t)3 * H * V, R(0));
      for (int b = 0; b < s.blocks; b++) {
        R *d_m = d_x(l, b), *d_c = y.dc + (size_t)b * H * W;
        if (d_hidden)
          lanes_in(d_hidden + l * H, stride, H, b, batch, d_m), lanes_in(d_cells + l * H, stride, H, b, batch, d_c);
        else
          std::fill_n(d_m, (size_t)H * W, R(0)), std::fill_n(d_c, (size_t)H * W, R(0));
      }
    }
  }
  // Adds (blocks, H, block) to the gradient of the last layer's outputs, where the way back now is.
  void push(const R* d_top) {
    for (int b = 0; b < s.blocks; b++)
      for (int i = 0; i < s.cells * W; i++) d_x(s.layers - 1, b)[i] += d_top[(size_t)b * s.cells * W + i];
  }
  // The gradients of the states at the start.
  void end(R* d_hidden, R* d_cells, size_t stride, int batch) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++)
      for (int b = 0; b < s.blocks; b++) {
        lanes_out(d_x(l, b), H, b, batch, d_hidden + l * H, stride);
        lanes_out(layers[l].dc + (size_t)b * H * W, H, b, batch, d_cells + l * H, stride);
      }
  }

  // From step t + 1 to t. d_top (blocks, H, block): the gradient of what the read-out sees after the step, or null.
  // wanted: rows of what enters, from the first on, whose gradient is wanted at this step.
  void backward(int t, const R* d_top, const Mask<R>& mask = {}, int wanted = INT_MAX / 2) {
    const int H = s.cells;
    for (int l = s.layers - 1; l >= 0; l--) {
      Layer& y = layers[l];
      R* dg = y.dg + (size_t)(t % chunk) * s.blocks * 4 * H * W;
      for (int b = 0; b < s.blocks; b++) {
        const R* above = l + 1 < s.layers ? d_x(l + 1, b) + (size_t)H * W : d_top ? d_top + (size_t)b * H * W : nullptr;
        cells(y, y.g + ((size_t)t * s.blocks + b) * 4 * H * W, cell(l, t, b), cell(l, t + 1, b), d_x(l, b), above,
              mask.at(l, b), mask.lanes, y.dc + (size_t)b * H * W, dg + (size_t)b * 4 * H * W);
      }
      y.backward.multiply(s.blocks, dg, (size_t)4 * H * W, y.dx, (size_t)y.backward.rows * W, nullptr,
                          l ? INT_MAX : H + wanted, l ? soon(l - 1, t) : t ? soon(s.layers - 1, t - 1) : Soon{});
      if (t % chunk == 0) {
        const R* x0 = x(l, t, 0);
        const size_t width = (size_t)y.width * W;
        y.gradient.add(std::min(chunk, s.steps - t) * s.blocks, [&](int i) { return y.dg + (size_t)i * 4 * H * W; },
                       [&](int i) { return x0 + i * width; });
      }
    }
  }
  // The gradient of what entered the first layer, the wanted rows.
  const R* d_entering(int b) { return d_x(0, b) + (size_t)s.cells * W; }

  void gradients(const LayerGradients<R>* out) {
    const int H = s.cells;
    for (int l = 0; l < s.layers; l++) {
      const Layer& y = layers[l];
      const int k = y.k, turn = l ? 0 : s.leading;
      for (int j = 0; j < H; j++) {
        for (int gate = 0; gate < 4; gate++) {
          const int r = 4 * j + gate;
          const size_t row = (size_t)gate * H + j;
          for (int c = 0; c < H; c++) out[l].recurrent[row * H + c] = y.gradient.at(r, c);
          for (int c = 0; c < k; c++) out[l].input[row * k + (c + turn) % k] = y.gradient.at(r, H + c);
          out[l].bias[row] = y.gradient.at(r, H + k);
        }
        for (int p = 0; p < 3; p++) out[l].peephole[p * H + j] = sum<R>(load(y.d_peephole + (3 * j + p) * V));
      }
    }
  }

 private:
  // The histories that the way back reads of a layer at step t, once and from far away.
  Soon soon(int l, int t) {
    const size_t block = (size_t)s.blocks * W, gates = 4 * s.cells * block;
    return {{Soon::part(layers[l].g + t * gates, gates), Soon::part(cell(l, t, 0), s.cells * block),
             Soon::part(x(l, t, 0), layers[l].width * block)}};
  }
  R* entering_layer(int l, int t, int b) { return x(l, t, b) + (size_t)s.cells * W; }
  R* d_x(int l, int b) { return layers[l].dx + (size_t)b * layers[l].backward.rows * W; }

  // One tile: the gates of up to TILE_ROWS / 4 cells from cell j on, then their cells and outputs. ask: for the weights
  // of the next tile.
  template <int ROWS>
  void gates(int rows, const Layer& y, int j, const R* x, const R* c0, R* c1, R* g, R* m, R* up, const R* mask,
             size_t mask_lanes, bool ask) {
    if constexpr (ROWS > 4)
      if (rows < ROWS) return gates<ROWS - 4>(rows, y, j, x, c0, c1, g, m, up, mask, mask_lanes, ask);
    Lanes sums[ROWS];
#pragma GCC unroll 16
    for (int r = 0; r < ROWS; r++) sums[r] = y.start[4 * j + r];
    const R* w = y.forward.data + (size_t)4 * j * y.width;
    if (ask)
      accumulate<R, ROWS, true>(y.width, w, x, sums, reinterpret_cast<const char*>(w + ROWS * y.width));
    else
      accumulate<R, ROWS>(y.width, w, x, sums);
    const int H = s.cells;
#pragma GCC unroll 4
    for (int q = 0; q < ROWS / 4; q++) {
      const R pi = y.peephole[j + q], pf = y.peephole[H + j + q], po = y.peephole[2 * H + j + q];
      const size_t at = (size_t)q * W;
      const Lanes before(c0 + at);
      const Lanes i = sigmoid_of<R>(sums[4 * q] + pi * before), f = sigmoid_of<R>(sums[4 * q + 1] + pf * before);
      const Lanes z = tanh_of<R>(sums[4 * q + 2]), after = f * before + i * z;
      const Lanes o = sigmoid_of<R>(sums[4 * q + 3] + po * after), out = tanh_of<R>(after) * o;
      after.store_to(c1 + at);
      out.store_to(m + at);
      if (up) (mask ? out * Lanes(mask + q * mask_lanes) : out).store_to(up + at);
      if (g) {
        R* to = g + 4 * at;
        i.store_to(to), f.store_to(to + W), z.store_to(to + 2 * W), o.store_to(to + 3 * W);
      }
    }
  }

  // The gradients before the gates of one block (4H, block), and that of its cells moved on to the step before.
  void cells(const Layer& y, const R* g, const R* c0, const R* c1, const R* d_m, const R* above, const R* mask,
             size_t mask_lanes, R* dc, R* dg) {
    const int H = s.cells;
    for (int j = 0; j < H; j++) {
      const R pi = y.peephole[j], pf = y.peephole[H + j], po = y.peephole[2 * H + j];
      R* sums = y.d_peephole + (size_t)3 * j * V;
      const size_t at = (size_t)j * W, row = 4 * at;
      const Lanes i(g + row), f(g + row + W), z(g + row + 2 * W), o(g + row + 3 * W);
      const Lanes before(c0 + at), after(c1 + at), t = tanh_of<R>(after);
      Lanes dm(d_m + at);
      if (above) dm = dm + (mask ? Lanes(above + at) * Lanes(mask + j * mask_lanes) : Lanes(above + at));
      const Lanes d_o = dm * t * (o - o * o);
      const Lanes d = Lanes(dc + at) + dm * o * (R(1) - t * t) + d_o * po;
      const Lanes d_i = d * z * (i - i * i), d_f = d * before * (f - f * f), d_z = d * i * (R(1) - z * z);
      (d * f + d_i * pi + d_f * pf).store_to(dc + at);
      d_i.store_to(dg + row), d_f.store_to(dg + row + W), d_z.store_to(dg + row + 2 * W), d_o.store_to(dg + row + 3 * W);
      store(sums, load(sums) + (d_i * before).both());
      store(sums + V, load(sums + V) + (d_f * before).both());
      store(sums + 2 * V, load(sums + 2 * V) + (d_o * after).both());
    }
  }
};

// y = A m + b of the last layer's outputs.
template <class R> class Readout {
  static constexpr int V = Width<R>::vector, W = Width<R>::block;
  const int n, H, blocks;
  Packed<R> forward_, backward_;
  R *bias, *d_top, *sums;

 public:
  Readout(int n, int H, int blocks, Arena<R>& scratch)
      : n(n), H(H), blocks(blocks), forward_(n, H, scratch), backward_(H, n, scratch), bias(scratch.take(n)),
        d_top(scratch.take((size_t)blocks * H * W)), sums(scratch.take((size_t)n * (H + 2) * V)) {}

  void pack(const R* weight, const R* b) {
    forward_.pack([&](int r, int c) { return weight[(size_t)r * H + c]; });
    backward_.pack([&](int r, int c) { return weight[(size_t)c * H + r]; });
    std::copy_n(b, n, bias);
  }
  // y (n, block) of one block.
  void forward(const R* m, R* y) const { forward_.multiply(1, m, 0, y, 0, bias); }

  void begin() { std::fill_n(sums, (size_t)n * (H + 2) * V, R(0)); }
  // From dy (blocks, n, block), its blocks `stride` apart, to what `Stack::backward` takes; m(b): what block b saw.
  template <class M> const R* backward(const R* dy, size_t stride, M m) {
    backward_.multiply(blocks, dy, stride, d_top, (size_t)H * W);
    for (int b = 0; b < blocks; b++)
      for (int r = 0; r < n; r++) {
        const Vector<R> d0 = load(dy + b * stride + (size_t)r * W), d1 = load(dy + b * stride + (size_t)r * W + V);
        const R* x = m(b);
        R* to = sums + (size_t)r * (H + 2) * V;
        for (int j = 0; j < H; j++, x += W, to += V) store(to, load(to) + d0 * load(x) + d1 * load(x + V));
        const Vector<R> before = load(to), more = d0 + d1 - load(to + V), after = before + more;  // compensated (Kahan)
        store(to, after), store(to + V, (after - before) - more);
      }
    return d_top;
  }
  void gradients(R* weight, R* b) const {
    for (int r = 0; r < n; r++) {
      for (int j = 0; j < H; j++) weight[(size_t)r * H + j] = sum<R>(load(sums + ((size_t)r * (H + 2) + j) * V));
      b[r] = sum<R>(load(sums + ((size_t)r * (H + 2) + H) * V));
    }
  }
};
