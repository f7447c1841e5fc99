"""The multi-layer perceptron of `registry.kernels.mlp` in C++ (mlp.cpp)."""

import ctypes
from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor

from registry.kernels.native.call import Call, structure
from registry.kernels.native.library import Core


class _Structure(ctypes.Structure):
    """`Call` of mlp.cpp."""

    _fields_ = structure("models batch layers input_gradient", arrays="x y dy dx widths weights gradients")


class MlpCall(Call):
    """Arguments as for `registry.kernels.mlp.mlp`, one type on the CPU; what is kept for a way back is always kept."""

    family: ClassVar[str] = "mlp"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(self, core: Core, x: Tensor, *, weights: Sequence[Tensor], keep: bool = True) -> None:
        *lead, batch, k = x.shape
        self.models = lead[0] if lead else 1
        super().__init__(core, x, models=self.models, batch=batch, layers=len(weights) // 2)
        widths = [k, *(w.shape[-2] for w in weights[::2])]
        self.y = (*lead, batch, widths[-1])
        self.point("x", x)
        self.table("widths", widths)
        self.read(weights, bool(lead))

    def forward(self) -> Tensor:
        """Outputs (…, B, n)."""
        y = self.new("y", self.y)
        self.run("forward", self.models)
        return y

    def backward(self, dy: Tensor | None, inputs_too: bool) -> tuple[Tensor | None, ...]:
        """Gradients of the inputs (if wanted), then of the weights."""
        held = len(self.held)
        self.point("dy", self.like.new_zeros(self.y) if dy is None else dy)
        gradients = self.gradients()
        self.fields.input_gradient = inputs_too
        dx = self.new("dx", tuple(self.like.shape)) if inputs_too else None
        self.run("backward")
        del self.held[held:]
        return (dx, *gradients)
