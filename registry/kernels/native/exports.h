// What call.py calls of a file's `Run`, one model after another, for floats and doubles: family_forward_f and so on.
#pragma once

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
