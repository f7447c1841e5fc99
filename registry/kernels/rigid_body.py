"""One Runge–Kutta step of a rigid body under thrust along body z and torques, with a hand-written gradient.

The same equations and the same step as `registry.physics.rigid_body.RigidBody` without effects, with principal axes
of inertia: dp/dt = v, dv/dt = f R e3 − g e3, dq/dt = q ⊗ (ω, 0)/2, dω/dt = α + κ ∘ (ω_y ω_z, ω_z ω_x, ω_x ω_y).
Arrays are feature-major (features, B). The four stages of attitude and body rates follow one another; what they do to
velocity and position is then one product for all stages.
"""

from typing import Any

import torch
from torch import Tensor

from registry.kernels import plain

_AHEAD = (0.5, 0.5, 1.0)
"""How far, in time steps, stages 2, 3 and 4 look ahead along the slope of the stage before."""
_SHARE = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
"""Share of each stage in the step."""
_MOMENT = [0, 1, 1, 2]
"""The moment of each stage: start, middle, middle, end."""


def _turning() -> list[list[list[float]]]:
    """Coefficients (7, 7, 3) of the products of (q, ω) with ω in dq/dt and dω/dt; those of dω/dt are times κ."""
    table = [[[0.0] * 3 for _ in range(7)] for _ in range(7)]
    x, y, z, w, first = 0, 1, 2, 3, 4
    rows = {
        x: ((w, 0, 1), (y, 2, 1), (z, 1, -1)),
        y: ((w, 1, 1), (z, 0, 1), (x, 2, -1)),
        z: ((w, 2, 1), (x, 1, 1), (y, 0, -1)),
        w: ((x, 0, -1), (y, 1, -1), (z, 2, -1)),
    }
    for row, terms in rows.items():
        for left, right, sign in terms:
            table[row][left][right] = 0.5 * sign
    for axis in range(3):
        table[first + axis][first + (axis + 1) % 3][(axis + 2) % 3] = 1.0
    return table


def _upward() -> list[list[list[float]]]:
    """Coefficients (4, 4, 4), symmetric, of the products of q with itself in |q|² R e3 and |q|²."""
    table = [[[0.0] * 4 for _ in range(4)] for _ in range(4)]
    for row, left, right, sign in ((0, 0, 2, 1.0), (0, 1, 3, 1.0), (1, 1, 2, 1.0), (1, 0, 3, -1.0)):
        table[row][left][right] = table[row][right][left] = sign
    for i, sign in enumerate((-1.0, -1.0, 1.0, 1.0)):
        table[2][i][i], table[3][i][i] = sign, 1.0
    return table


