"""The multi-layer perceptron of `registry.kernels.mlp` in C++ (mlp.cpp)."""

import ctypes
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.call import Call, structure
from registry.kernels.native.library import Core


class _Structure(ctypes.Structure):
    """`Call` of mlp.cpp."""

    _fields_ = structure("models batch layers input_gradient", arrays="x y dy dx widths weights gradients")


class MlpCall(Call):
    """Arguments as for `mlp`."""

    family: ClassVar[str] = "mlp"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(self, core: Core, x: Tensor, weights: Sequence[Tensor]) -> None:
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

    def backward(self, dy: Tensor, inputs_too: bool) -> tuple[Tensor | None, ...]:
        """Gradients of the inputs (if wanted), then of the weights."""
        held = len(self.held)
        self.point("dy", dy)
        gradients = self.gradients()
        self.fields.input_gradient = inputs_too
        dx = self.new("dx", tuple(self.like.shape)) if inputs_too else None
        self.run("backward")
        del self.held[held:]
        return (dx, *gradients)


class _MLP(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, core: Core, x: Tensor, *weights: Tensor) -> Tensor:
        ctx.save_for_backward(*weights)  # a change in place before the way back is an error
        ctx.run = MlpCall(core, x, weights)
        y: Tensor = ctx.run.forward()
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        return (None, *ctx.run.backward(*grads, ctx.needs_input_grad[1]))


def mlp(core: Core, x: Tensor, weights: list[Tensor]) -> Tensor:
    """Arguments and result as for `registry.kernels.mlp.mlp`, one type on the CPU."""
    if torch.is_grad_enabled() and any(w.requires_grad for w in (x, *weights)):
        y: Tensor = _MLP.apply(core, x, *weights)
        return y
    return MlpCall(core, x, weights).forward()
