"""The multi-layer fully connected RNN of `registry.kernels.mlfc` in C++ (mlfc.cpp)."""

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.library import Core
from registry.kernels.workspace import Workspace

_SIZES = ("models", "batch", "steps", "inputs", "outputs", "layers", "cells", "mask_lanes", "keep")
_ARRAYS = (
    "u", "fed", "hidden", "forced", "mask", "y", "end_hidden", "dy", "d_end_hidden", "du", "d_fed", "d_hidden",
    "weights", "gradients", "kept", "scratch",
)  # fmt: skip


class _Call(ctypes.Structure):
    """`Call` of mlfc.cpp."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in _SIZES),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        ("kept_size", ctypes.c_int64),
        ("scratch_size", ctypes.c_int64),
    )


class _Prepared:
    """A call, and what it points to."""

    def __init__(self, core: Core, arrays: dict[str, Tensor | None], weights: tuple[Tensor, ...], keep: bool) -> None:
        self.core, self.weights = core, [w.contiguous() for w in weights]
        self.arrays = {name: x.contiguous() for name, x in arrays.items() if x is not None}
        u, mask = self.arrays["u"], self.arrays.get("mask")
        M, B, T, m = self.shape = u.shape
        self.n, L, H = weights[-1].shape[-2], len(weights) - 1, weights[0].shape[-2]
        lanes = 0 if mask is None else mask.shape[-1]
        self.call = _Call(M, B, T, m, self.n, L, H, lanes, int(keep))
        self.table = _addresses(self.weights)
        self.call.weights = ctypes.addressof(self.table)
        self.point(self.arrays)
        self.run("sizes")

    def point(self, arrays: dict[str, Tensor]) -> None:
        """Set addresses; the arrays must outlive the call."""
        for name, x in arrays.items():
            setattr(self.call, name, x.data_ptr())

    def run(self, what: str) -> None:
        """Call the function of the arrays' type."""
        kind = "f" if self.arrays["u"].dtype == torch.float32 else "d"
        getattr(self.core.functions, f"mlfc_{what}_{kind}")(ctypes.byref(self.call))

    def forward(self) -> tuple[Tensor, Tensor]:
        """Outputs (M, B, T, n) and hidden states (M, B, L·H) after the run."""
        u, hidden = self.arrays["u"], self.arrays["hidden"]
        self.kept = Workspace(self.call.kept_size * self.call.models, u.detach())
        scratch = Workspace(self.call.scratch_size, u.detach())
        self.call.kept, self.call.scratch = self.kept.address, scratch.address
        y, end = u.new_empty(*self.shape[:3], self.n), torch.empty_like(hidden)
        self.point({"y": y, "end_hidden": end})
        self.run("forward")
        return y, end

    def backward(self, dy: Tensor, d_end: Tensor) -> tuple[Tensor, Tensor, Tensor, list[Tensor]]:
        """Gradients of inputs, fed outputs, states and weights."""
        scratch = Workspace(self.call.scratch_size, dy.detach())
        self.call.scratch = scratch.address
        du, d_fed, d_hidden = (torch.empty_like(self.arrays[name]) for name in ("u", "fed", "hidden"))
        gradients = [torch.empty_like(w) for w in self.weights]
        table = _addresses(gradients)
        self.call.gradients = ctypes.addressof(table)
        given = {"dy": dy.contiguous(), "d_end_hidden": d_end.contiguous()}
        self.point(given | {"du": du, "d_fed": d_fed, "d_hidden": d_hidden})
        self.run("backward")
        return du, d_fed, d_hidden, gradients


def _addresses(tensors: list[Tensor]) -> "ctypes.Array[ctypes.c_void_p]":
    return (ctypes.c_void_p * len(tensors))(*(x.data_ptr() for x in tensors))


class _MLFC(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, core: Core, *given: Tensor) -> tuple[Tensor, Tensor]:
        ctx.run = _Prepared(core, dict(zip(_ARRAYS, given[:5], strict=False)), given[5:], keep=True)
        return ctx.run.forward()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        *made, gradients = ctx.run.backward(*grads)
        return (None, *made, None, None, *gradients)


def mlfc(
    core: Core,
    inputs: Tensor,
    fed: Tensor,
    hidden: Tensor,
    forced: Tensor | None,
    mask: Tensor | None,
    weights: list[Tensor],
) -> tuple[Tensor, Tensor]:
    """Run T steps on the CPU in one type.

    Args:
        core: the compiled library.
        inputs, fed, hidden, forced: as for `registry.kernels.mlfc.mlfc`.
        mask: (T, M, L·H, lanes) of dropout, at least as many lanes as windows, a multiple of 32.
        weights: those of the layers, then the read-out.

    Returns:
        outputs (M, B, T, n) and hidden (M, B, L·H) after the run.
    """
    if torch.is_grad_enabled() and any(x.requires_grad for x in (inputs, fed, hidden, *weights)):
        done: tuple[Tensor, Tensor] = _MLFC.apply(core, inputs, fed, hidden, forced, mask, *weights)
        return done
    arrays = {"u": inputs, "fed": fed, "hidden": hidden, "forced": forced, "mask": mask}
    return _Prepared(core, arrays, tuple(weights), keep=False).forward()
