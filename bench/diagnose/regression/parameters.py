"""The numbers of a model that may be fitted, as one vector: its constants within their uncertainty, its effects'."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bench.diagnose.settings import CALIBRATING, EXTENDING, LINEARISING
from registry.dynamics import Effect, Parameter, PhysicsModel, in_measure


@dataclass(frozen=True)
class Entry:
    """One number of a model."""

    owner: int
    """−1: the base model; else the effect's place in ``model.effects``."""
    name: str
    component: int | None
    """Within a vector constant such as the inertia."""
    unit: str
    value: float
    scale: float
    """Of a constant its 1σ, of an effect's parameter a typical value."""
    low: float
    high: float
    neutral: float = 0.0
    """Of an effect's parameter: the value that makes it no effect."""
    stated: float = 0.0
    """Of a constant: the value that its uncertainty is about."""
    relative: float = 0.0
    """Of an effect's parameter: relative 1σ of the constant that it is told relative to, if any."""

    @property
    def constant(self) -> bool:
        """Whether it belongs to the base model, and so has a prior."""
        return self.owner < 0

    @property
    def hardly_known(self) -> bool:
        """Whether it is a constant that is known to an order of magnitude at best, as one that was let go."""
        return self.constant and self.scale >= CALIBRATING.free * abs(self.stated) * (1 - 1e-9)

    def pull(self, value: float) -> tuple[float, float]:
        """Precision of what is known of a step from ``value``, and the step to its centre; 0, 0 where nothing is.

        Of a positive constant the logarithm is normal: it may as well be half as large as twice.
        """
        if not self.constant:
            return 0.0, 0.0
        if self.low > 0 and value > 0:
            return (value * self.scale / self.stated) ** -2, value * math.log(self.stated / value)
        return self.scale**-2, self.stated - value

    def interval(self, value: float, half: float) -> tuple[float, float]:
        """``value`` ± ``half``, cut where it cannot be; a constant's bounds are only where calibration stops."""
        low, high = value - half, value + half
        if self.constant:
            return (max(low, 0.0) if self.low >= 0 else low), high
        return max(low, self.low), min(high, self.high)

    def told(self, value: float, half: float) -> tuple[float, float]:
        """Its 95 % interval, where recordings leave ``half`` open and what it is told relative to its share."""
        return self.interval(value, math.hypot(half, EXTENDING.interval * self.relative * value))

    def pushed(self, value: float) -> bool:
        """Whether a value is at a bound, or beyond it, and makes an effect: what is best there imitates another."""
        return value != self.neutral and not self.low < value < self.high

    def stopped(self, value: float) -> bool:
        """Whether a constant is taken as far as calibration may."""
        return self.constant and any(math.isclose(value, bound, rel_tol=1e-6) for bound in (self.low, self.high))

    @property
    def label(self) -> str:
        """Such as "inertia[2]"."""
        return self.name if self.component is None else f"{self.name}[{self.component}]"


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known beforehand of steps (p,) of a model's numbers from where they are."""

    precision: np.ndarray
    """1/σ²; 0: of an effect's parameter nothing is known but its bounds."""
    centre: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, own: Sequence[Entry], values: Sequence[float] | np.ndarray | None = None) -> "Prior":
        """Of the numbers ``own`` of a model; ``values`` where they are now, default their own."""
        at = np.array([e.value for e in own]) if values is None else np.asarray(values)
        pulls = np.array([e.pull(v) for e, v in zip(own, at.tolist(), strict=True)]).reshape(-1, 2)
        low, high = (np.array([getattr(e, side) for e in own]) for side in ("low", "high"))
        return cls(pulls[:, 0], pulls[:, 1], low - at, high - at)

    def loosened(self, own: Sequence[Entry]) -> "Prior":
        """With bounds of constants that only keep their sign: noise of the inputs makes them seem far too small."""
        constant = np.array([e.constant for e in own], dtype=bool)
        low, high = np.array([sign_kept(e.value or e.scale) for e in own]).reshape(-1, 2).T
        return dataclasses.replace(
            self, low=np.where(constant, low, self.low), high=np.where(constant, high, self.high)
        )


def sign_kept(value: float) -> tuple[float, float]:
    """Bounds of a step of a constant of which only the sign is known: to a tenth of it, or ten times."""
    return -0.9 * abs(value), 9.0 * abs(value)


