"""Predictors: free runs of many steps from a state, with their hand-written derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from registry.contracts.problem import Problem
from registry.cost import prediction_cost

Gradients = dict[str, Tensor]
"""Of the parameters of a network, by name. Fresh tensors, to be added to."""
CostVJP = Callable[[Tensor], tuple[Tensor, Gradients]]
"""From the gradient of what the cost looks at (…, B, T, n) to that of the state at k0 and those of the parameters."""
RunVJP = Callable[[Tensor | None, Tensor | None], tuple[Tensor, Gradients]]
"""From the gradients of outputs (…, B, T, n) and end state (…, B, s), which may be overwritten (None: zero), to that of
the state at k0 and those of the parameters."""
ReadoutVJP = Callable[[Tensor, Tensor], Gradients]
"""From the gradient of what was read (…, B, n); adds to that of the state (…, B, s), its second argument."""


@dataclass(frozen=True)
class StateLayout:
    """A predictor's state vector: [output states and delay-line buffers | hidden | cell]."""

    buffer: int
    hidden: int
    cell: int

    @property
    def size(self) -> int:
        """Length s of the state."""
        return self.buffer + self.hidden + self.cell

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Lengths of the three pieces."""
        return self.buffer, self.hidden, self.cell

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(…, s) → buffers (…, s_b), hidden (…, s_h), cell (…, s_c)."""
        b, h, c = state.split(self.sizes, dim=-1)
        return b, h, c


