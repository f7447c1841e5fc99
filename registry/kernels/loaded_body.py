"""One step of a rigid body under a load that is linear in features of its motion, with a hand-written gradient.

The load is (angular acceleration / `ANGULAR`, specific force) in body axes. A step of length dt from rates ω, velocity
v and attitude R turns the body by A = Cayley(dt (ω + ω⁺)/2), and with α and f from the load

    ω⁺ = ω + dt α     R⁺ = R A     v⁺ = v + dt (½ (R + R⁺) f − g e3)

of second order in dt but for what the load makes of the rates and the velocity, which are those at the start.
Vectors of the world are kept in body axes, v_b = Rᵀ v; they and the rows of R turn by Aᵀ. Arrays are feature-major.
"""

from typing import Any

import torch
from torch import Tensor

GRAVITY = 9.81
ANGULAR = 50.0
"""Unit of the first three components of the load [rad/s²]; the others are in m/s²."""
_GYRATION = ((1, 2), (2, 0), (0, 1))


def features(speed: Tensor, surplus: Tensor, yaw: Tensor, v: Tensor, w: Tensor, more: int = 0) -> Tensor:
    """What the load may depend on beside the rotor speeds alone: 17 + 2m rows, and ``more`` empty ones.

    Args:
        speed: (m, …) mean rotor speeds over the step, relative to hover's.
        surplus: (…) mean of their squares less one.
        yaw: (…) sum of their squares, each with the rotor's direction.
        v: (3, …) velocity in body axes, in any unit.
        w: (3, …) body rates, in any unit.
        more: rows left for the caller.

    Returns:
        v, w/5, (w_y w_z, w_z w_x, w_x w_y)/20, 5 v × surplus, v|v|, 3 v_xy × yaw, speed × v_z, speed × (v_x² + v_y²).
    """
    m = len(speed)
    out = v.new_empty(17 + 2 * m + more, *v.shape[1:])
    out[:3] = v
    torch.mul(w, 0.2, out=out[3:6])
    for row, (i, j) in enumerate(_GYRATION):
        torch.mul(w[i], w[j], out=out[6 + row])
    out[6:9] *= 0.05
    torch.mul(v, 5 * surplus, out=out[9:12])
    torch.mul(v, v.abs(), out=out[12:15])
    torch.mul(v[:2], 3 * yaw, out=out[15:17])
    torch.mul(speed, v[2], out=out[17 : 17 + m])
    torch.mul(speed, v[:2].square().sum(0), out=out[17 + m : 17 + 2 * m])
    return out


