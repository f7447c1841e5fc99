"""Initializers: a predictor's state from a history of measurements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

from torch import Tensor, nn

from registry.contracts.predictor import Gradients, Predictor

InitialVJP = Callable[[Tensor], tuple[Gradients, Gradients]]
"""From the gradient of the state (…, B, s), which may be overwritten, to those of the initializer's parameters and
those of the predictor's."""


class Initializer(nn.Module, ABC):
    """Sets a predictor's state from a history of τ samples.

    ``predictor`` is passed to the calls and not held, so that its weights are counted once.
    """

    uses_state_cost: ClassVar[bool] = False
    """Whether L_si joins the training cost (the neural initializers)."""

    @abstractmethod
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """State (B, s) at k0 from the scaled history (B, τ, m), (B, τ, n + c)."""

    def initialize_vjp(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, InitialVJP]:
        """`initialize` and its vector-Jacobian product, for a predictor that has one; see `Predictor.rollout_vjp`."""
        raise NotImplementedError

    def forward(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """State (B, s) from the SI history (B, τ, m), (B, τ, n + c)."""
        return self.initialize(predictor, predictor.input_scaler(inputs), predictor.scale_history(outputs))

    def weight_count(self) -> int:
        """Number of trainable weights."""
        return sum(p.numel() for p in self.parameters())
