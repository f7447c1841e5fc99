"""The floor: the matrix products that no implementation can do without, alone, by each back end that there is."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from bench.speed.timing import Contender
from registry.kernels.native.library import core
from registry.kernels.native.products import Products
from registry.kernels.pointwise import pad16

CHUNK = 256
"""Rows of a weight-gradient product: more would leave the cache between being made and being used."""


@dataclass(frozen=True)
class Product:
    """A layer's products: ``rows`` outputs from ``columns`` inputs for every window, ``steps`` times."""

    columns: int
    rows: int
    steps: int


def floating_operations(products: Iterable[Product], batch: int, backward: bool = True) -> float:
    """Additions and multiplications, without padding."""
    return sum(2.0 * p.columns * p.rows * p.steps * batch for p in products) * (3 if backward else 1)


def ways(product: Product, batch: int, backward: bool = True) -> dict[str, Contender]:
    """Forward, data-gradient and weight-gradient products of ``steps_of(batch)`` time steps, by back end and layout.

    torch's columns are padded to 16, the native kernels' are not. All operands of a call fit the cache where one time
    step does: nothing but the products themselves is measured.
    """
    k, n, steps = pad16(product.columns), product.rows, steps_of(batch)
    x, g, xs, gs = (torch.randn(r, c) for r, c in ((batch, k), (batch, n), (steps * batch, k), (steps * batch, n)))
    w = torch.randn(n, k)
    wt, xt, gt, xst, gst = (a.T.contiguous() for a in (w, x, g, xs, gs))
    out, out_t, dx, dx_t, dw = (torch.zeros(s) for s in ((batch, n), (n, batch), (batch, k), (k, batch), (n, k)))

    def rows() -> None:
        for _ in range(steps):
            torch.mm(x, wt, out=out)
            if backward:
                torch.mm(g, w, out=dx)
        if backward:
            dw.addmm_(gs.T, xs)

    def columns() -> None:
        for _ in range(steps):
            torch.mm(w, xt, out=out_t)
            if backward:
                torch.mm(wt, gt, out=dx_t)
        if backward:
            dw.addmm_(gst, xst.T)

    def onednn() -> None:
        for _ in range(steps):
            _onednn(x, w)
            if backward:
                _onednn(g, wt)
        if backward:
            _onednn(gst, xst)

    made: dict[str, Contender] = {"BLAS, by rows": rows, "BLAS, by columns": columns}
    if torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise"):
        made["oneDNN"] = onednn
    if native := core():
        made["native"] = Products(native, product.columns, product.rows, batch, steps, backward)
    return made


def steps_of(batch: int) -> int:
    """Time steps that one weight-gradient product spans."""
    return max(1, CHUNK // batch)


def _onednn(x: Tensor, weight: Tensor) -> Tensor:
    """X Wᵀ by oneDNN, which `torch.mm` leaves aside in float32."""
    product: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, None, "none", [], "")
    return product