class RigidBodyStep:
    """The step of one body; its constant tables are made once."""

    def __init__(self, dt: float, gravity: float, coupling: Tensor) -> None:
        """
        Args:
            dt: length of a step [s].
            gravity: g [m/s²].
            coupling: κ (3,), ((J_y − J_z)/J_x, (J_z − J_x)/J_y, (J_x − J_y)/J_z).
        """
        like, self.dt, self.gravity, self.coupling = coupling.detach(), dt, gravity, coupling
        turning = like.new_tensor(_turning())
        turning[4:] *= like[:, None, None]
        self.turning = turning.view(7, 21)
        self.upward = like.new_tensor(_upward()).view(4, 16)
        share = like.new_tensor(_SHARE)
        self.share = dt * share.view(1, 4)
        # p and v at the end, from p and v at the start and from the accelerations at the four stages
        self.drift = like.new_tensor([[1.0, dt], [0.0, 1.0]])
        self.push = torch.stack([dt * dt / 6 * like.new_tensor([1.0, 1.0, 1.0, 0.0]), dt * share])
        self.fall = like.new_tensor([[0.0, 0.0, -gravity * dt * dt / 2], [0.0, 0.0, -gravity * dt]]).unsqueeze(-1)

    def __call__(self, state: Tensor, start: Tensor, end: Tensor, given: Tensor | None = None) -> Tensor:
        """The state (13, B) after a step, its quaternion at unit length.

        Args:
            state: (13, B) position and velocity in the world, attitude xyzw of any length, body rates.
            start: (4, B) thrust over mass f [m/s²] and torque over inertia α [rad/s²], at the start of the step.
            end: (4, B) the same at its end; linear in between.
            given: (3, 4, B) a further part of them, at start, middle and end.
        """
        if plain.exporting():
            drive = torch.stack([start, (start + end) / 2, end])
            drive = drive if given is None else drive + given
            return plain.rigid_body(state, drive, self.turning, self.dt, self.gravity)
        stepped: Tensor = _Step.apply(state, start, end, given, self.coupling, self)
        return stepped


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, start: Tensor, end: Tensor, given: Tensor | None, coupling: Tensor, body: RigidBodyStep
    ) -> Tensor:
        n, dt = x.shape[-1], body.dt
        drive = torch.stack([start, torch.lerp(start, end, 0.5), end])
        if given is not None:
            drive += given
        bias = x.new_zeros(3, 7, n)
        bias[:, 4:] = drive[:, 1:]
        stages, slopes = x.new_empty(4, 7, n), x.new_empty(4, 7, n)
        stages[0] = x[6:]
        for i in range(4):
            z = stages[i]
            products = (z.unsqueeze(1) * z[4:]).view(21, n)
            torch.addmm(bias[_MOMENT[i]], body.turning, products, out=slopes[i])
            if i < 3:
                torch.add(x[6:], slopes[i], alpha=dt * _AHEAD[i], out=stages[i + 1])
        q = stages[:, :4]
        tilt = torch.matmul(body.upward, (q.unsqueeze(2) * q.unsqueeze(1)).view(4, 16, n))  # |q|² R e3, then |q|²
        lift = drive[_MOMENT, 0] / tilt[:, 3]  # (4, B)
        pushed = (tilt[:, :3] * lift.unsqueeze(1)).view(4, 3 * n)
        out = torch.empty_like(x, memory_format=torch.contiguous_format)
        moved = torch.addmm(body.drift @ x[:6].reshape(2, 3 * n), body.push, pushed)
        torch.add(moved.view(2, 3, n), body.fall, out=out[:6].view(2, 3, n))
        turned = torch.addmm(x[6:].reshape(1, 7 * n), body.share, slopes.view(4, 7 * n)).view(7, n)
        shrink = (turned[:4] * turned[:4]).sum(0).rsqrt_()
        torch.mul(turned[:4], shrink, out=out[6:10])
        out[10:] = turned[4:]
        ctx.save_for_backward(stages, tilt, lift, shrink, out[6:10])
        ctx.body, ctx.shared = body, given is not None
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (grad,), body, dt = grads, ctx.body, ctx.body.dt
        stages, tilt, lift, shrink, unit = ctx.saved_tensors
        n = grad.shape[-1]
        dx = torch.empty_like(stages[0], memory_format=torch.contiguous_format).new_empty(13, n)
        moved = grad[:6].reshape(2, 3 * n)
        torch.mm(body.drift.T, moved, out=dx[:6].view(2, 3 * n))
        d_pushed = (body.push.T @ moved).view(4, 3, n)
        d_tilt = torch.empty_like(tilt)
        torch.mul(d_pushed, lift.unsqueeze(1), out=d_tilt[:, :3])
        d_lift = (d_pushed * tilt[:, :3]).sum(1).div_(tilt[:, 3])  # of the thrust
        torch.mul(d_lift, lift, out=d_tilt[:, 3]).neg_()
        q = stages[:, :4]
        d_attitude = ((body.upward.T @ d_tilt).view(4, 4, 4, n) * q.unsqueeze(1)).sum(2).mul_(2)
        d_turned = torch.cat([grad[6:10].addcmul(unit, (unit * grad[6:10]).sum(0), value=-1).mul_(shrink), grad[10:]])
        d_slopes = body.share.view(4, 1, 1) * d_turned
        dz = dx[6:].copy_(d_turned)
        for i in (3, 2, 1, 0):
            z = stages[i]
            products = (body.turning.T @ d_slopes[i]).view(7, 3, n)
            d_stage = (products * z[4:]).sum(1)
            d_stage[4:] += (products * z.unsqueeze(1)).sum(0)
            d_stage[:4] += d_attitude[i]
            dz += d_stage
            if i:
                d_slopes[i - 1].add_(d_stage, alpha=dt * _AHEAD[i - 1])
        d_coupling = None
        if ctx.needs_input_grad[4]:
            w = stages[:, 4:]
            d_coupling = (d_slopes[:, 4:] * w[:, [1, 2, 0]] * w[:, [2, 0, 1]]).sum((0, 2))
        d_stages = torch.cat([d_lift.unsqueeze(1), d_slopes[:, 4:]], 1)
        middle = d_stages[1] + d_stages[2]
        d_start = torch.add(d_stages[0], middle, alpha=0.5)
        d_end = torch.add(d_stages[3], middle, alpha=0.5)
        d_given = torch.stack([d_stages[0], middle, d_stages[3]]) if ctx.shared else None
        return dx, d_start, d_end, d_given, d_coupling, None
