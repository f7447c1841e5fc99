// One Runge–Kutta step of a rigid body, forward and back: the equations of registry/kernels/rigid_body.py, a lane a body.
#pragma once
#include <cmath>

#include "vectors.h"

template <class R> class RigidBody {
  typedef Pair<R> L;

 public:
  // Position and velocity in the world, attitude xyzw, body rates.
  struct State {
    L p[3], v[3], q[4], w[3];
  };
  // Thrust over mass and torques over inertia at the start, the middle and the end of a step.
  struct Loads {
    L thrust[3], torque[3][3];
  };

  RigidBody(R dt, R gravity, const R* coupling) : dt(dt), g(gravity), k{coupling[0], coupling[1], coupling[2]} {}

  State step(const State& x, const Loads& u) const {
    Stages s;
    follow(x, u, s);
    State out;
    for (int a = 0; a < 3; a++) {
      L push = R(0), carry = R(0);
      for (int i = 0; i < 4; i++) push = push + share(i) * pushed(s, i, a);
      for (int i = 0; i < 3; i++) carry = carry + pushed(s, i, a);
      const R fall = a == 2 ? g : R(0);
      out.p[a] = x.p[a] + dt * x.v[a] + dt * dt / 6 * carry - fall * dt * dt / 2;
      out.v[a] = x.v[a] + dt * push - fall * dt;
      out.w[a] = s.turned[4 + a];
    }
    const L shrink = R(1) / length(s.turned);
    for (int a = 0; a < 4; a++) out.q[a] = s.turned[a] * shrink;
    return out;
  }

  // From the gradient of the state after the step, d, to those of the state before it (in d), of the loads and, summed
  // over the lanes, of the coupling.
  Loads back(const State& x, const Loads& u, State& d, R* d_coupling) const {
    Stages s;
    follow(x, u, s);
    const L shrink = R(1) / length(s.turned);
    L along = R(0), d_turned[7];
    for (int a = 0; a < 4; a++) along = along + s.turned[a] * shrink * d.q[a];
    for (int a = 0; a < 4; a++) d_turned[a] = shrink * (d.q[a] - s.turned[a] * shrink * along);
    for (int a = 0; a < 3; a++) d_turned[4 + a] = d.w[a];
    L d_slope[4][7], d_start[7];
    for (int r = 0; r < 7; r++) {
      d_start[r] = d_turned[r];
      for (int i = 0; i < 4; i++) d_slope[i][r] = dt * share(i) * d_turned[r];
    }
    L d_thrust[4], d_k[3] = {R(0), R(0), R(0)};
    for (int i = 3; i >= 0; i--) {
      L d_stage[7];
      d_thrust[i] = back_tilt(s, i, d, d_stage);
      back_turning(s.z[i], d_slope[i], d_stage);
      for (int a = 0; a < 3; a++) {
        const int b = (a + 1) % 3, c = (a + 2) % 3;
        d_k[a] = d_k[a] + d_slope[i][4 + a] * s.z[i][4 + b] * s.z[i][4 + c];
      }
      for (int r = 0; r < 7; r++) {
        d_start[r] = d_start[r] + d_stage[r];
        if (i) d_slope[i - 1][r] = d_slope[i - 1][r] + dt * ahead(i - 1) * d_stage[r];
      }
    }
    for (int a = 0; a < 3; a++) d_coupling[a] += sum<R>(d_k[a].both());
    for (int a = 0; a < 3; a++) d.v[a] = d.v[a] + dt * d.p[a], d.w[a] = d_start[4 + a];
    for (int a = 0; a < 4; a++) d.q[a] = d_start[a];
    Loads out;
    out.thrust[0] = d_thrust[0], out.thrust[1] = d_thrust[1] + d_thrust[2], out.thrust[2] = d_thrust[3];
    for (int a = 0; a < 3; a++) {
      out.torque[0][a] = d_slope[0][4 + a], out.torque[1][a] = d_slope[1][4 + a] + d_slope[2][4 + a];
      out.torque[2][a] = d_slope[3][4 + a];
    }
    return out;
  }

 private:
  const R dt, g, k[3];

  struct Stages {
    L z[4][7];         // attitude and rates at each stage
    L tilt[4][3];      // |q|² R e3
    L lift[4], size[4];  // thrust over |q|², and |q|²
    L turned[7];       // attitude and rates after the step, before the attitude is made one of length 1
  };
  static constexpr R share(int i) { return i == 0 || i == 3 ? R(1) / 6 : R(1) / 3; }
  static constexpr R ahead(int i) { return i < 2 ? R(0.5) : R(1); }
  static constexpr int moment(int i) { return (i + 1) / 2; }
  static L pushed(const Stages& s, int i, int a) { return s.tilt[i][a] * s.lift[i]; }

  static L length(const L* q) {
    L n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    for (auto& v : n.v)
      for (int i = 0; i < Width<R>::vector; i++) v[i] = std::sqrt(v[i]);
    return n;
  }

  void follow(const State& x, const Loads& u, Stages& s) const {
    for (int a = 0; a < 4; a++) s.z[0][a] = x.q[a];
    for (int a = 0; a < 3; a++) s.z[0][4 + a] = x.w[a];
    for (int r = 0; r < 7; r++) s.turned[r] = s.z[0][r];
    for (int i = 0; i < 4; i++) {
      const L* q = s.z[i];
      const L* w = q + 4;
      L slope[7] = {R(0.5) * (q[3] * w[0] + q[1] * w[2] - q[2] * w[1]), R(0.5) * (q[3] * w[1] + q[2] * w[0] - q[0] * w[2]),
                    R(0.5) * (q[3] * w[2] + q[0] * w[1] - q[1] * w[0]), R(-0.5) * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2])};
      for (int a = 0; a < 3; a++) slope[4 + a] = u.torque[moment(i)][a] + k[a] * w[(a + 1) % 3] * w[(a + 2) % 3];
      for (int r = 0; r < 7; r++) {
        if (i < 3) s.z[i + 1][r] = s.z[0][r] + dt * ahead(i) * slope[r];
        s.turned[r] = s.turned[r] + dt * share(i) * slope[r];
      }
      s.tilt[i][0] = R(2) * (q[0] * q[2] + q[1] * q[3]);
      s.tilt[i][1] = R(2) * (q[1] * q[2] - q[0] * q[3]);
      s.tilt[i][2] = q[2] * q[2] + q[3] * q[3] - q[0] * q[0] - q[1] * q[1];
      s.size[i] = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
      s.lift[i] = u.thrust[moment(i)] / s.size[i];
    }
  }

  // The gradients of the thrust and of the attitude (in d_stage) of stage i through the acceleration.
  L back_tilt(const Stages& s, int i, const State& d, L* d_stage) const {
    L d_tilt[3], d_lift = R(0);
    for (int a = 0; a < 3; a++) {
      const L d_pushed = (i < 3 ? dt * dt / 6 : R(0)) * d.p[a] + dt * share(i) * d.v[a];
      d_tilt[a] = d_pushed * s.lift[i];
      d_lift = d_lift + d_pushed * s.tilt[i][a];
    }
    const L d_thrust = d_lift / s.size[i], d_size = R(0) - d_thrust * s.lift[i];
    const L* q = s.z[i];
    d_stage[0] = R(2) * (q[2] * d_tilt[0] - q[3] * d_tilt[1] - q[0] * d_tilt[2] + q[0] * d_size);
    d_stage[1] = R(2) * (q[3] * d_tilt[0] + q[2] * d_tilt[1] - q[1] * d_tilt[2] + q[1] * d_size);
    d_stage[2] = R(2) * (q[0] * d_tilt[0] + q[1] * d_tilt[1] + q[2] * d_tilt[2] + q[2] * d_size);
    d_stage[3] = R(2) * (q[1] * d_tilt[0] - q[0] * d_tilt[1] + q[3] * d_tilt[2] + q[3] * d_size);
    return d_thrust;
  }

  // Adds to d_stage what reaches attitude and rates through the slope.
  void back_turning(const L* z, const L* d, L* d_stage) const {
    const R h = R(0.5);
    const L *q = z, *w = z + 4;
    d_stage[0] = d_stage[0] + h * (w[1] * d[2] - w[2] * d[1] - w[0] * d[3]);
    d_stage[1] = d_stage[1] + h * (w[2] * d[0] - w[0] * d[2] - w[1] * d[3]);
    d_stage[2] = d_stage[2] + h * (w[0] * d[1] - w[1] * d[0] - w[2] * d[3]);
    d_stage[3] = d_stage[3] + h * (w[0] * d[0] + w[1] * d[1] + w[2] * d[2]);
    d_stage[4] = h * (q[3] * d[0] + q[2] * d[1] - q[1] * d[2] - q[0] * d[3]);
    d_stage[5] = h * (q[3] * d[1] + q[0] * d[2] - q[2] * d[0] - q[1] * d[3]);
    d_stage[6] = h * (q[1] * d[0] + q[3] * d[2] - q[0] * d[1] - q[2] * d[3]);
    for (int a = 0; a < 3; a++) {
      const int b = (a + 1) % 3, c = (a + 2) % 3;
      d_stage[4 + b] = d_stage[4 + b] + k[a] * d[4 + a] * w[c];
      d_stage[4 + c] = d_stage[4 + c] + k[a] * d[4 + a] * w[b];
    }
  }
};
