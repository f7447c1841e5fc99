"""Natural cubic splines as functions of their values at the knots, in which they are linear."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy  # its parts are imported when they are used: scipy.interpolate takes longer than most of what is here
import torch
from torch import Tensor


def basis(knots: tuple[float, ...], x: Tensor) -> Tensor:
    """Cardinal splines (…, K) at ``x`` (…): the spline through values v at K knots is ``basis @ v``.

    Beyond the outer knots a natural spline goes on as a straight line.
    """
    at, pieces = _pieces(knots, x.dtype, x.device)
    inside = x.clamp(knots[0], knots[-1])
    place = torch.bucketize(inside.contiguous(), at[1:-1], right=True)
    step = (inside - at[place]).unsqueeze(-1)
    cubic, square, slope, level = (p[place] for p in pieces)
    value = ((cubic * step + square) * step + slope) * step + level
    beyond = (x - inside).unsqueeze(-1)
    return value + beyond * ((3 * cubic * step + 2 * square) * step + slope)


def through(knots: tuple[float, ...], values: Tensor, x: Tensor) -> Tensor:
    """The spline through ``values`` (…, K) at K knots, at ``x`` (…): `basis` @ values, in operations on single numbers.

    It climbs knot by knot: in each interval by the cubic of the part of it that lies below ``x``.
    """
    at, bends = values.unbind(-1), (values.unsqueeze(-2) * _bends(knots, x.dtype, x.device)).sum(-1).unbind(-1)
    slope = _slope(at, bends, knots, 0)
    out = at[0] + (x - knots[0]).clamp(max=0.0) * slope
    for j, (low, high) in enumerate(pairwise(knots)):
        inside, width = x.clamp(low, high) - low, high - low
        cubic, slope = (bends[j + 1] - bends[j]) / (6 * width), _slope(at, bends, knots, j)
        out = out + inside * (slope + inside * (bends[j] / 2 + inside * cubic))
    width = knots[-1] - knots[-2]
    return out + (x - knots[-1]).clamp(min=0.0) * (slope + width * (bends[-2] + bends[-1]) / 2)


def _slope(at: Sequence[Tensor], bends: Sequence[Tensor], knots: Sequence[float], j: int) -> Tensor:
    """At knot j, to its right, by the values and the second derivatives at all knots."""
    width = knots[j + 1] - knots[j]
    return (at[j + 1] - at[j]) / width - width * (2 * bends[j] + bends[j + 1]) / 6


def roughness(knots: Sequence[float]) -> np.ndarray:
    """Ω (K, K): vᵀΩv is the integral of the squared second derivative of the spline through values v."""
    cubic, square = _cardinal(tuple(knots)).c[:2]  # each (K − 1, K)
    width = np.diff(knots)
    first, last = 2 * square, 2 * square + 6 * cubic * width[:, None]  # second derivatives, linear in between
    both = first.T @ (width[:, None] * last)
    ends = first.T @ (width[:, None] * first) + last.T @ (width[:, None] * last)
    out: np.ndarray = ends / 3 + (both + both.T) / 6
    return out


@lru_cache(maxsize=256)
def _cardinal(knots: tuple[float, ...]) -> "scipy.interpolate.CubicSpline":
    return scipy.interpolate.CubicSpline(knots, np.eye(len(knots)), bc_type="natural")


@lru_cache(maxsize=256)
def _bends(knots: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """(K, K) second derivatives at the knots of the spline through each unit of values."""
    inner = 2 * _cardinal(knots).c[1][1:]
    with torch.inference_mode(False):
        return torch.as_tensor(np.pad(inner, ((1, 1), (0, 0))), dtype=dtype, device=device)


@lru_cache(maxsize=256)
def _pieces(knots: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    with torch.inference_mode(False):
        coefficients = torch.as_tensor(_cardinal(knots).c.copy(), dtype=dtype, device=device)
        return torch.as_tensor(knots, dtype=dtype, device=device), coefficients
