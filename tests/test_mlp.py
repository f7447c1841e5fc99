"""Both kernels of the perceptron against a product and a tanh at a time."""

from collections.abc import Callable
from itertools import pairwise

import pytest
import torch
from test_native import KERNELS, kernel
from torch import Tensor

from registry.kernels.mlp import mlp

SIZES = (((5, 3), 37), ((70, 100, 200), 64), ((1, 1), 1), ((33, 64, 31, 2), 256))
Layers = list[tuple[Tensor, Tensor]]


def network(
    widths: tuple[int, ...], batch: int, *models: int, dtype: torch.dtype = torch.float64
) -> tuple[Tensor, Layers]:
    """Inputs and weights, drawn at random."""
    torch.manual_seed(1)
    x = torch.randn(*models, batch, widths[0], dtype=dtype)
    return x, [
        (torch.randn(*models, n, k, dtype=dtype) / k**0.5, torch.randn(*models, n, dtype=dtype))
        for k, n in pairwise(widths)
    ]


def plain(x: Tensor, layers: Layers) -> Tensor:
    """One model, as the equation says."""
    for i, (weight, bias) in enumerate(layers):
        x = (x.tanh() if i else x) @ weight.T + bias
    return x


def everything(run: Callable[..., Tensor], x: Tensor, layers: Layers, slope: Tensor) -> list[Tensor]:
    """Outputs, then the gradients of inputs and weights."""
    x, layers = (
        x.clone().requires_grad_(),
        [(w.clone().requires_grad_(), b.clone().requires_grad_()) for w, b in layers],
    )
    y = run(x, layers)
    return [y.detach(), *torch.autograd.grad(y, [x, *(w for layer in layers for w in layer)], slope)]


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize(("widths", "batch"), SIZES)
def test_values_and_gradients_are_those_of_the_equation(widths: tuple[int, ...], batch: int, name: str) -> None:
    x, layers = network(widths, batch)
    slope = torch.randn(batch, widths[-1], dtype=torch.float64)
    exact = everything(plain, x, layers, slope)
    with kernel(name):
        found = everything(mlp, x, layers, slope)
        single = everything(mlp, x.float(), [(w.float(), b.float()) for w, b in layers], slope.float())
    for a, b, c in zip(found, single, exact, strict=True):
        assert float((a - c).norm() / c.norm()) < 1e-13
        assert float((b.double() - c).norm() / c.norm()) < 1e-6


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("batch", [32, 64])
def test_a_models_bits_do_not_depend_on_its_neighbours(batch: int, name: str) -> None:
    x, layers = network((14, 24, 9), batch, 3, dtype=torch.float32)
    slope = torch.randn(3, batch, 9)
    with kernel(name):
        many = everything(mlp, x, layers, slope)
        for i in range(3):
            one = slice(i, i + 1)
            alone = everything(mlp, x[one], [(w[one], b[one]) for w, b in layers], slope[one])
            assert all(torch.equal(a[0], b[i]) for a, b in zip(alone, many, strict=True))


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_not_finite_comes_out(bad: float, name: str) -> None:
    x, layers = network((4, 8, 2), 5)
    layers[1][0][1, 3] = bad
    with kernel(name):
        y = mlp(x, layers)
    assert torch.isfinite(y[:, 0]).all() and not torch.isfinite(y[:, 1]).any()


def test_weights_that_lie_apart_are_read_where_they_are() -> None:
    """As in training, where each model's weights are a piece of its row."""
    x, layers = network((6, 5, 3), 32, 2)
    rows = torch.cat([w.flatten(1) for layer in layers for w in layer], 1)
    pieces = rows.split([w[0].numel() for layer in layers for w in layer], 1)
    views = [p.view_as(w) for p, w in zip(pieces, (w for layer in layers for w in layer), strict=True)]
    with kernel("native"):
        assert torch.equal(mlp(x, list(zip(views[::2], views[1::2], strict=True))), mlp(x, layers))
