// One model after another: where the numbers of each are, and what call.py calls.
#pragma once
#include <cstddef>
#include <cstdint>

// As call.py describes it: the models themselves may lie apart.
struct Weight {
  const void* data;
  int64_t stride;  // numbers from a model to the next
};

// The numbers of a model among those of all, `size` each; null where there are none.
template <class R> static inline const R* in(const void* all, size_t model, size_t size) {
  return all ? static_cast<const R*>(all) + model * size : nullptr;
}
template <class R> static inline R* out(void* all, size_t model, size_t size) {
  return all ? static_cast<R*>(all) + model * size : nullptr;
}
template <class R> static inline const R* in(const Weight& w, size_t model) { return in<R>(w.data, model, w.stride); }

// Of a file's `Run`, for floats and doubles: family_forward_f and so on.
#define EXPORT_TYPE(family, kind, R)                                                \
  void family##_sizes_##kind(Call* c) { Run<R>(*c, 0).sizes(*c); }                  \
  void family##_forward_##kind(const Call* c) {                                     \
    for (int model = 0; model < c->models; model++) Run<R>(*c, model).forward(model); \
  }                                                                                 \
  void family##_backward_##kind(const Call* c) {                                    \
    for (int model = 0; model < c->models; model++) Run<R>(*c, model).backward(model); \
  }
#define EXPORT(family) \
  extern "C" {         \
  EXPORT_TYPE(family, f, float) EXPORT_TYPE(family, d, double) }
