"""The stacked LSTM of `registry.kernels.lstm` in C++ (lstm.cpp)."""

import ctypes
from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor

from registry.kernels.native.call import Call, structure
from registry.kernels.native.library import Core


class _Structure(ctypes.Structure):
    """`Call` of lstm.cpp."""

    _fields_ = structure(
        "models batch steps inputs outputs taps layers cells mask_lanes keep input_gradient increments",
        arrays="u state forced mask y end_state dy d_end_state du d_state weights gradients",
    )


class LstmCall(Call):
    """T steps: arguments as for `registry.kernels.lstm_steps.run`, one type on the CPU; ``keep``: for a way back."""

    family: ClassVar[str] = "lstm"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(
        self, core: Core, inputs: Tensor, state: Tensor, *, weights: Sequence[Tensor], keep: bool,
        forced: Tensor | None, mask: Tensor | None, delays: int, increments: bool,
    ) -> None:  # fmt: skip
        *lead, batch, steps, m = inputs.shape
        self.models = lead[0] if lead else 1
        layers = len(weights) // 4
        n = weights[-2].shape[-2] if len(weights) > 4 * layers else 0
        super().__init__(
            core, inputs, models=self.models, batch=batch, steps=steps, inputs=m, outputs=n, taps=delays, layers=layers,
            cells=weights[1].shape[-1], mask_lanes=0 if mask is None else mask.shape[-1], keep=keep,
            increments=increments,
        )  # fmt: skip
        self.y, self.state = (*lead, batch, steps, n), state.shape
        self.point("u", inputs)
        self.point("state", state)
        self.point("forced", forced)
        self.point("mask", mask)
        self.read(weights, bool(lead))

    def forward(self) -> tuple[Tensor, Tensor]:
        """Outputs (…, B, T, n) and the state (…, B, s) after the run."""
        made = self.new("y", self.y), self.new("end_state", self.state)
        self.run("forward", self.models)
        return made

    def backward(self, dy: Tensor | None, d_end: Tensor | None, inputs_too: bool) -> tuple[Tensor | None, ...]:
        """Gradients of the inputs (if wanted) and of the state, then of the weights."""
        held = len(self.held)
        self.point("dy", dy)
        self.point("d_end_state", d_end)
        gradients = self.gradients()
        self.fields.input_gradient = inputs_too
        du = self.new("du", tuple(self.like.shape)) if inputs_too else None
        d_state = self.new("d_state", self.state)
        self.run("backward")
        del self.held[held:]
        return (du, d_state, *gradients)