class Scaler(nn.Module):
    """An affine map between SI values and scaled ones, (x − offset) / scale, kept as buffers of the model."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("offset", torch.zeros(size))
        self.register_buffer("scale", torch.ones(size))
        self.offset: Tensor
        self.scale: Tensor

    def set(self, offset: Tensor, scale: Tensor) -> None:
        """Fit values, from the training part only; a scale of zero (a constant channel) becomes one."""
        self.offset.copy_(offset)
        self.scale.copy_(torch.where(scale > 0, scale, torch.ones_like(scale)))

    def forward(self, x: Tensor) -> Tensor:
        """SI (…, size) → scaled (…, size)."""
        return (x - self.offset) / self.scale

    def invert(self, x: Tensor) -> Tensor:
        """Scaled (…, size) → SI (…, size)."""
        return x * self.scale + self.offset


class Predictor(nn.Module, ABC):
    """Predicts T steps of outputs from T inputs and a state, running free.

    Subclasses work in scaled units (`rollout`); `forward` is SI in, SI out. ``horizon`` is the T the
    predictor is built for (recurrent ones accept any T).
    """

    layout: StateLayout
    history: int = 1
    """Samples of history that `init_buffers` needs."""
    by_hand: bool = True
    """Whether this one, of a class with `rollout_vjp` or `training_rollout_vjp`, can do without autograd."""
    views: tuple[str, ...] = ()
    """Names of further predictions that are judged beside the free run; see `view`."""

    def __init__(self, problem: Problem) -> None:
        super().__init__()
        self.problem = problem
        self.n_inputs, self.n_outputs, self.n_context = problem.n_inputs, problem.n_outputs, problem.n_context
        self.horizon = problem.horizon
        self.input_scaler, self.output_scaler = Scaler(self.n_inputs), Scaler(self.n_outputs)
        self.context_scaler = Scaler(self.n_context) if self.n_context else None

    def scale_history(self, outputs: Tensor) -> Tensor:
        """SI history (…, τ, n + c), outputs then context → scaled."""
        if self.context_scaler is None:
            return self.output_scaler(outputs)
        measured, context = outputs.split([self.n_outputs, self.n_context], -1)
        return torch.cat([self.output_scaler(measured), self.context_scaler(context)], -1)

    @abstractmethod
    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Buffers (B, s_b) at k0 from the scaled measured history (B, τ, m), (B, τ, n + c)."""

    @abstractmethod
    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Free run in scaled units.

        Args:
            inputs: (B, T, m) u_{k0+1} .. u_{k0+T}.
            state: (B, s) at k0.
            feedback: (B, T, n) measured outputs y_{k0+1} .. y_{k0+T} that are fed back in place of the
                predictor's own (washout, teacher forcing).

        Returns:
            outputs (B, T, n) and the state (B, s) at k0+T.
        """

    def training_rollout(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """What the training cost looks at (B, T, n), scaled: the free run, unless measured outputs (B, T, n) are fed.

        Tests and validation always run free.
        """
        return self.rollout(inputs, state)[0]

    def cost(self, predicted: Tensor, measured: Tensor) -> Tensor:
        """L_pred (…) of scaled outputs (…, B, T, n); lower is better."""
        return prediction_cost(predicted, measured)

    def augment(self, windows: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """Training windows, scaled, as they are or changed at random by what the system cannot tell, such as mirrored.

        Args:
            windows: history inputs (…, B, τ, m) and outputs (…, B, τ, n + c), horizon inputs (…, B, T, m) and outputs
                (…, B, T, n). Draw from torch's global generator; then `PredictorEntry.supports_batching` must be False.
        """
        return windows

    def viewed(self, name: str) -> list[int]:
        """The columns of the outputs that a view is about; all of them unless said."""
        return list(range(self.n_outputs))

    def view(self, name: str, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        """A further prediction (B, T, len(viewed)), one of `views`, scaled, from what `rollout` is given."""
        raise NotImplementedError(f"{type(self).__name__} has no view {name!r}")

    def rollout_vjp(
        self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None
    ) -> tuple[Tensor, Tensor, RunVJP]:
        """`rollout` on the compiled core without autograd, and its vector-Jacobian product: autograd's, bit for bit.

        Not every predictor has one. Where a subclass changes a method but not its product, or the cost, training falls
        back on autograd.
        """
        raise NotImplementedError

    def training_rollout_vjp(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> tuple[Tensor, CostVJP]:
        """`training_rollout` and its vector-Jacobian product; see `rollout_vjp`."""
        predicted, _, run = self.rollout_vjp(inputs, state)
        return predicted, lambda d_outputs: run(d_outputs, None)

    def readout(self, state: Tensor, inputs: Tensor) -> Tensor | None:
        """ŷ_{k0} (B, n) as the output layer reads it from the state (B, s) and u_{k0} (B, m), scaled.

        The state-initialization cost is its distance from the measured y_{k0} (paper, eq. state_init_cost).
        None: the predictor has no states to initialize.
        """
        return None

    def readout_vjp(self, state: Tensor, inputs: Tensor) -> tuple[Tensor, ReadoutVJP] | None:
        """`readout` and its vector-Jacobian product; see `rollout_vjp`."""
        return None

    def set_increments(self, scale: Tensor) -> None:
        """Take the standard deviation (n,) of the outputs' change in a step over the training part, scaled."""

    def fit(self, history_inputs: Tensor, history_outputs: Tensor, inputs: Tensor, outputs: Tensor) -> None:
        """Closed-form fit on scaled training windows, for predictors not trained by gradient."""

    def forward(self, inputs: Tensor, state: Tensor) -> Tensor:
        """SI inputs (B, T, m) and state (B, s) → SI outputs (B, T, n)."""
        outputs, _ = self.rollout(self.input_scaler(inputs), state)
        return self.output_scaler.invert(outputs)

    def weight_count(self) -> int:
        """Number of trainable weights."""
        return sum(p.numel() for p in self.parameters())


class Composite(Predictor):
    """Several initialized networks that predict together; each has an initializer of its own."""

    @abstractmethod
    def parts(self) -> list[Predictor]:
        """The networks, each with its own problem."""

    @abstractmethod
    def part_history(self, part: int, inputs: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled history of a part, (B, τ, m_i) and (B, τ, n_i + c_i), from that of the whole."""

    @abstractmethod
    def join(self, states: Sequence[Tensor], inputs: Tensor, outputs: Tensor) -> Tensor:
        """State (B, s) of the whole from those of its parts (B, s_i) and its own scaled history."""

    def separate(self, d_state: Tensor) -> list[Tensor]:
        """The gradients of the parts' states (B, s_i) from that of the whole (B, s): the way back of `join`."""
        raise NotImplementedError
