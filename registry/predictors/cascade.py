"""Two networks in a row: the first predicts one signal, the second another from inputs and the first.

Of vehicles the first predicts the rotational rates and the second the velocity.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Composite, CostVJP, Dataset, Gradients, Predictor, Problem, ReadoutVJP, StateLayout
from registry.core import PREDICTORS
from registry.errors import BenchError
from registry.predictors.lstm import LSTM, LSTMTDL, LSTMPredictor
from registry.predictors.parts.white_box import measured_signals


class CascadePredictor(Composite):
    """Both networks of `Cascade`. The outputs are the second signal (velocity) and, behind it, the first (rates).

    The free run is the paper's practical mode. In training and in the view "forced" the second network sees measured
    rates (teacher forcing).
    """

    views = ("forced",)

    def __init__(self, entry: LSTM, problem: Problem) -> None:
        super().__init__(problem)
        groups = list(dict.fromkeys(c.group for c in problem.outputs))
        self.slow = sum(c.group == groups[0] for c in problem.outputs)
        if len(groups) != 2 or len({c.group for c in problem.outputs[self.slow :]}) != 1:
            raise BenchError(
                "A cascade predicts two signals, of which the second drives the first, such as --outputs "
                f"velocity,body_rates, not {', '.join(groups)}: name two, or take an LSTM."
            )
        rates = problem.outputs[self.slow :]
        self.first = LSTMPredictor(entry, replace(problem, outputs=rates))
        self.second = LSTMPredictor(
            entry, replace(problem, inputs=(*problem.inputs, *rates), outputs=problem.outputs[: self.slow])
        )
        self.history = max(self.first.history, self.second.history)
        self.by_hand = self.first.by_hand
        sizes = zip(self.first.layout.sizes, self.second.layout.sizes, strict=True)
        self.layout = StateLayout(*(a + b for a, b in sizes))

    @override
    def parts(self) -> list[Predictor]:
        return [self.first, self.second]

    @override
    def part_history(self, part: int, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
        velocity, rates, context = outputs.split([self.slow, self.n_outputs - self.slow, self.n_context], -1)
        if part == 0:
            return inputs, torch.cat([rates, context], -1)
        return torch.cat([inputs, rates], -1), torch.cat([velocity, context], -1)

    def join(self, states: Sequence[Tensor], inputs: Tensor, outputs: Tensor) -> Tensor:
        """Buffers, hidden and cell states of the first network, each followed by those of the second."""
        return self._joined(*states)

    def _joined(self, one: Tensor, two: Tensor) -> Tensor:
        pieces = zip(self.first.layout.split(one), self.second.layout.split(two), strict=True)
        return torch.cat([x for pair in pieces for x in pair], -1)

    @override
    def separate(self, d_state: Tensor) -> list[Tensor]:
        return list(self._separate(d_state))

    def _separate(self, state: Tensor) -> tuple[Tensor, Tensor]:
        sizes = [s for pair in zip(self.first.layout.sizes, self.second.layout.sizes, strict=True) for s in pair]
        pieces = state.split(sizes, -1)
        return torch.cat(pieces[::2], -1), torch.cat(pieces[1::2], -1)

    @override
    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        return torch.cat(
            [p.init_buffers(*self.part_history(i, inputs, outputs)) for i, p in enumerate(self.parts())], -1
        )

    @override
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        one, two = self._separate(state)
        fed = (None, None) if feedback is None else (feedback[..., self.slow :], feedback[..., : self.slow])
        rates, one = self.first.rollout(inputs, one, fed[0])
        seen = rates if feedback is None else feedback[..., self.slow :]
        velocity, two = self.second.rollout(torch.cat([inputs, seen], -1), two, fed[1])
        return torch.cat([velocity, rates], -1), self.join([one, two], inputs, velocity)

    def training_rollout(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """Each network runs free, and the second sees measured rates; see `Predictor.training_rollout`."""
        one, two = self._separate(state)
        rates, _ = self.first.rollout(inputs, one)
        velocity, _ = self.second.rollout(torch.cat([inputs, outputs[..., self.slow :]], -1), two)
        return torch.cat([velocity, rates], -1)

    @override
    def training_rollout_vjp(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> tuple[Tensor, CostVJP]:
        one, two = self._separate(state)
        rates, _, first = self.first.rollout_vjp(inputs, one)
        velocity, _, second = self.second.rollout_vjp(torch.cat([inputs, outputs[..., self.slow :]], -1), two)

        def vjp(d_outputs: Tensor) -> tuple[Tensor, Gradients]:
            d_one, of_first = first(d_outputs[..., self.slow :], None)
            d_two, of_second = second(d_outputs[..., : self.slow], None)
            return self._joined(d_one, d_two), _named(of_first, of_second)

        return torch.cat([velocity, rates], -1), vjp

    def viewed(self, name: str) -> list[int]:
        """The velocity."""
        return list(range(self.slow))

    def view(self, name: str, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """Velocity when the second network sees measured rates."""
        return self.training_rollout(inputs, outputs, state)[..., : self.slow]

    @override
    def set_increments(self, scale: Tensor) -> None:
        self.second.set_increments(scale[: self.slow])
        self.first.set_increments(scale[self.slow :])

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor | None:
        """Of both networks, velocity first. LSTM read-outs do not look at the inputs."""
        one, two = self._separate(state)
        rates, velocity = self.first.readout(one, inputs), self.second.readout(two, inputs)
        return None if rates is None or velocity is None else torch.cat([velocity, rates], -1)

    @override
    def readout_vjp(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, ReadoutVJP] | None:
        one, two = self._separate(state)
        of_rates, of_velocity = self.first.readout_vjp(one, inputs), self.second.readout_vjp(two, inputs)
        if of_rates is None or of_velocity is None:
            return None
        (rates, first), (velocity, second) = of_rates, of_velocity

        def vjp(d_read: Tensor, d_state: Tensor) -> Gradients:
            d_one, d_two = torch.zeros_like(one), torch.zeros_like(two)
            found = _named(first(d_read[..., self.slow :], d_one), second(d_read[..., : self.slow], d_two))
            d_state.add_(self._joined(d_one, d_two))
            return found

        return torch.cat([velocity, rates], -1), vjp


def _named(first: Gradients, second: Gradients) -> Gradients:
    return {f"first.{n}": g for n, g in first.items()} | {f"second.{n}": g for n, g in second.items()}


@PREDICTORS.register("Cascade")
@dataclass(frozen=True)
class Cascade(LSTM):
    """Two LSTMs: inputs → rotational rates, then inputs and these rates → velocity; or any two signals in a chain.

    Mohajerin and Waslander, section "Black-box Modeling of the Quadrotor". Trained with measured rates (teacher
    forcing); judged with predicted ones ("practical") and, as ``velocity_forced``, with measured ones.
    """

    @override
    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        return dataset.inputs, dataset.predicted_together(), ()

    @override
    def build(self, problem: Problem) -> Predictor:
        return CascadePredictor(self, problem)


@PREDICTORS.register("Cascade TDL")
@dataclass(frozen=True)
class CascadeTDL(Cascade, LSTMTDL):
    """`Cascade` of two LSTMs with tapped delay lines."""


@PREDICTORS.register("Cascade attitude")
@dataclass(frozen=True)
class CascadeAttitude(Cascade):
    """`Cascade` that starts from the measured attitude too, as the paper's black box does ("a truncated history of the
    system states") and as hybrids do here.
    """

    @override
    def signals(self, dataset: Dataset) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        if "attitude" not in measured_signals(dataset):
            raise BenchError(
                f"Cascade attitude starts from the measured attitude, which {dataset.label} does not hold: "
                "take an LSTM."
            )
        return dataset.inputs, dataset.predicted_together(), ("attitude",)
