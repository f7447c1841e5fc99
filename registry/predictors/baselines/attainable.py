"""How well recordings can be predicted at all: the simulator that made them, started from what was measured."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Dataset, Predictor, PredictorEntry, Problem, StateLayout, places
from registry.core import PREDICTORS
from registry.errors import BenchError
from registry.predictors.baselines.known_flight import known
from registry.units import SIGNALS

STEPS = 2
"""Gauss–Newton steps; the second one moves what is predicted by less than a thousandth of its error."""
NUDGE = 1e-5
"""By which the unknowns are moved for slopes, SI."""


class AttainablePredictor(Predictor):
    """Free run of `Problem.truth` from the state that explains the history best; see `Attainable`.

    State: [u_{k0} | the simulator's at k0], SI.
    """

    def __init__(self, entry: "Attainable", problem: Problem) -> None:
        super().__init__(problem)
        flight = known(problem.truth, 1 / problem.rate)
        if flight is None:
            raise BenchError("`attainable` needs the simulator that made the recordings: it is for simulated flights.")
        self.flight, self.history = flight, problem.history
        seen = (*problem.outputs, *problem.context)
        odd = {c.group for c in problem.outputs} - set(flight.told)
        if odd or self.n_inputs != 4 or not set(flight.measured) <= {c.group for c in seen}:
            raise BenchError(
                f"`attainable` predicts {', '.join(flight.told)} from the measured {', '.join(flight.measured)}: "
                "name no others, and no --context."
            )
        self.place = {signal: places(seen, [signal], "The history") for signal in flight.measured}
        """Columns of outputs and context."""
        self.telling = [(c.group, SIGNALS[c.group].axes.index(c.axis)) for c in problem.outputs]
        self.layout = StateLayout(self.n_inputs + flight.size, 0, 0)

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """What drives it at k0, and the state at k0 by least squares over what the history measured."""
        flight, (measured, context) = self.flight, outputs.split([self.n_outputs, self.n_context], -1)
        assert self.context_scaler is not None
        told = torch.cat([self.output_scaler.invert(measured), self.context_scaler.invert(context)], -1).double()
        seen, u = {s: told[..., at] for s, at in self.place.items()}, self.input_scaler.invert(inputs).double()
        first, count = flight.begin(seen, u), flight.unknowns
        unknown = first.new_zeros(*first.shape[:-1], count)
        each = {s: x.expand(count + 1, *x.shape) for s, x in seen.items()}
        nudges = NUDGE * torch.eye(count + 1, count, dtype=first.dtype, device=first.device)  # the last row: none
        for _ in range(STEPS if u.shape[-2] > 2 else 0):
            tried = unknown + nudges.view(count + 1, *[1] * (unknown.dim() - 1), count)
            begun = flight.moved(first.expand(count + 1, *first.shape), tried)
            run = flight.run(begun, u.expand(count + 1, *u.shape))
            off = torch.cat([flight.off(run, each), flight.unlikely(tried)], -1)
            slopes = ((off[:-1] - off[-1]) / NUDGE).movedim(0, -1)
            right = slopes.mT @ off[-1].unsqueeze(-1)
            unknown = unknown - torch.linalg.solve(slopes.mT @ slopes, right).squeeze(-1)
        end = flight.run(flight.moved(first, unknown), u)[..., -1, :]
        return torch.cat([u[..., -1, :], end], -1).to(inputs.dtype)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`. ``feedback`` is not looked at: the history has said what there is to say."""
        u = torch.cat([state[..., None, : self.n_inputs], self.input_scaler.invert(inputs)], -2).double()
        run = self.flight.run(state[..., self.n_inputs :].double(), u)
        signals = {s: values.unbind(-1) for s, values in self.flight.predicted(run).items()}
        outputs = torch.stack([signals[s][i] for s, i in self.telling], -1).to(inputs.dtype)
        return self.output_scaler(outputs), torch.cat([u[..., -1, :], run[..., -1, :]], -1).to(inputs.dtype)


@PREDICTORS.register("attainable")
@dataclass(frozen=True)
class Attainable(PredictorEntry):
    """The simulator that made the flights, started from the measured history: nothing can be expected below its error.

    What it cannot know are errors of measurement: of the start, as a smoother over the history leaves it, of recorded
    inputs, and of what it is judged by; and gusts that nobody records. It smooths by least squares, so a cleverer
    smoother may be a little better.
    """

    training: ClassVar[str] = "none"
    stateful: ClassVar[bool] = False

    @override
    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        flight = known(dataset.truth, 0.01)
        return dataset.inputs, dataset.predicted_together(), flight.measured if flight else ()

    @override
    def build(self, problem: Problem) -> Predictor:
        return AttainablePredictor(self, problem)
