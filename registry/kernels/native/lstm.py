"""The stacked LSTM of `registry.kernels.lstm` in C++ (lstm.cpp)."""

import ctypes
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.call import Call, addresses, structure
from registry.kernels.native.library import Core


class _Weight(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("stride", ctypes.c_int64))


class _Structure(ctypes.Structure):
    """`Call` of lstm.cpp."""

    _fields_ = structure(
        "models batch steps inputs outputs taps layers cells mask_lanes keep input_gradient",
        arrays="u fed hidden cell forced mask y end_hidden end_cell dy d_end_hidden d_end_cell "
        "du d_fed d_hidden d_cell weights gradients",
    )


class _Run(Call):
    family: ClassVar[str] = "lstm"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(self, core: Core, arrays: dict[str, Tensor | None], weights: list[Tensor], keep: bool) -> None:
        inputs, hidden, fed, mask = (arrays[n] for n in ("u", "hidden", "fed", "mask"))
        assert inputs is not None and hidden is not None and fed is not None
        # each model's weights without gaps; the models themselves may lie apart
        self.weights = [w if w[0].is_contiguous() else w.contiguous() for w in weights]
        models, batch, steps, m = inputs.shape
        layers = len(weights) // 4
        n = weights[4 * layers].shape[-2] if len(weights) > 4 * layers else 0
        super().__init__(
            core,
            inputs,
            models=models,
            batch=batch,
            steps=steps,
            inputs=m,
            outputs=n,
            taps=fed.shape[-1] // n if n else 0,
            layers=layers,
            cells=weights[1].shape[-1],
            mask_lanes=0 if mask is None else mask.shape[-1],
            keep=keep,
        )
        self.y, self.fed, self.states = (models, batch, steps, n), fed.shape, hidden.shape
        for name, x in arrays.items():
            self.point(name, x)
        self.table("weights", (_Weight * len(weights))(*(_Weight(w.data_ptr(), w.stride(0)) for w in self.weights)))

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """Outputs (M, B, T, n), hidden and cell states (M, B, L·H) after the run."""
        made = self.new("y", self.y), self.new("end_hidden", self.states), self.new("end_cell", self.states)
        self.run("forward", self.y[0])
        return made

    def backward(self, given: tuple[Tensor, ...], inputs_too: bool) -> tuple[Tensor | None, ...]:
        """Gradients of inputs (if wanted), fed outputs, hidden and cell states, then of the weights."""
        held = len(self.held)
        for name, x in zip(("dy", "d_end_hidden", "d_end_cell"), given, strict=True):
            self.point(name, x)
        gradients = [w.new_empty(w.shape) for w in self.weights]
        self.table("gradients", addresses(gradients))
        self.fields.input_gradient = inputs_too
        du = self.new("du", tuple(self.like.shape)) if inputs_too else None
        states = self.new("d_hidden", self.states), self.new("d_cell", self.states)
        made = du, self.new("d_fed", self.fed), *states
        self.run("backward")
        del self.held[held:]
        return (*made, *gradients)


class _LSTM(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, core: Core, names: tuple[str, ...], *tensors: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        arrays, weights = tensors[: len(names)], [w for w in tensors[len(names) :] if w is not None]
        ctx.save_for_backward(*weights)  # a change in place before the way back is an error
        ctx.run = _Run(core, dict(zip(names, arrays, strict=True)), weights, keep=True)
        done: tuple[Tensor, Tensor, Tensor] = ctx.run.forward()
        return done

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        du, d_fed, d_hidden, d_cell, *gradients = ctx.run.backward(grads, ctx.needs_input_grad[2])
        return (None, None, du, d_fed, d_hidden, d_cell, None, None, *gradients)


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
    arrays = {"u": inputs, "fed": fed, "hidden": hidden, "cell": cell, "forced": forced, "mask": mask}
    if torch.is_grad_enabled() and any(x.requires_grad for x in (inputs, fed, hidden, cell, *weights)):
        done: tuple[Tensor, Tensor, Tensor] = _LSTM.apply(core, tuple(arrays), *arrays.values(), *weights)
        return done
    return _Run(core, arrays, weights, keep=False).forward()
