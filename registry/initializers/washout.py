"""Washout: run the predictor over the history until its initial state is forgotten."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Gradients, Initializer, InitializerEntry, InitialVJP, Predictor, Problem
from registry.core import INITIALIZERS, option


class WashoutInitializer(Initializer):
    """Starts from zero or random network states at the first sample of the history and runs to its last."""

    def __init__(self, entry: "Washout") -> None:
        super().__init__()
        self.period, self.start, self.feedback = entry.history, entry.start, entry.feedback

    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """See `Initializer.initialize`. The outputs during washout carry no cost; gradients flow through the run."""
        start, run = self._run(predictor, inputs, outputs)
        end = start if run is None else predictor.rollout(*run)[1]
        return self._at_the_end(predictor, inputs, outputs, end)

    @override
    def initialize_vjp(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, InitialVJP]:
        start, run = self._run(predictor, inputs, outputs)
        if run is None:
            return self._at_the_end(predictor, inputs, outputs, start), lambda d_state: ({}, {})
        _, end, back = predictor.rollout_vjp(*run)

        def vjp(d_state: Tensor) -> tuple[Gradients, Gradients]:
            d_state[..., : predictor.layout.buffer] = 0  # measured
            return {}, back(None, d_state)[1]

        return self._at_the_end(predictor, inputs, outputs, end), vjp

    def _run(
        self, predictor: Predictor, inputs: Tensor, outputs: Tensor
    ) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor | None] | None]:
        """The state at the first sample, and what `Predictor.rollout` is given; None where that is the last one."""
        inputs, outputs = inputs[..., -self.period :, :], outputs[..., -self.period :, :]
        layout = predictor.layout
        lead = inputs.shape[:-2]
        hidden, cell = inputs.new_zeros(*lead, layout.hidden), inputs.new_zeros(*lead, layout.cell)
        if self.start == "random":
            hidden, cell = hidden.uniform_(-1, 1), cell.uniform_(-1, 1)
        state = torch.cat([predictor.init_buffers(inputs[..., :1, :], outputs[..., :1, :]), hidden, cell], -1)
        measured = outputs[..., 1:, : predictor.n_outputs] if self.feedback == "measured" else None
        return state, (inputs[..., 1:, :], state, measured) if inputs.shape[-2] > 1 else None

    def _at_the_end(self, predictor: Predictor, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """Measured buffers, the network's states."""
        inputs, outputs = inputs[..., -self.period :, :], outputs[..., -self.period :, :]
        return torch.cat([predictor.init_buffers(inputs, outputs), state[..., predictor.layout.buffer :]], -1)


@INITIALIZERS.register("Washout")
@dataclass(frozen=True)
class Washout(InitializerEntry):
    """Runs the predictor over the history from zero or random states: the common practice.

    Paper, section "RNN State Initialization: Washout" (Jaeger 2002; Zimmermann et al. 2012).
    """

    supports_batching: ClassVar[bool] = True

    history: int = option(10, "washout period τ", unit="samples", low=1, high=10000, search=(5, 40))
    start: str = option("zero", "states at the start of the period", choices=("zero", "random"))
    feedback: str = option(
        "measured", "outputs fed back during washout: measured ones or the network's own", choices=("measured", "own")
    )

    @override
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        return WashoutInitializer(self)


@INITIALIZERS.register("Washout own")
@dataclass(frozen=True)
class WashoutOwn(Washout):
    """Washout in which the network feeds its own outputs back, not the measured ones.

    The paper does not say which of the two it means; measured outputs are known during washout, so that one is
    called `Washout` here.
    """

    feedback: str = option("own", "outputs fed back during washout", choices=("own",))