class LoadedBody:
    """The step of one body; its weights and constant tables are laid out once a call."""

    def __init__(self, dt: float, unit_v: float, unit_w: float, weight: Tensor) -> None:
        """
        Args:
            dt: length of a step [s].
            unit_v, unit_w: units of velocity [m/s] and body rates [rad/s] in the features.
            weight: (6, 17 + 2m + H) the load of each row of `features`, then of H further ones.
        """
        self.dt, self.weight = dt, weight
        self.per_unit = weight.new_tensor([1 / unit_v] * 3 + [1 / unit_w] * 3).unsqueeze(-1)
        self.identity = torch.eye(3, dtype=weight.dtype, device=weight.device).unsqueeze(-1)
        cross = weight.new_zeros(9, 3)  # a ↦ [a]×, row after row
        for row, axis, sign in ((1, 2, -1), (2, 1, 1), (3, 2, 1), (5, 0, -1), (6, 1, -1), (7, 0, 1)):
            cross[row, axis] = sign
        self.cross = cross

    def __call__(
        self, rotation: Tensor, motion: Tensor, hidden: Tensor, given: Tensor, rotors: tuple[Tensor, Tensor, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Rotation and motion a step later.

        Args:
            rotation: (3, 3, B) body to world; its last row is up, in body axes.
            motion: (6, B) velocity [m/s] and body rates [rad/s], both in body axes.
            hidden: (H, B) further rows of the features.
            given: (6, B) what is added to the load.
            rotors: speed (m, B), surplus (B,) and yaw (B,) of `features`; no gradient flows to them.
        """
        stepped: tuple[Tensor, Tensor] = _Step.apply(rotation, motion, hidden, given, self.weight, self, *rotors)
        return stepped


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        rotation: Tensor,
        motion: Tensor,
        hidden: Tensor,
        given: Tensor,
        weight: Tensor,
        body: LoadedBody,
        speed: Tensor,
        surplus: Tensor,
        yaw: Tensor,
    ) -> tuple[Tensor, Tensor]:
        dt, n = body.dt, motion.shape[-1]
        scaled = motion * body.per_unit
        rows = features(speed, surplus, yaw, scaled[:3], scaled[3:], len(hidden))
        rows[len(rows) - len(hidden) :] = hidden
        load = torch.addmm(given, weight, rows)
        moved = torch.empty_like(motion)
        rates = torch.add(motion[3:], load[:3], alpha=dt * ANGULAR, out=moved[3:])
        half = load[3:] * (dt / 2)
        a = torch.add(motion[3:], rates).mul_(dt / 4)
        outer = torch.addmm(body.identity.view(9, 1), body.cross, a).view(3, 3, n).addcmul_(a.unsqueeze(1), a)
        s = a.square().sum(0).add_(1).reciprocal_().mul_(2)
        cayley = (outer * s).sub_(body.identity)
        vectors = torch.empty(4, 3, n, dtype=motion.dtype, device=motion.device)
        vectors[:3] = rotation
        torch.add(motion[:3], half, out=vectors[3]).add_(rotation[2], alpha=-GRAVITY * dt)
        turned = (vectors.unsqueeze(2) * cayley).sum(1)
        torch.add(turned[3], half, out=moved[:3])
        ctx.save_for_backward(scaled, rows, weight, a, outer, s, cayley, vectors, speed, surplus, yaw)
        ctx.body, ctx.hidden = body, len(hidden)
        return turned[:3], moved

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        d_rotation, d_moved = grads
        scaled, rows, weight, a, outer, s, cayley, vectors, speed, surplus, yaw = ctx.saved_tensors
        body, dt, m, n = ctx.body, ctx.body.dt, len(speed), scaled.shape[-1]
        d_turned = torch.cat([d_rotation, d_moved[:3].unsqueeze(0)])
        d_vectors = (d_turned.unsqueeze(1) * cayley).sum(2)
        d_cayley = (vectors.unsqueeze(2) * d_turned.unsqueeze(1)).sum(0)
        d_s = (d_cayley * outer).sum((0, 1))
        d_outer = d_cayley.mul_(s)
        d_a = body.cross.T @ d_outer.view(9, n)
        d_a += ((d_outer + d_outer.transpose(0, 1)) * a).sum(1)
        d_a.addcmul_(a, d_s.mul_(s).mul_(s), value=-1).mul_(dt / 4)  # of ω and of ω⁺
        d_motion = torch.empty_like(scaled)
        d_load = torch.empty_like(scaled)
        d_rates = torch.add(d_moved[3:], d_a)
        torch.add(d_rates, d_a, out=d_motion[3:])
        torch.mul(d_rates, dt * ANGULAR, out=d_load[:3])
        torch.add(d_moved[:3], d_vectors[3], out=d_load[3:]).mul_(dt / 2)
        d_motion[:3] = d_vectors[3]
        d_vectors[2].add_(d_vectors[3], alpha=-GRAVITY * dt)
        d_rows = weight.T @ d_load
        v, w = scaled[:3], scaled[3:]
        d_scaled = torch.empty_like(scaled)
        dv = torch.addcmul(d_rows[:3], d_rows[9:12], 5 * surplus, out=d_scaled[:3])
        dv.addcmul_(v.abs(), d_rows[12:15], value=2)
        across = (d_rows[17 + m : 17 + 2 * m] * speed).sum(0)
        dv[:2].addcmul_(d_rows[15:17], yaw, value=3).addcmul_(v[:2], across, value=2)
        dv[2] += (d_rows[17 : 17 + m] * speed).sum(0)
        dw = torch.mul(d_rows[3:6], 0.2, out=d_scaled[3:])
        for row, (i, j) in enumerate(_GYRATION):
            dw[i].addcmul_(d_rows[6 + row], w[j], value=0.05)
            dw[j].addcmul_(d_rows[6 + row], w[i], value=0.05)
        d_motion.addcmul_(d_scaled, body.per_unit)
        d_weight = d_load @ rows.T if ctx.needs_input_grad[4] else None
        return d_vectors[:3], d_motion, d_rows[len(d_rows) - ctx.hidden :], d_load, d_weight, None, None, None, None