def entries(model: PhysicsModel, uncertainty: dict[str, float], nominal: PhysicsModel | None = None) -> list[Entry]:
    """The constants that have an uncertainty, then every effect's parameters.

    Args:
        model: its present values.
        uncertainty: relative 1σ of constants as stated; default: `PhysicsModel.rough`, or the constant's own.
        nominal: the model whose constants the uncertainties are relative to; default ``model``.
    """
    found = []
    reference = {p.name: p.value for p in (nominal or model).parameters()}
    spreads = {}
    for p in model.parameters():
        rough = p.name in model.rough and p.name not in uncertainty and p.uncertainty > 0
        spread = spreads[p.name] = model.rough[p.name] if rough else uncertainty.get(p.name, p.uncertainty)
        if spread <= 0:
            continue
        values, base = _flat(p.value), _flat(reference[p.name])
        for i, (v, b) in enumerate(zip(values, base, strict=True)):
            if b != 0:
                component, scale = None if np.ndim(p.value) == 0 else i, abs(b) * spread
                low, high = _bounds(p)
                positive = b > 0 and low >= 0.0
                ends = (b * math.exp(-CALIBRATING.within * spread), b * math.exp(CALIBRATING.within * spread))
                least, most = ends if positive else (b - CALIBRATING.within * scale, b + CALIBRATING.within * scale)
                low, high = max(low, least), min(high, most)
                found.append(Entry(-1, p.name, component, p.unit, v, scale=scale, low=low, high=high, stated=b))
    for i, effect in enumerate(model.effects):
        relative = {p.name: spreads.get(p.relative_to, 0.0) for p in effect.parameters()}
        found += [
            dataclasses.replace(e, unit=model.effect_unit(e.unit), relative=relative[e.name])
            for e in effect_entries(effect, i)
        ]
    return found


def effect_entries(effect: Effect, owner: int, sizes: Mapping[str, float] | None = None) -> list[Entry]:
    """An effect's parameters that can be fitted; of a vector each component is a number of its own.

    Args:
        effect: with its values.
        owner: its place among the model's effects.
        sizes: how large signals became in the recordings, which tell the scale of parameters that they measure.
    """
    found = []
    for p in effect.parameters():
        if p.uncertainty > 0:
            low, high = _bounds(p)
            for i, (v, neutral) in enumerate(zip(_flat(p.value), _flat(p.neutral), strict=True)):
                at, scale = i if np.ndim(p.value) else None, _scale(p, i, sizes or {})
                found.append(Entry(owner, p.name, at, p.unit, v, scale=scale, low=low, high=high, neutral=neutral))
    return found


def with_values(model: PhysicsModel, where: Sequence[Entry], values: np.ndarray | Tensor) -> PhysicsModel:
    """The model with numbers replaced.

    Args:
        where: P entries.
        values: (P,) for numbers, or a tensor (B, P): parameters become tensors (B, 1, 1), for B models at once.
    """
    changes: dict[int, dict[str, Any]] = {}
    for j, entry in enumerate(where):
        value: Any = values[..., j]
        value = value[:, None, None] if isinstance(value, Tensor) and value.dim() else float(value)
        owner: Any = model if entry.owner < 0 else model.effects[entry.owner]
        fields = changes.setdefault(entry.owner, {})
        if entry.component is None:
            fields[entry.name] = value
        else:
            vector = fields.get(entry.name, list(_flat(getattr(owner, entry.name))))
            vector[entry.component] = value
            fields[entry.name] = vector
    for fields in changes.values():
        for name, value in fields.items():
            if isinstance(value, list):
                fields[name] = _joined(value)
    effects = list(model.effects)
    for i, fields in changes.items():
        if i >= 0:
            effects[i] = dataclasses.replace(effects[i], **fields)
    return dataclasses.replace(model, effects=tuple(effects), **changes.get(-1, {}))


def probes(where: Sequence[Entry]) -> tuple[Tensor, np.ndarray]:
    """Values (P + 1, P) for a Jacobian by one-sided differences, and the steps (P,): the first row is where it is."""
    at = np.array([e.value for e in where])
    reach = [e.scale * LINEARISING.probe for e in where]
    steps = np.array([r if e.value + r <= e.high else -r for e, r in zip(where, reach, strict=True)])
    return torch.from_numpy(np.concatenate([at[None], at + np.diag(steps)])), steps


def _joined(vector: list[Any]) -> Any:
    batch = next((v.shape for v in vector if isinstance(v, Tensor)), None)
    if batch is None:
        return tuple(vector)
    filled = [v if isinstance(v, Tensor) else torch.full(batch, v, dtype=torch.float64) for v in vector]
    return torch.stack(filled, dim=-1)


def _flat(value: Any) -> list[float]:
    """A number or a flat vector as a list; a nested one (rotor positions) is not fitted."""
    if np.ndim(value) == 0:
        return [float(value)]
    return [float(v) for v in value] if np.ndim(value) == 1 else []


def _scale(p: Parameter, component: int, sizes: Mapping[str, float]) -> float:
    if p.share and sizes:
        return p.share * in_measure(p, sizes)
    if p.measure and p.value:  # what is typical of one machine is much or nothing in another
        return abs(float(p.value))
    return abs(_flat(p.typical or 0.0)[component]) or 1.0


def _bounds(p: Parameter) -> tuple[float, float]:
    return (-np.inf if p.low is None else p.low), (np.inf if p.high is None else p.high)
