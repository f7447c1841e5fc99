"""Natural cubic splines as functions of their values at the knots, in which they are linear."""

from collections.abc import Sequence
from functools import lru_cache

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
def _pieces(knots: tuple[float, ...], dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    with torch.inference_mode(False):
        coefficients = torch.as_tensor(_cardinal(knots).c.copy(), dtype=dtype, device=device)
        return torch.as_tensor(knots, dtype=dtype, device=device), coefficients
