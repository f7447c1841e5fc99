"""The optimized initial state: for every window, the one from which the history is explained best."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Initializer, InitializerEntry, Predictor, Problem
from registry.core import INITIALIZERS, option
from registry.initializers.mlp import bounded


class OptimizedInitializer(Initializer):
    """Fits the network states at the first sample of the history by gradient, then runs to its last as washout does."""

    def __init__(self, entry: "Optimized") -> None:
        super().__init__()
        self.period, self.iterations, self.rate = entry.history, entry.iterations, entry.rate

    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """See `Initializer.initialize`.

        The fitted start counts as a constant: the gradient to the weights goes through the run that follows it, not
        through the steps that found it.
        """
        window = inputs[..., -self.period :, :], outputs[..., -self.period :, :]
        _, state = _run(predictor, self.start(predictor, *window), *window)
        return torch.cat([predictor.init_buffers(inputs, outputs), state[..., predictor.layout.buffer :]], -1)

    def start(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Network states (…, B, s_h + s_c) at the first sample from which the others are explained best.

        Unbounded (see `bounded`), found by descent from zero on each window's squared error of one-step predictions
        from measured outputs; carries no gradient.
        """
        states = inputs.new_zeros(*inputs.shape[:-2], predictor.layout.hidden + predictor.layout.cell)
        for _ in range(self.iterations if inputs.shape[-2] > 1 else 0):
            with torch.enable_grad():
                states.requires_grad_()
                predicted, _ = _run(predictor, states, inputs, outputs)
                error = predicted - outputs[..., 1:, : predictor.n_outputs]
                cost = error.square().sum(-1).mean(-1)  # (…, B)
                (slope,) = torch.autograd.grad(cost.sum(), states)
            states = _descended(states.detach(), cost.detach(), slope, self.rate)
        return states


def _run(predictor: Predictor, states: Tensor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
    """From unbounded network states at the first sample to the last, measured outputs fed back."""
    filled = predictor.init_buffers(inputs[..., :1, :], outputs[..., :1, :])
    state = bounded(predictor, filled, states)
    measured = outputs[..., 1:, : predictor.n_outputs]
    return predictor.rollout(inputs[..., 1:, :], state, measured) if measured.shape[-2] else (measured, state)


def _descended(states: Tensor, cost: Tensor, slope: Tensor, rate: float) -> Tensor:
    """One gradient step a window, no longer than the one after which a linear cost is zero.

    That bound (the Polyak step) keeps the descent from diverging where the weights make the cost steep.
    """
    bound = cost / (slope.square().sum(-1) + torch.finfo(slope.dtype).tiny)
    return states - bound.clamp(max=rate).unsqueeze(-1) * slope


@INITIALIZERS.register("Optimized")
@dataclass(frozen=True)
class Optimized(InitializerEntry):
    """Fits the states at the start of the history by gradient, window by window, and runs on from there.

    Paper, section "RNN State Initialization: Optimization" (after Becerra et al. 2002), with a way to go on after
    training: the same fit for every prediction. That costs ``iterations`` washouts, forth and back, a prediction,
    and a short history with many states is fitted too well.
    """

    supports_batching: ClassVar[bool] = True

    history: int = option(10, "initialization length τ", unit="samples", low=1, high=10000, search=(5, 40))
    iterations: int = option(10, "gradient steps on the states of a window", low=0, high=1000)
    rate: float = option(10.0, "largest length of a step per unit of gradient", low=1e-3, high=1e3, log=True)

    @override
    def build(self, predictor: Predictor, problem: Problem) -> Initializer:
        return OptimizedInitializer(self)
