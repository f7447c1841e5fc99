"""The matrix products of a recurrent layer alone, as the native kernels do them (products.cpp)."""

import ctypes
from typing import ClassVar

import torch
from torch import Tensor

from registry.kernels.native.call import Call, structure
from registry.kernels.native.library import Core
from registry.kernels.workspace import Workspace


class _Structure(ctypes.Structure):
    """`Call` of products.cpp."""

    _fields_ = structure("columns rows batch steps backward", arrays="weight x g out dx")


class Products(Call):
    """Forward and data-gradient products of some time steps and their weight gradient, on noise, float32."""

    family: ClassVar[str] = "products"
    structure: ClassVar[type[ctypes.Structure]] = _Structure

    def __init__(self, core: Core, columns: int, rows: int, batch: int, steps: int, backward: bool) -> None:
        """
        Args:
            core: the library.
            columns, rows: of the weight.
            batch: windows.
            steps: time steps a call, whose weight gradient is taken at once.
            backward: whether there are gradients.
        """
        self.weight = torch.randn(rows, columns)
        super().__init__(core, self.weight, columns=columns, rows=rows, batch=batch, steps=steps, backward=backward)
        block = core.functions.products_block_f()
        blocks = -(-batch // block)
        self.x, self.g = torch.randn(steps, blocks, columns, block), torch.randn(steps, blocks, rows, block)
        for name, x in (("weight", self.weight), ("x", self.x), ("g", self.g)):
            self.point(name, x)
        self.out: Tensor = self.new("out", (blocks, rows, block))
        self.dx: Tensor = self.new("dx", (blocks, columns, block))
        self._call("sizes")
        self.kept = Workspace(self.fields.kept_size, self.weight)
        self.fields.kept = self.kept.address
        self._call("pack")

    def __call__(self) -> None:
        """All of them once."""
        self._call("multiply")
