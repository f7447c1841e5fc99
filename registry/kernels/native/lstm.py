"""The stacked LSTM of `registry.kernels.lstm` in C++ (lstm.cpp)."""

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.library import Core
from registry.kernels.native.workspace import Workspace

_SIZES = (
    "models", "batch", "steps", "inputs", "outputs", "taps", "layers", "cells", "mask_lanes", "keep", "input_gradient",
)  # fmt: skip
_ARRAYS = (
    "u", "fed", "hidden", "cell", "forced", "mask", "y", "end_hidden", "end_cell", "dy", "d_end_hidden", "d_end_cell",
    "du", "d_fed", "d_hidden", "d_cell", "weights", "gradients", "kept", "scratch",
)  # fmt: skip


class _Weight(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("stride", ctypes.c_int64))


class _Call(ctypes.Structure):
    """`Call` of lstm.cpp."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in _SIZES),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        ("kept_size", ctypes.c_int64),
        ("scratch_size", ctypes.c_int64),
    )


class _Prepared:
    """A call, what it points to, and the shapes of what it makes."""

    def __init__(self, core: Core, arrays: dict[str, Tensor | None], weights: list[Tensor], keep: bool) -> None:
        inputs, hidden, fed = arrays["u"], arrays["hidden"], arrays["fed"]
        assert inputs is not None and hidden is not None and fed is not None
        self.core, self.like, self.weights = core, inputs, weights
        self.held: list[Any] = []
        M, B, T, m = inputs.shape
        layers, cells = len(weights) // 4, weights[1].shape[-1]
        n = weights[4 * layers].shape[-2] if len(weights) > 4 * layers else 0
        mask = arrays["mask"]
        lanes = mask.shape[-1] if mask is not None else 0
        self.call = _Call(M, B, T, m, n, fed.shape[-1] // n if n else 0, layers, cells, lanes, int(keep), 0)
        self.y = (M, B, T, n)
        for name, x in arrays.items():
            self.set(name, x)
        table = (_Weight * len(weights))()
        for entry, w in zip(table, weights, strict=True):
            entry.data, entry.stride = w.data_ptr(), w.stride(0)
        self.held.append(table)
        self.call.weights = ctypes.addressof(table)

    def set(self, name: str, x: Tensor | None) -> None:
        """Point to an array; it is held until this object goes."""
        if x is not None:
            x = x.contiguous()
            self.held.append(x)
            setattr(self.call, name, x.data_ptr())

    def new(self, name: str, shape: tuple[int, ...]) -> Tensor:
        """A fresh array to be written."""
        x = self.like.new_empty(shape)
        setattr(self.call, name, x.data_ptr())
        return x

    def run(self, what: str) -> None:
        """Call the function of the arrays' type."""
        kind = "f" if self.like.dtype == torch.float32 else "d"
        getattr(self.core.functions, f"lstm_{what}_{kind}")(ctypes.byref(self.call))

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """Outputs (M, B, T, n), hidden and cell states (M, B, L·H) after the run."""
        self.run("sizes")
        self.kept = Workspace(self.call.kept_size * self.call.models, self.like.dtype)
        scratch = Workspace(self.call.scratch_size, self.like.dtype)
        self.call.kept, self.call.scratch = self.kept.address, scratch.address
        y, size = self.new("y", self.y), (*self.y[:2], self.call.layers * self.call.cells)
        hidden, cell = self.new("end_hidden", size), self.new("end_cell", size)
        self.run("forward")
        return y, hidden, cell

    def backward(
        self, given: tuple[Tensor, ...], inputs_too: bool
    ) -> tuple[Tensor | None, Tensor, Tensor, Tensor, list[Tensor]]:
        """Gradients of inputs (if wanted), fed outputs, states and weights."""
        call = self.call
        call.input_gradient = int(inputs_too)
        self.run("sizes")
        scratch = Workspace(call.scratch_size, self.like.dtype)
        call.scratch = scratch.address
        gradients = [w.new_empty(w.shape) for w in self.weights]
        table = (ctypes.c_void_p * len(gradients))(*(g.data_ptr() for g in gradients))
        call.gradients = ctypes.addressof(table)
        held, self.held = self.held, list(self.held)
        for name, x in zip(("dy", "d_end_hidden", "d_end_cell"), given, strict=True):
            self.set(name, x)
        M, B, _, n = self.y
        size = (M, B, call.layers * call.cells)
        du = self.new("du", tuple(self.like.shape)) if inputs_too else None
        made = du, self.new("d_fed", (M, B, call.taps * n)), self.new("d_hidden", size), self.new("d_cell", size)
        self.run("backward")
        self.held = held
        return (*made, gradients)


class _LSTM(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        core: Core,
        inputs: Tensor,
        fed: Tensor,
        hidden: Tensor,
        cell: Tensor,
        forced: Tensor | None,
        mask: Tensor | None,
        *weights: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        arrays = {"u": inputs, "fed": fed, "hidden": hidden, "cell": cell, "forced": forced, "mask": mask}
        ctx.save_for_backward(*weights)  # a change in place before the way back is an error
        ctx.run = _Prepared(core, arrays, _rows(weights), keep=True)
        return ctx.run.forward()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        *made, gradients = ctx.run.backward(grads, ctx.needs_input_grad[1])
        return (None, *made, None, None, *gradients)


def _rows(weights: tuple[Tensor, ...]) -> list[Tensor]:
    """Each model's weights without gaps; the models themselves may lie apart."""
    return [w if w[0].is_contiguous() else w.contiguous() for w in weights]


def lstm(
    core: Core,
    inputs: Tensor,
    fed: Tensor,
    hidden: Tensor,
    cell: Tensor,
    forced: Tensor | None,
    mask: Tensor | None,
    weights: list[Tensor],
) -> tuple[Tensor, Tensor, Tensor]:
    """Run T steps: arguments and results as for `registry.kernels.lstm_torch.run`, one type on the CPU."""
    if torch.is_grad_enabled() and any(x.requires_grad for x in (inputs, fed, hidden, cell, *weights)):
        done: tuple[Tensor, Tensor, Tensor] = _LSTM.apply(core, inputs, fed, hidden, cell, forced, mask, *weights)
        return done
    arrays = {"u": inputs, "fed": fed, "hidden": hidden, "cell": cell, "forced": forced, "mask": mask}
    return _Prepared(core, arrays, _rows(tuple(weights)), keep=False).forward()
