"""The multi-layer fully connected RNN of `registry.kernels.mlfc` in C++ (mlfc.cpp)."""

import ctypes
from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor

from registry.kernels.native.call import Call, structure
from registry.kernels.native.library import Core


class _Structure(ctypes.Structure):
    """`Call` of mlfc.cpp."""

    _fields_ = structure(
        "models batch steps inputs outputs layers cells mask_lanes keep",
        arrays="u fed hidden forced mask y end_hidden dy d_end_hidden du d_fed d_hidden weights gradients",
    )


class MlfcCall(Call):
    """T steps on the CPU in one type."""

    family: ClassVar[str] = "mlfc"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(
        self, core: Core, inputs: Tensor, fed: Tensor, hidden: Tensor, *, weights: Sequence[Tensor], keep: bool,
        forced: Tensor | None, mask: Tensor | None,
    ) -> None:  # fmt: skip
        """
        Args:
            core: the compiled library.
            inputs, fed, hidden, forced: as for `registry.kernels.mlfc.mlfc`.
            weights: those of the layers, then the read-out.
            keep: for a way back.
            mask: (T, M, L·H, lanes) of dropout, at least as many lanes as windows, a multiple of 32.
        """
        *lead, batch, steps, m = inputs.shape
        self.models = lead[0] if lead else 1
        n = weights[-1].shape[-2]
        super().__init__(
            core, inputs, models=self.models, batch=batch, steps=steps, inputs=m, outputs=n, layers=len(weights) - 1,
            cells=weights[0].shape[-2], mask_lanes=0 if mask is None else mask.shape[-1], keep=keep,
        )  # fmt: skip
        self.y, self.fed, self.hidden = (*lead, batch, steps, n), tuple(fed.shape), tuple(hidden.shape)
        self.point("u", inputs)
        self.point("fed", fed)
        self.point("hidden", hidden)
        self.point("forced", forced)
        self.point("mask", mask)
        self.read(weights, bool(lead))

    def forward(self) -> tuple[Tensor, Tensor]:
        """Outputs (…, B, T, n) and hidden states (…, B, L·H) after the run."""
        made = self.new("y", self.y), self.new("end_hidden", self.hidden)
        self.run("forward", self.models)
        return made

    def backward(self, dy: Tensor | None, d_end: Tensor | None, inputs_too: bool = False) -> tuple[Tensor, ...]:
        """Gradients of inputs, fed outputs and states, then of the weights."""
        held = len(self.held)
        self.point("dy", self.like.new_zeros(self.y) if dy is None else dy)
        self.point("d_end_hidden", self.like.new_zeros(self.hidden) if d_end is None else d_end)
        gradients = self.gradients()
        shapes = {"du": tuple(self.like.shape), "d_fed": self.fed, "d_hidden": self.hidden}
        made = [self.new(name, shape) for name, shape in shapes.items()]
        self.run("backward")
        del self.held[held:]
        return (*made, *gradients)
