// The whole sequence of a hybrid model: input model, rigid body, output model, feedback. registry/predictors/hybrid.py
#include "rigid_body.h"
#include "stack.h"

namespace {

// Filled by hybrid.py, field by field. Of two things the first is the input model's.
struct Call {
  int64_t batch, steps, inputs, outputs, layers, cells, networks, added, held, keep, input_gradient;
  double dt, gravity;
  const void *u, *forced, *state, *given, *coupling, *load_scale, *scale, *offset;
  const int64_t* rows;  // place of each output in the state
  const void *hidden[2], *cell[2];
  void *after, *before, *end_state, *end_hidden[2], *end_cell[2];
  const void *d_after, *d_before, *d_end_state, *d_end_hidden[2], *d_end_cell[2];
  void *du, *d_state, *d_given, *d_coupling, *d_hidden[2], *d_cell[2];
  const void* const* weights;  // of each network: its layers' input, recurrent, bias, peephole; read-out, its bias
  void* const* gradients;      // of the same
  void *kept, *scratch;
  int64_t kept_size, scratch_size;
};

constexpr int STATE = 13, LOAD = 4;  // thrust, three torques

template <class R> class Run {
  static constexpr int W = Width<R>::block;
  typedef RigidBody<R> Body;
  const Call& c;
  const int n, m, B, T, H, blocks;
  Arena<R> kept, scratch;
  std::vector<Stack<R>> stacks;
  std::vector<Readout<R>> readouts;
  R *x, *given;  // histories: (steps, blocks, 13, block) before each step; (steps + 1, blocks, 4, block) by the input model
  R *y, *own, *dx, *dy, *d_moved, *d_fed, *d_start, *d_give;

  const R* in(const void* p) const { return static_cast<const R*>(p); }
  R* out(void* p) const { return static_cast<R*>(p); }
  R* take(int rows) { return scratch.take((size_t)blocks * rows * W); }
  R* x_at(int t, int b) const { return x + ((size_t)(c.keep ? t : 0) * blocks + b) * STATE * W; }
  R* given_at(int t, int b) const { return given + ((size_t)(c.keep ? t : t & 1) * blocks + b) * LOAD * W; }

 public:
  explicit Run(const Call& c)
      : c(c), n(int(c.outputs)), m(int(c.inputs)), B(int(c.batch)), T(int(c.steps)), H(int(c.cells)),
        blocks((B + W - 1) / W), kept{out(c.kept)}, scratch{out(c.scratch)} {
    const int wanted = c.input_gradient ? m : 0, L = int(c.layers);
    const bool keep = c.keep != 0;
    stacks.reserve(2);
    stacks.emplace_back(StackShape{L, H, blocks, T, n + m, m, n + wanted, keep}, kept, scratch);
    readouts.emplace_back(LOAD, H, blocks, scratch);
    if (c.networks > 1) {
      stacks.emplace_back(StackShape{L, H, blocks, T, n + LOAD + m, 0, n + LOAD + wanted, keep}, kept, scratch);
      readouts.emplace_back(n, H, blocks, scratch);
    }
    x = kept.take((size_t)(keep ? std::max(T, 1) : 1) * blocks * STATE * W);
    given = kept.take((size_t)(keep ? T + 1 : 2) * blocks * LOAD * W);
    y = take(n), own = take(n), dx = take(STATE), dy = take(n), d_moved = take(n), d_fed = take(n), d_start = take(LOAD);
    d_give = take(LOAD);
  }

  void sizes(Call& to) const { to.kept_size = kept.used, to.scratch_size = scratch.used; }

  void forward() {
    pack(false);
    const R *u = in(c.u), *forced = in(c.forced), *scale = in(c.scale);
    const Body body(R(c.dt), R(c.gravity), in(c.coupling));
    for (size_t i = 0; i < stacks.size(); i++) stacks[i].states_in(in(c.hidden[i]), in(c.cell[i]), c.layers * c.cells, B, 0);
    for (int b = 0; b < blocks; b++) {
      lanes_in(in(c.state), STATE, STATE, b, B, x_at(0, b));
      if (b * W + W > B) upright(x_at(0, b), b);
      pick(x_at(0, b), y + (size_t)b * n * W);
      readouts[0].forward(stacks[0].x(int(c.layers) - 1, 0, b), given_at(0, b));
    }
    for (int t = 0; t < T; t++) {
      for (int b = 0; b < blocks; b++) {
        std::copy_n(y + (size_t)b * n * W, (size_t)n * W, stacks[0].entering(t, b));
        lanes_in(u + (size_t)t * m, (size_t)T * m, m, b, B, stacks[0].entering(t, b) + (size_t)n * W);
      }
      stacks[0].forward(t);
      for (int b = 0; b < blocks; b++) {
        R *now = x_at(t, b), *next = x_at(t + 1, b), *moved = y + (size_t)b * n * W;
        readouts[0].forward(stacks[0].top(t, b), given_at(t + 1, b));
        R last[STATE * W];
        store_state(body.step(state(now), applied(t, b)), last);
        if (t + 1 < T || !c.keep) std::copy_n(last, STATE * W, next);
        pick(last, moved);
        lanes_out(moved, n, b, B, out(c.before) + (size_t)t * n, (size_t)T * n);
        if (stacks.size() > 1) {
          R* enters = stacks[1].entering(t, b);
          std::copy_n(moved, (size_t)n * W, enters);
          std::copy_n(given_at(t + 1, b), LOAD * W, enters + (size_t)n * W);
          lanes_in(u + (size_t)t * m, (size_t)T * m, m, b, B, enters + (size_t)(n + LOAD) * W);
        }
        if (t + 1 == T) std::copy_n(last, STATE * W, dx + (size_t)b * STATE * W);
      }
      if (stacks.size() > 1) stacks[1].forward(t);
      for (int b = 0; b < blocks; b++) {
        R *moved = y + (size_t)b * n * W, *said = own + (size_t)b * n * W;
        R* next = t + 1 < T || !c.keep ? x_at(t + 1, b) : dx + (size_t)b * STATE * W;
        std::copy_n(moved, (size_t)n * W, said);
        if (stacks.size() > 1) {
          readouts[1].forward(stacks[1].top(t, b), said);
          if (c.added)
            for (int i = 0; i < n * W; i++) said[i] += moved[i];
        }
        lanes_out(said, n, b, B, out(c.after) + (size_t)t * n, (size_t)T * n);
        if (forced) lanes_in(forced + (size_t)t * n, (size_t)T * n, n, b, B, said);
        if (forced || stacks.size() > 1)
          for (int j = 0; j < n; j++)
            for (int i = 0; i < W; i++) next[c.rows[j] * W + i] += scale[j] * (said[j * W + i] - moved[j * W + i]);
        std::copy_n(said, (size_t)n * W, moved);
      }
    }
    for (int b = 0; b < blocks; b++)
      lanes_out(T && c.keep ? dx + (size_t)b * STATE * W : x_at(T, b), STATE, b, B, out(c.end_state), STATE);
    for (size_t i = 0; i < stacks.size(); i++) stacks[i].states_out(out(c.end_hidden[i]), out(c.end_cell[i]), c.layers * c.cells, B, T);
  }

  void backward() {
    pack(true);
    const R *scale = in(c.scale), *unit = in(c.load_scale);
    const Body body(R(c.dt), R(c.gravity), in(c.coupling));
    R* d_coupling = out(c.d_coupling);
    std::fill_n(d_coupling, 3, R(0));
    for (size_t i = 0; i < stacks.size(); i++) {
      stacks[i].begin(in(c.d_end_hidden[i]), in(c.d_end_cell[i]), c.layers * c.cells, B);
      readouts[i].begin();
    }
    for (int b = 0; b < blocks; b++) lanes_in(in(c.d_end_state), STATE, STATE, b, B, dx + (size_t)b * STATE * W);
    std::fill_n(d_fed, (size_t)blocks * n * W, R(0));
    std::fill_n(d_start, (size_t)blocks * LOAD * W, R(0));
    const bool corrected = c.forced || stacks.size() > 1;
    for (int t = T - 1; t >= 0; t--) {
      for (int b = 0; b < blocks; b++) {  // y, and what was moved
        const size_t at = (size_t)b * n * W;
        lanes_in(in(c.d_after) + (size_t)t * n, (size_t)T * n, n, b, B, dy + at);
        lanes_in(in(c.d_before) + (size_t)t * n, (size_t)T * n, n, b, B, d_moved + at);
        for (int j = 0; j < n; j++)
          for (int i = 0; i < W; i++) {
            const size_t k = at + j * W + i;
            const R into = corrected ? scale[j] * dx[((size_t)b * STATE + c.rows[j]) * W + i] : R(0);
            if (!c.forced) dy[k] += d_fed[k] + into;
            d_moved[k] -= into;
            if (stacks.size() == 1 || c.added) d_moved[k] += dy[k];
          }
      }
      std::fill_n(d_give, (size_t)blocks * LOAD * W, R(0));
      if (stacks.size() > 1) {
        stacks[1].backward(t, readouts[1].backward(dy, (size_t)n * W, [&](int b) { return stacks[1].top(t, b); }));
        for (int b = 0; b < blocks; b++) {
          const R* d = stacks[1].d_entering(b);
          for (int i = 0; i < n * W; i++) d_moved[(size_t)b * n * W + i] += d[i];
          std::copy_n(d + (size_t)n * W, LOAD * W, d_give + (size_t)b * LOAD * W);
        }
      }
      for (int b = 0; b < blocks; b++) {
        R *d = dx + (size_t)b * STATE * W, *d_end = d_start + (size_t)b * LOAD * W, *give = d_give + (size_t)b * LOAD * W;
        for (int j = 0; j < n; j++)
          for (int i = 0; i < W; i++) d[c.rows[j] * W + i] += d_moved[((size_t)b * n + j) * W + i] / scale[j];
        typename Body::State gradient = state(d);
        const typename Body::Loads of = body.back(state(x_at(t, b)), applied(t, b), gradient, d_coupling);
        store_state(gradient, d);
        for (int r = 0; r < LOAD; r++) {
          const Pair<R> start = part(of, 0, r), middle = part(of, 1, r), end = part(of, 2, r);
          if (c.d_given) {
            R* to = out(c.d_given) + ((size_t)t * 3 * LOAD + r) * B + (size_t)b * W;
            partial_out(start, b, to), partial_out(middle, b, to + (size_t)LOAD * B);
            partial_out(end, b, to + (size_t)2 * LOAD * B);
          }
          const Pair<R> late = R(0.5) * middle + end, early = R(0.5) * middle + start;
          const Pair<R> reached = Pair<R>(d_end + r * W) + (c.held ? Pair<R>(R(0)) : late);
          (Pair<R>(give + r * W) + reached * unit[r]).store_to(give + r * W);
          (c.held ? early + late : early).store_to(d_end + r * W);
        }
      }
      stacks[0].backward(t, readouts[0].backward(d_give, (size_t)LOAD * W, [&](int b) { return stacks[0].top(t, b); }));
      for (int b = 0; b < blocks; b++) {
        const R* d = stacks[0].d_entering(b);
        std::copy_n(d, (size_t)n * W, d_fed + (size_t)b * n * W);
        if (!c.du) continue;
        R more[W];
        R* du = out(c.du) + (size_t)t * m;
        for (int r = 0; r < m; r++) {
          for (int i = 0; i < W; i++) more[i] = d[(n + r) * W + i];
          if (stacks.size() > 1)
            for (int i = 0; i < W; i++) more[i] += stacks[1].d_entering(b)[(n + LOAD + r) * W + i];
          lanes_out(more, 1, b, B, du + r, (size_t)T * m);
        }
      }
    }
    for (int b = 0; b < blocks; b++) {  // the load at the start, and the outputs there
      R *d = dx + (size_t)b * STATE * W, *give = d_start + (size_t)b * LOAD * W;
      for (int j = 0; j < n; j++)
        for (int i = 0; i < W; i++) d[c.rows[j] * W + i] += d_fed[((size_t)b * n + j) * W + i] / scale[j];
      for (int r = 0; r < LOAD; r++)
        for (int i = 0; i < W; i++) give[r * W + i] *= unit[r];
      lanes_out(d, STATE, b, B, out(c.d_state), STATE);
    }
    const int top = int(c.layers) - 1;
    stacks[0].push(readouts[0].backward(d_start, (size_t)LOAD * W, [&](int b) { return stacks[0].x(top, 0, b); }));
    for (size_t i = 0; i < stacks.size(); i++) {
      stacks[i].end(out(c.d_hidden[i]), out(c.d_cell[i]), c.layers * c.cells, B);
      void* const* g = c.gradients + i * (4 * c.layers + 2);
      std::vector<LayerGradients<R>> layers;
      for (int l = 0; l < c.layers; l++, g += 4) layers.push_back({out(g[0]), out(g[1]), out(g[2]), out(g[3])});
      stacks[i].gradients(layers.data());
      readouts[i].gradients(out(g[0]), out(g[1]));
    }
  }

 private:
  void pack(bool backward) {
    for (size_t i = 0; i < stacks.size(); i++) {
      const void* const* w = c.weights + i * (4 * c.layers + 2);
      std::vector<LayerWeights<R>> layers;
      for (int l = 0; l < c.layers; l++, w += 4) layers.push_back({in(w[0]), in(w[1]), in(w[2]), in(w[3])});
      stacks[i].pack(layers.data(), backward);
      readouts[i].pack(in(w[0]), in(w[1]));
    }
  }

  // Scaled outputs (n, block) of a state (13, block).
  void pick(const R* from, R* to) const {
    const R *scale = in(c.scale), *offset = in(c.offset);
    for (int j = 0; j < n; j++)
      for (int i = 0; i < W; i++) to[j * W + i] = (from[c.rows[j] * W + i] - offset[j]) / scale[j];
  }

  // Bodies that are not there get an attitude, lest they divide by zero.
  void upright(R* from, int b) const {
    for (int i = 0; i < W; i++)
      if (b * W + i >= B) from[9 * W + i] = 1;
  }

  typename Body::Loads applied(int t, int b) const {
    const R *start = given_at(t, b), *end = c.held ? start : given_at(t + 1, b);
    const R *more = in(c.given), *unit = in(c.load_scale);
    typename Body::Loads u;
    for (int r = 0; r < LOAD; r++) {
      const Pair<R> first = Pair<R>(start + r * W) * unit[r], last = Pair<R>(end + r * W) * unit[r];
      Pair<R> moments[3] = {first, first + R(0.5) * (last - first), last};
      for (int k = 0; k < 3; k++) {
        if (more) moments[k] = moments[k] + partial_in(more + (((size_t)t * 3 + k) * LOAD + r) * B + (size_t)b * W, b);
        (r ? u.torque[k][r - 1] : u.thrust[k]) = moments[k];
      }
    }
    return u;
  }
  static Pair<R> part(const typename Body::Loads& u, int k, int r) { return r ? u.torque[k][r - 1] : u.thrust[k]; }

  Pair<R> partial_in(const R* from, int b) const {
    R row[W] = {};
    std::copy_n(from, std::min(W, B - b * W), row);
    return Pair<R>(row);
  }
  void partial_out(const Pair<R>& v, int b, R* to) const {
    R row[W];
    v.store_to(row);
    std::copy_n(row, std::min(W, B - b * W), to);
  }

  static typename Body::State state(const R* from) {
    typename Body::State s;
    for (int a = 0; a < 3; a++) {
      s.p[a] = Pair<R>(from + a * W), s.v[a] = Pair<R>(from + (3 + a) * W), s.w[a] = Pair<R>(from + (10 + a) * W);
    }
    for (int a = 0; a < 4; a++) s.q[a] = Pair<R>(from + (6 + a) * W);
    return s;
  }
  static void store_state(const typename Body::State& s, R* to) {
    for (int a = 0; a < 3; a++) {
      s.p[a].store_to(to + a * W), s.v[a].store_to(to + (3 + a) * W), s.w[a].store_to(to + (10 + a) * W);
    }
    for (int a = 0; a < 4; a++) s.q[a].store_to(to + (6 + a) * W);
  }
};

}  // namespace

extern "C" {
void hybrid_sizes_f(Call* c) { Run<float>(*c).sizes(*c); }
void hybrid_sizes_d(Call* c) { Run<double>(*c).sizes(*c); }
void hybrid_forward_f(const Call* c) { Run<float>(*c).forward(); }
void hybrid_forward_d(const Call* c) { Run<double>(*c).forward(); }
void hybrid_backward_f(const Call* c) { Run<float>(*c).backward(); }
void hybrid_backward_d(const Call* c) { Run<double>(*c).backward(); }
}
