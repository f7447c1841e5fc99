// Runs a list of statements on many lanes at once: every statement on a block of lanes before the next one.
// The operations are those of registry/equations/program.py, in that order (lanes.py sees to it), none of them contracted.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

namespace {

constexpr int LANES = 64;  // registers of a step of a model then stay in the second cache
typedef double Register[LANES];

enum Operation : int32_t {
  ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, NEGATIVE, SQRT, EXP, LOG, SIN, COS, TANH, ARCTAN2, ABS, SIGN, FLOOR, MAXIMUM,
  MINIMUM, GREATER, GREATER_EQUAL, WHERE
};

struct Statement {
  int32_t operation, to, a, b, c;
};

}  // namespace

extern "C" {

struct Argument {
  const double* values;
  int64_t size;                      // entries of a vector, one after another
  int64_t per_model, per_lane, per_step;  // from one vector to the next
  const int32_t* registers;          // of every entry; −1: it is not read
};

struct Run {
  int64_t models, lanes, steps, statements, constants, registers, arguments, outputs, fed;
  const Statement* code;
  const double* constant;
  const int32_t* constant_registers;
  const Argument* given;
  const int32_t* output_registers;
  double* out;
  int64_t per_model, per_lane, per_step, per_entry;  // of `out`
};

// Every model on every lane; of several steps, the first `fed` outputs of one are the first argument of the next.
void run_lanes(const Run* run);
}

namespace {

void compute(const Statement* code, int64_t count, Register* r) {
  for (int64_t i = 0; i < count; i++) {
    const Statement& s = code[i];
    double* to = r[s.to];
    const double *a = r[s.a], *b = r[s.b], *c = r[s.c];
#define EACH(expression)                                    \
  _Pragma("GCC ivdep") for (int l = 0; l < LANES; l++) to[l] = expression; \
  break
    switch (s.operation) {
      case ADD: EACH(a[l] + b[l]);
      case SUBTRACT: EACH(a[l] - b[l]);
      case MULTIPLY: EACH(a[l] * b[l]);
      case DIVIDE: EACH(a[l] / b[l]);
      case POWER: EACH(std::pow(a[l], b[l]));
      case NEGATIVE: EACH(-a[l]);
      case SQRT: EACH(std::sqrt(a[l]));
      case EXP: EACH(std::exp(a[l]));
      case LOG: EACH(std::log(a[l]));
      case SIN: EACH(std::sin(a[l]));
      case COS: EACH(std::cos(a[l]));
      case TANH: EACH(std::tanh(a[l]));
      case ARCTAN2: EACH(std::atan2(a[l], b[l]));
      case ABS: EACH(std::fabs(a[l]));
      case SIGN: EACH(a[l] > 0 ? 1.0 : a[l] < 0 ? -1.0 : a[l]);
      case FLOOR: EACH(std::floor(a[l]));
      case MAXIMUM: EACH(a[l] > b[l] || a[l] != a[l] ? a[l] : b[l]);  // what is no number stays none
      case MINIMUM: EACH(a[l] < b[l] || a[l] != a[l] ? a[l] : b[l]);
      case GREATER: EACH(a[l] > b[l] ? 1.0 : 0.0);
      case GREATER_EQUAL: EACH(a[l] >= b[l] ? 1.0 : 0.0);
      case WHERE: EACH(a[l] != 0 ? b[l] : c[l]);
    }
#undef EACH
  }
}

// The vectors of a block of lanes; lanes beyond the last one repeat it.
void take(const Argument& from, int64_t model, int64_t first, int64_t lanes, int64_t step, Register* r) {
  const double* start = from.values + model * from.per_model + step * from.per_step;
  for (int l = 0; l < LANES; l++) {
    const double* x = start + std::min(first + l, lanes - 1) * from.per_lane;
    for (int64_t i = 0; i < from.size; i++)
      if (from.registers[i] >= 0) r[from.registers[i]][l] = x[i];
  }
}

}  // namespace

void run_lanes(const Run* run) {
  std::vector<double> memory((run->registers + run->fed) * LANES + 8);
  auto address = reinterpret_cast<uintptr_t>(memory.data());
  auto* r = reinterpret_cast<Register*>((address + 63) & ~uintptr_t(63));
  Register* kept = r + run->registers;
  for (int64_t i = 0; i < run->constants; i++) std::fill_n(r[run->constant_registers[i]], LANES, run->constant[i]);
  for (int64_t m = 0; m < run->models; m++)
    for (int64_t first = 0; first < run->lanes; first += LANES) {
      const int64_t count = std::min<int64_t>(LANES, run->lanes - first);
      for (int64_t step = 0; step < run->steps; step++) {
        for (int64_t k = 0; k < run->arguments; k++) {
          const Argument& from = run->given[k];
          const bool alike = !from.per_step && step;
          if ((!k && run->fed && step) || (alike) || (!from.per_step && !from.per_lane && first)) continue;
          take(from, m, first, run->lanes, step, r);
        }
        compute(run->code, run->statements, r);
        double* to = run->out + m * run->per_model + first * run->per_lane + step * run->per_step;
        for (int64_t i = 0; i < run->outputs; i++) {
          const double* x = r[run->output_registers[i]];
          for (int l = 0; l < count; l++) to[l * run->per_lane + i * run->per_entry] = x[l];
        }
        for (int64_t i = 0; i < run->fed; i++) std::memcpy(kept[i], r[run->output_registers[i]], sizeof(Register));
        for (int64_t i = 0; i < run->fed; i++)
          if (run->given[0].registers[i] >= 0) std::memcpy(r[run->given[0].registers[i]], kept[i], sizeof(Register));
      }
    }
}
