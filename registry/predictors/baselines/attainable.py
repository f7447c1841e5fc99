"""How well recordings can be predicted at all: the simulator that made them, started from what was measured."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from registry.contracts import Dataset, Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS
from registry.dynamics.rotations import quaternion_rate
from registry.errors import BenchError
from registry.physics.rigid_body import RigidBody

P, V, Q, W = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)
"""Position, velocity, attitude and body rates in the state of a rigid body."""
NOISE = 4e-4, 9e-5
"""1σ of the white errors of position [m] and attitude [rad], as the flights were measured: only their ratio counts."""
STEPS = 2
"""Gauss–Newton steps; the second one moves what is predicted by less than a thousandth of its error."""
SIGNALS = "velocity", "body_rates", "attitude", "position"


class AttainablePredictor(Predictor):
    """Free run of `Problem.truth` from the state that explains the history best; see `Attainable`.

    State: [u_{k0} | the rigid body's at k0], SI.
    """

    def __init__(self, entry: "Attainable", problem: Problem) -> None:
        super().__init__(problem)
        if not isinstance(problem.truth, RigidBody):
            raise BenchError("Nobody knows how these recordings came about: `attainable` is for simulated quadrotors.")
        self.model, self.dt, self.history = problem.truth, 1 / problem.rate, problem.history
        known = [c.group for c in (*problem.outputs, *problem.context)]
        odd = next((s for s in SIGNALS if known.count(s) != (4 if s == "attitude" else 3)), None)
        if odd or {c.group for c in problem.outputs} - {"velocity", "body_rates"} or self.n_inputs != 4:
            raise BenchError(
                "`attainable` predicts velocity and body_rates from rotor_speed, attitude and position: name no others."
            )
        place = {s: [i for i, g in enumerate(known) if g == s] for s in SIGNALS}
        self.order = [i for s in ("position", "velocity", "attitude", "body_rates") for i in place[s]]
        """Columns of outputs and context in the order of the state."""
        self.places = [c.group for c in problem.outputs]
        self.layout = StateLayout(self.n_inputs + 13, 0, 0)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """What drives it at k0, and the state at k0 by least squares over the history's positions and attitudes."""
        measured, context = outputs.split([self.n_outputs, self.n_context], -1)
        assert self.context_scaler is not None
        seen = torch.cat([self.output_scaler.invert(measured), self.context_scaler.invert(context)], -1)
        states, u = seen[..., self.order].double(), self.input_scaler.invert(inputs).double()
        first = self.model.project(states[..., 0, :])
        unknown = first.new_zeros(*first.shape[:-1], 12)
        nudges = 1e-5 * torch.eye(13, 12, dtype=first.dtype, device=first.device)  # the last row: none
        for _ in range(STEPS if states.shape[-2] > 2 else 0):
            tried = unknown + nudges.view(13, *[1] * (unknown.dim() - 1), 12)
            begun, known, driven = (x.expand(13, *x.shape) for x in (first, states, u))
            off = self._off(begun, known, driven, tried)
            slopes = ((off[:-1] - off[-1]) / 1e-5).movedim(0, -1)
            right = slopes.mT @ off[-1].unsqueeze(-1)
            unknown = unknown - torch.linalg.solve(slopes.mT @ slopes, right).squeeze(-1)
        end = self._run(self._moved(first, unknown), u)[..., -1, :]
        return torch.cat([u[..., -1, :], end], -1).to(inputs.dtype)

    def _moved(self, state: Tensor, by: Tensor) -> Tensor:
        """A state (…, 13) with position, velocity, rotation (body) and rates changed by (…, 12)."""
        turned = state[..., Q] + quaternion_rate(state[..., Q], by[..., 6:9])
        return self.model.project(torch.cat([state[..., P] + by[..., :3], state[..., V] + by[..., 3:6], turned,
                                             state[..., W] + by[..., 9:]], -1))  # fmt: skip

    def _run(self, state: Tensor, u: Tensor) -> Tensor:
        """States (…, N, 13) at the samples of the inputs (…, N, m), the first as given."""
        states = [state]
        for k in range(1, u.shape[-2]):
            states.append(self.model.step(states[-1], u[..., k - 1, :], u[..., k, :], self.dt))
        return torch.stack(states, -2)

    def _off(self, first: Tensor, states: Tensor, u: Tensor, by: Tensor) -> Tensor:
        """Positions and attitudes off the measured ones (…, 6 τ), each in units of its 1σ."""
        run = self._run(self._moved(first, by), u)
        place, turn = run[..., P] - states[..., P], rotation(states[..., Q], run[..., Q])
        return torch.cat([place / NOISE[0], turn / NOISE[1]], -1).flatten(-2)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`.

        Velocity and rates are differences of poses over a sampling period, as they were measured. ``feedback`` is not
        looked at: the history has said what there is to say.
        """
        u = torch.cat([state[..., None, : self.n_inputs], self.input_scaler.invert(inputs)], -2).double()
        run = self._run(state[..., self.n_inputs :].double(), u)
        velocity = run[..., P].diff(dim=-2) / self.dt
        rates = rotation(run[..., :-1, Q], run[..., 1:, Q]) / self.dt
        groups = {"velocity": iter(velocity.unbind(-1)), "body_rates": iter(rates.unbind(-1))}
        outputs = torch.stack([next(groups[g]) for g in self.places], -1).to(inputs.dtype)
        return self.output_scaler(outputs), torch.cat([u[..., -1, :], run[..., -1, :]], -1).to(inputs.dtype)


def rotation(first: Tensor, second: Tensor) -> Tensor:
    """The small rotation (…, 3) [rad], in body axes, that takes one attitude xyzw (…, 4) to another."""
    v0, w0, v1, w1 = first[..., :3], first[..., 3:], second[..., :3], second[..., 3:]
    vector = w0 * v1 - w1 * v0 - torch.linalg.cross(v0, v1)
    return 2 * vector * torch.sign(w0 * w1 + (v0 * v1).sum(-1, keepdim=True))


@PREDICTORS.register("attainable")
@dataclass(frozen=True)
class Attainable(PredictorEntry):
    """The simulator that made the flights, started from the measured history: nothing can be expected below its error.

    What it cannot know are errors of measurement: of the start, as a smoother over the history leaves it, of the rotor
    speeds, and of what it is judged by. It smooths by least squares, with no prior, so a cleverer smoother may be a
    little better.
    """

    training: ClassVar[str] = "none"
    stateful: ClassVar[bool] = False

    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """See `PredictorEntry.signals`."""
        return dataset.inputs, ("velocity", "body_rates"), ("attitude", "position")

    def build(self, problem: Problem) -> Predictor:
        """See `PredictorEntry.build`."""
        return AttainablePredictor(self, problem)
