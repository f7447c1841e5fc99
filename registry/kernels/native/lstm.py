"""The stacked LSTM of `registry.kernels.lstm` in C++ (lstm.cpp)."""

import ctypes
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from registry.kernels.native.call import Call, structure
from registry.kernels.native.library import Core


class _Structure(ctypes.Structure):
    """`Call` of lstm.cpp."""

    _fields_ = structure(
        "models batch steps inputs outputs taps layers cells mask_lanes keep input_gradient increments",
        arrays="u state forced mask y end_state dy d_end_state du d_state weights gradients",
    )


class LstmCall(Call):
    """Arguments as for `lstm`; ``keep``: for a way back."""

    family: ClassVar[str] = "lstm"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(
        self, core: Core, inputs: Tensor, state: Tensor, forced: Tensor | None, mask: Tensor | None,
        weights: Sequence[Tensor], delays: int, keep: bool, increments: bool = False,
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


class _LSTM(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, core: Core, lines: tuple[int, bool], inputs: Tensor, state: Tensor, forced: Tensor | None,
        mask: Tensor | None, *weights: Tensor,
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        ctx.save_for_backward(*weights)  # a change in place before the way back is an error
        ctx.set_materialize_grads(False)
        ctx.run = LstmCall(core, inputs, state, forced=forced, mask=mask, weights=weights, delays=lines[0], keep=True,
                           increments=lines[1])  # fmt: skip
        done: tuple[Tensor, Tensor] = ctx.run.forward()
        return done

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        du, d_state, *gradients = ctx.run.backward(*grads, ctx.needs_input_grad[2])
        return (None, None, du, d_state, None, None, *gradients)


def lstm(
    core: Core,
    inputs: Tensor,
    state: Tensor,
    forced: Tensor | None,
    mask: Tensor | None,
    weights: list[Tensor],
    delays: int,
    increments: bool = False,
) -> tuple[Tensor, Tensor]:
    """Run T steps: arguments and results as for `registry.kernels.lstm_steps.run`, one type on the CPU."""
    if torch.is_grad_enabled() and any(x.requires_grad for x in (inputs, state, *weights)):
        done: tuple[Tensor, Tensor] = _LSTM.apply(core, (delays, increments), inputs, state, forced, mask, *weights)
        return done
    run = LstmCall(
        core, inputs, state, forced=forced, mask=mask, weights=weights, delays=delays, keep=False, increments=increments
    )
    return run.forward()
