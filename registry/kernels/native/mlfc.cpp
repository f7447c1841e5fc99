// The whole sequence of a multi-layer fully connected RNN, for one model after another.
//
// Equations: registry/kernels/mlfc.py. A block of lanes is one stream of rows, a segment a step:
//   segment t = [y¹_{t−1} .. y^L_{t−1} | u_t | ỹ_{t−1}]
// so that what layer l reads at step t, [y^l .. y^L of the step before | u | ỹ | y¹ .. y^{l−1} of this step], is a run of
// rows as long as a segment, and what it makes comes right after. The read-out reads such a run too.
#include <vector>

#include "lanes.h"
#include "models.h"

namespace {

// Filled by mlfc.py, field by field.
struct Call {
  int64_t models, batch, steps, inputs, outputs, layers, cells, mask_lanes, keep;
  const void *u, *fed, *hidden, *forced, *mask;
  void *y, *end_hidden;
  const void *dy, *d_end_hidden;
  void *du, *d_fed, *d_hidden;
  const Weight* weights;   // of every layer (H, columns), then of the read-out (n, columns)
  void* const* gradients;  // of the same, models one after the other
  void *kept, *scratch;
  int64_t kept_size, scratch_size;  // numbers: of one model, of all
};

// out (rows, block) = start + A x, or out += A x; then each row is finished by `then`.
template <int ROWS, bool ADD, class R, class Then>
static inline void panel(int count, const Packed<R>& a, int row, const R* x, R* out, const R* start, Then then) {
  if constexpr (ROWS > 1)
    if (count < ROWS) return panel<ROWS - 1, ADD>(count, a, row, x, out, start, then);
  constexpr int W = Width<R>::block;
  Pair<R> sums[ROWS];
#pragma GCC unroll 16
  for (int r = 0; r < ROWS; r++) sums[r] = ADD ? Pair<R>(out + r * W) : Pair<R>(start[row + r]);
  accumulate<R, ROWS>(a.K, a.data + (size_t)row * a.K, x, sums);
#pragma GCC unroll 16
  for (int r = 0; r < ROWS; r++) then(sums[r]).store_to(out + r * W);
}

template <class R> class Run {
  static constexpr int V = Width<R>::vector, W = Width<R>::block;
  typedef Pair<R> Lanes;
  const Call& c;
  const int n, m, H, L, B, T, blocks;
  const int size, columns, segment;  // L·H; columns of a weight; rows of a segment
  const int slots, chunk;            // segments of a stream; steps whose weight gradients are taken at once

  struct Layer {
    Packed<R> forward, backward;
    R *start, *dg;
    WeightGradient<R> gradient;
  };
  R *streams, *d_streams, *seen, *d_seen, *dy, *sums;
  size_t kept_size, scratch_size;
  std::vector<Layer> layers;  // the last one is the read-out

  R* rows(int t, int b) const { return streams + ((size_t)b * slots + (c.keep ? t : 0)) * segment * W; }
  R* d_rows(int b) const { return d_streams + (size_t)b * 2 * segment * W; }
  const R* mask(int t, int model, int b) const {
    return c.mask ? in<R>(c.mask, t * int(c.models) + model, (size_t)size * c.mask_lanes) + (size_t)b * W : nullptr;
  }
  // The column of a weight, [u | ỹ | 1 | y¹ .. y^L], of row r of the run that layer l reads; the read-out is layer L.
  int column(int l, int r) const {
    const int at = (l * H + r) % segment;
    return at < size ? m + n + 1 + at : at - size;
  }
  int height(int l) const { return l < L ? H : n; }

 public:
  Run(const Call& c, int model)
      : c(c), n(int(c.outputs)), m(int(c.inputs)), H(int(c.cells)), L(int(c.layers)), B(int(c.batch)), T(int(c.steps)),
        blocks((B + W - 1) / W), size(L * H), columns(m + n + 1 + size), segment(size + m + n),
        slots(c.keep ? T + 1 : 2), chunk(std::max(1, 256 / (blocks * W))) {
    Arena<R> kept{out<R>(c.kept, model, c.kept_size)}, scratch{static_cast<R*>(c.scratch)};
    streams = kept.take((size_t)blocks * slots * segment * W);
    d_streams = scratch.take((size_t)blocks * 2 * segment * W);
    seen = scratch.take((size_t)segment * W), d_seen = scratch.take((size_t)segment * W);
    dy = scratch.take((size_t)n * W), sums = scratch.take((size_t)n * (segment + 1) * V);
    layers.reserve(L + 1);
    for (int l = 0; l <= L; l++) {
      const int h = height(l);
      layers.push_back({Packed<R>(h, segment, scratch), Packed<R>(segment, h, scratch), scratch.take(h),
                        scratch.take(l < L ? (size_t)chunk * blocks * H * W : 0),
                        WeightGradient<R>(l < L ? H : 0, segment, chunk * blocks, scratch)});
    }
    kept_size = kept.used, scratch_size = scratch.used;
  }
  void sizes(Call& to) const { to.kept_size = kept_size, to.scratch_size = scratch_size; }

  void pack(int model, bool backward) {
    for (int l = 0; l <= L; l++) {
      const int h = height(l);
      const R* w = in<R>(c.weights[l], model);
      auto at = [&](int row, int r) { return w[(size_t)row * columns + column(l, r)]; };
      if (backward)
        layers[l].backward.pack([&](int r, int row) { return at(row, r); });
      else
        layers[l].forward.pack(at);
      for (int row = 0; row < h; row++) layers[l].start[row] = w[(size_t)row * columns + m + n];
    }
  }

  void forward(int model) {
    const R *u = in<R>(c.u, model, (size_t)B * T * m), *forced = in<R>(c.forced, model, (size_t)B * T * n);
    R* y = out<R>(c.y, model, (size_t)B * T * n);
    pack(model, false);
    for (int b = 0; b < blocks; b++) {
      lanes_in(in<R>(c.hidden, model, (size_t)B * size), size, size, b, B, rows(0, b));
      lanes_in(in<R>(c.fed, model, (size_t)B * n), n, n, b, B, rows(0, b) + (size_t)(size + m) * W);
    }
    for (int t = 0; t < T; t++) {
      for (int b = 0; b < blocks; b++) lanes_in(u + (size_t)t * m, (size_t)T * m, m, b, B, rows(t, b) + (size_t)size * W);
      for (int l = 0; l < L; l++)
        for (int row = 0; row < H; row += TILE_ROWS)
          for (int b = 0; b < blocks; b++) {
            R* x = rows(t, b) + (size_t)l * H * W;
            panel<TILE_ROWS, false>(std::min(TILE_ROWS, H - row), layers[l].forward, row, x,
                                    x + (size_t)(segment + row) * W, layers[l].start,
                                    [](const Lanes& sum) { return tanh_of<R>(sum); });
          }
      for (int b = 0; b < blocks; b++) {
        R* next = rows(t, b) + (size_t)(segment + size + m) * W;  // where ỹ_t goes
        layers[L].forward.multiply(1, read(t, model, b), 0, next, 0, layers[L].start);
        lanes_out(next, n, b, B, y + (size_t)t * n, (size_t)T * n);
        if (forced) lanes_in(forced + (size_t)t * n, (size_t)T * n, n, b, B, next);
        if (!c.keep) std::copy_n(rows(t, b) + (size_t)segment * W, (size_t)segment * W, rows(t, b));
      }
    }
    for (int b = 0; b < blocks; b++) lanes_out(rows(T, b), size, b, B, out<R>(c.end_hidden, model, (size_t)B * size), size);
  }

  void backward(int model) {
    const R* given = in<R>(c.dy, model, (size_t)B * T * n);
    R* du = out<R>(c.du, model, (size_t)B * T * m);
    pack(model, true);
    for (Layer& layer : layers) layer.gradient.clear();
    std::fill_n(sums, (size_t)n * (segment + 1) * V, R(0));
    std::fill_n(d_streams, (size_t)blocks * 2 * segment * W, R(0));
    for (int b = 0; b < blocks; b++)
      lanes_in(in<R>(c.d_end_hidden, model, (size_t)B * size), size, size, b, B, d_rows(b) + (size_t)segment * W);
    auto same = [](const Lanes& sum) { return sum; };
    for (int t = T - 1; t >= 0; t--) {  // d_rows: segment t, nothing yet, then segment t + 1
      for (int b = 0; b < blocks; b++) {
        lanes_in(given + (size_t)t * n, (size_t)T * n, n, b, B, dy);
        const R* back = d_rows(b) + (size_t)(segment + size + m) * W;
        for (int i = 0; !c.forced && i < n * W; i++) dy[i] += back[i];
        read_out_backward(t, model, b);
      }
      for (int l = L - 1; l >= 0; l--) {
        Layer& layer = layers[l];
        R* dg = layer.dg + (size_t)(t % chunk) * blocks * H * W;
        for (int b = 0; b < blocks; b++) {
          const size_t own = (size_t)(segment + l * H) * W;
          const R *y = rows(t, b) + own, *d = d_rows(b) + own;
          R* g = dg + (size_t)b * H * W;
          for (size_t i = 0; i < (size_t)H * W; i += W) (Lanes(d + i) * (R(1) - Lanes(y + i) * Lanes(y + i))).store_to(g + i);
        }
        for (int row = 0; row < segment; row += TILE_ROWS)
          for (int b = 0; b < blocks; b++)
            panel<TILE_ROWS, true>(std::min(TILE_ROWS, segment - row), layer.backward, row, dg + (size_t)b * H * W,
                                   d_rows(b) + (size_t)(l * H + row) * W, (const R*)nullptr, same);
        if (t % chunk == 0)
          layer.gradient.add(std::min(chunk, T - t) * blocks, [&](int i) { return layer.dg + (size_t)i * H * W; },
                             [&](int i) { return rows(t + i / blocks, i % blocks) + (size_t)l * H * W; });
      }
      for (int b = 0; b < blocks; b++) {
        R* d = d_rows(b);
        if (du) lanes_out(d + (size_t)size * W, m, b, B, du + (size_t)t * m, (size_t)T * m);
        std::copy_n(d, (size_t)segment * W, d + (size_t)segment * W);
        std::fill_n(d, (size_t)segment * W, R(0));
      }
    }
    for (int b = 0; b < blocks; b++) {
      const R* d = d_rows(b) + (size_t)segment * W;
      lanes_out(d, size, b, B, out<R>(c.d_hidden, model, (size_t)B * size), size);
      lanes_out(d + (size_t)(size + m) * W, n, b, B, out<R>(c.d_fed, model, (size_t)B * n), n);
    }
    for (int l = 0; l <= L; l++) {
      const int h = height(l);
      R* g = out<R>(c.gradients[l], model, (size_t)h * columns);
      auto at = [&](int row, int r) {
        return l < L ? layers[l].gradient.at(row, r) : sum<R>(load(sums + ((size_t)row * (segment + 1) + r) * V));
      };
      for (int row = 0; row < h; row++) {
        for (int r = 0; r < segment; r++) g[(size_t)row * columns + column(l, r)] = at(row, r);
        g[(size_t)row * columns + m + n] = at(row, segment);
      }
    }
  }

 private:
  // What the read-out reads: [u_t | ỹ_{t−1} | y¹_t .. y^L_t], the layers after dropout.
  const R* read(int t, int model, int b) {
    const R *x = rows(t, b) + (size_t)size * W, *through = mask(t, model, b);
    if (!through) return x;
    std::copy_n(x, (size_t)(m + n) * W, seen);
    for (int j = 0; j < size; j++)
      for (int i = 0; i < W; i++) seen[(m + n + j) * W + i] = x[(m + n + j) * W + i] * through[j * c.mask_lanes + i];
    return seen;
  }

  // From dy of a block to what the read-out read, and to its weights.
  void read_out_backward(int t, int model, int b) {
    const Layer& out = layers[L];
    const R *x = read(t, model, b), *through = mask(t, model, b);
    R* d = d_rows(b) + (size_t)size * W;
    out.backward.multiply(1, dy, 0, d_seen, 0);
    for (int j = 0; through && j < size; j++)
      for (int i = 0; i < W; i++) d_seen[(m + n + j) * W + i] *= through[j * c.mask_lanes + i];
    for (size_t i = 0; i < (size_t)segment * W; i += W) (Lanes(d + i) + Lanes(d_seen + i)).store_to(d + i);
    for (int row = 0; row < n; row++) {
      const Lanes of_row(dy + (size_t)row * W);
      R* to = sums + (size_t)row * (segment + 1) * V;
      for (int r = 0; r < segment; r++, to += V) store(to, load(to) + (of_row * Lanes(x + (size_t)r * W)).both());
      store(to, load(to) + of_row.both());
    }
  }
};

}  // namespace

EXPORT(mlfc)
