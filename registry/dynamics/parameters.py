"""Physical constants as fields of frozen dataclasses, each a number, a tuple of numbers or a tensor."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from registry.core import option
from registry.units import powers_of


@dataclass(frozen=True)
class Parameter:
    """A physical constant: nominal value, bounds and what is known about it."""

    name: str
    unit: str
    value: Any
    low: float | None
    high: float | None
    uncertainty: float
    """Relative, 1σ."""
    neutral: Any
    """Of an effect: the value that makes it no effect."""
    typical: Any
    """Of an effect: a value met on real vehicles."""
    source: str
    about: str
    measure: str = ""
    """Of an effect: the sizes of signals that it is measured in; see `constant`."""
    share: float | None = None
    """Of an effect: a value met in practice, in this measure."""
    relative_to: str = ""
    """Of an effect: the constant of the model that recordings tell it relative to; see `constant`."""


def constant(
    value: Any,
    about: str,
    unit: str,
    *,
    low: float | None = None,
    high: float | None = None,
    source: str = "",
    uncertainty: float = 0.02,
    typical: Any = None,
    measure: str = "",
    share: float | None = None,
    relative_to: str = "",
) -> Any:
    """A dataclass field for a physical constant; of an effect, ``value`` is the neutral one.

    Args:
        value: nominal value, SI.
        about: one line of explanation.
        unit: SI unit.
        low: inclusive bound.
        high: inclusive bound.
        source: where the value comes from.
        uncertainty: relative, 1σ.
        typical: of an effect, a value met on real vehicles.
        measure: of an effect, what the parameter is measured in whatever the machine's size: a product of signals that
            `PhysicsModel.followed` names, such as "speed", "1/input", "force/displacement^3", or the "time_scale" of
            the motion. Its values in `Effect.screen` are shares of how large these became in the recordings.
        share: a value met in practice, in this measure: where a search for it starts, and what it stays at where it is
            not fitted (``uncertainty=0``).
        relative_to: of an effect, a constant of the model that is not fitted, and that recordings tell the parameter
            relative to: it is known no better than that constant is.
    """
    base = option(value, about, unit=unit, low=low, high=high, source=source)
    about_value = {"uncertainty": uncertainty, "typical": typical, "relative_to": relative_to}
    return field(default=value, metadata={**base.metadata, **about_value, "measure": measure, "share": share})


def parameters_of(entry: Any) -> Iterator[Parameter]:
    """The fields of a model or an effect that are a `constant`, in order."""
    for f in dataclasses.fields(entry):
        if "uncertainty" in f.metadata:
            m = f.metadata
            spread, neutral, typical = m["uncertainty"], f.default, m["typical"]
            value = getattr(entry, f.name)
            yield Parameter(
                name=f.name,
                unit=m["unit"],
                value=value,
                low=m["low"],
                high=m["high"],
                uncertainty=spread,
                neutral=neutral,
                typical=typical,
                source=m["source"],
                about=m["help"],
                measure=m["measure"],
                share=m["share"],
                relative_to=m["relative_to"],
            )


def in_measure(p: Parameter, sizes: Mapping[str, float]) -> float:
    """What a share of 1 is of a parameter that has a measure, in its unit; 1 of another.

    Args:
        p: of an effect.
        sizes: how large signals became in recordings, by name, SI. Where one is missing, or never moved, it is what
            makes the typical value.
    """
    powers = powers_of(p.measure)
    if all(sizes.get(name) for name in powers):
        return math.prod(sizes[name] ** power for name, power in powers.items())
    return abs(p.typical or 1.0) / (p.share or 1.0)


def tensor(value: Any, like: Tensor) -> Tensor:
    """A constant (number, nested tuple or tensor) as a tensor of the type and device of ``like``: to read only."""
    if isinstance(value, (float, tuple)) and not torch.compiler.is_exporting():  # tensors made there mean nothing here
        return _fixed(value, like.dtype, like.device)
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)


@lru_cache(maxsize=1024)
def _fixed(value: float | tuple[Any, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    # Made once: in a free run the same few numbers are asked for at every instant. Not as an inference tensor, which
    # could not take part in a later backward pass.
    with torch.inference_mode(False):
        return torch.as_tensor(value, dtype=dtype, device=device)


def vector(values: Sequence[Any], like: Tensor) -> Tensor:
    """Constants (numbers, or tensors (…)) side by side (…, len) in a tensor of the type and device of ``like``."""
    if any(isinstance(v, Tensor) for v in values):
        return torch.stack(torch.broadcast_tensors(*(tensor(v, like) for v in values)), dim=-1)
    return tensor(tuple(values), like)


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Tensors (…, n) of several n, whose leading dimensions broadcast, side by side (…, Σ n)."""
    if any(p.shape[:-1] != parts[0].shape[:-1] for p in parts):
        shape = np.broadcast_shapes(*(p.shape[:-1] for p in parts))  # torch's own imports sympy
        parts = [p.expand(*shape, p.shape[-1]) for p in parts]
    return torch.cat(list(parts), dim=-1)


def total(x: Tensor, dim: int) -> Tensor:
    """Sum over a dimension of a few entries, such as three axes or four rotors: fast also where it is the last one."""
    first, *others = x.unbind(dim)
    return sum(others, first)


def turned(rotation: Tensor, vector: Tensor) -> Tensor:
    """R v (…, 3) of rotations (…, 3, 3) and vectors (…, 3)."""
    return total(rotation * vector.unsqueeze(-2), -1)


def turned_back(rotation: Tensor, vector: Tensor) -> Tensor:
    """Rᵀ v (…, 3) of rotations (…, 3, 3) and vectors (…, 3)."""
    return total(rotation * vector.unsqueeze(-1), -2)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """a × b over the last dimension (…, 3), with broadcasting."""
    ax, ay, az = a.unbind(-1)
    bx, by, bz = b.unbind(-1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], dim=-1)
