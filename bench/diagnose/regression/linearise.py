"""A model and its rivals, linearised on measured states: directions that a regression can choose from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import torch

from bench.diagnose.regression.generic import Dictionary
from bench.diagnose.regression.parameters import Entry, effect_entries, entries, probes, with_values
from bench.diagnose.regression.rows import Rows
from bench.diagnose.regression.weak import Stack, TestFunctions, mean_rates
from registry.core import EFFECTS
from registry.dynamics import Effect, InputEffect, PhysicsModel

UNSTABLE = 1e6
"""Rates, relative to the model's own, that no physical effect adds."""
WIDE = 0.2
"""Relative 1σ of a constant from which what an effect does depends on it too much for one linearisation."""


@dataclass(frozen=True)
class Start:
    """One effect that could be added, linearised about one value of its parameters."""

    id: str
    effect: Effect
    entries: tuple[Entry, ...]
    columns: tuple[int, ...]
    """The offset from no effect to this value (if any), then a column a parameter."""
    low: tuple[float, ...]
    high: tuple[float, ...]
    instead: Mapping[int, int] = field(default_factory=dict)
    """By column of a widely uncertain constant, the one that it has with the effect, where that acts on the inputs."""

    def effect_at(self, beta: Sequence[float]) -> Effect:
        """The effect with the parameters that coefficients of its columns say."""
        steps = list(beta)[len(self.columns) - len(self.entries) :]
        values = {e.name: float(np.clip(e.value + b, e.low, e.high)) for e, b in zip(self.entries, steps, strict=True)}
        return replace(self.effect, **values)


@dataclass(frozen=True, eq=False)
class Directions:
    """How the rates of a model over every sampling interval change with each of its numbers and with rival effects."""

    model: PhysicsModel
    stack: Stack
    own: tuple[Entry, ...]
    """The model's constants and its effects' parameters: the first columns."""
    starts: tuple[Start, ...]
    rates: np.ndarray
    """(L, N − 1, channels) of the model itself."""
    columns: np.ndarray
    """(c, L, N − 1, channels)."""
    channels: tuple[int, ...]
    """State channels whose rates respond to any of it."""
    removals: tuple[int, ...]
    """An effect of the model: the column that takes it away, with those that cannot do without it."""
    dependants: tuple[frozenset[int], ...]
    """An effect of the model: the places of those that cannot do without it."""
    reduced: tuple[Mapping[int, int], ...]
    """An effect of the model: by column of a widely uncertain constant, the one that it has without the effect."""

    def away(self, dropped: Collection[int]) -> tuple[set[int], list[int]]:
        """Places of all effects that go with those in the places ``dropped``, and the columns that take them away."""
        follow = {j for i in dropped for j in self.dependants[i]}
        return follow | set(dropped), [self.removals[i] for i in sorted(set(dropped) - follow)]

    def changed(self, columns: Sequence[int], dropped: Collection[int], added: Sequence[Start] = ()) -> list[int]:
        """Columns of ``own`` as they are without the effects in the places ``dropped``, and with those ``added``."""
        instead = {c: r for i in dropped for c, r in self.reduced[i].items()}
        instead |= {c: r for s in added for c, r in s.instead.items()}
        return [instead.get(c, c) for c in columns]

    def moved(self, noisy: "Directions") -> "Directions":
        """These directions with those of the same names as ``noisy`` has them."""
        columns = self.columns.copy()
        same = len(self.own) + len(self.removals) + sum(map(len, self.reduced))
        columns[:same] = noisy.columns[:same]
        same_start = {(s.id, s.effect): s for s in noisy.starts}
        for s in self.starts:
            if (s.id, s.effect) in same_start:
                its = same_start[s.id, s.effect]
                columns[list(s.columns)] = noisy.columns[list(its.columns)]
                columns[list(s.instead.values())] = noisy.columns[list(its.instead.values())]
        return replace(self, rates=noisy.rates, columns=columns)

    def project(self, tests: TestFunctions, more: Dictionary | None = None) -> Rows:
        """Rows of the weak form, with the terms of a dictionary as further columns."""
        dt, count = self.stack.dt, len(self.columns)
        terms = [] if more is None else more.on_channels(len(self.channels))
        width = count + (0 if more is None else len(more.terms))
        own = [np.flatnonzero(np.abs(self.columns[..., c]).max((1, 2))) for c in range(len(self.channels))]
        acting = [
            np.concatenate([mine, *(count + place.places for place in places), [width]]).astype(int)
            for mine, places in zip(own, terms or [[]] * len(own), strict=True)
        ]
        out = []
        for i, log in enumerate(self.stack.logs):
            measured = tests.increment(i, log.states.numpy()[:, list(self.channels)])
            values = None if more is None else more.of_log(i)
            parts = []
            for c, mine in enumerate(own):
                left = measured[:, c] - tests.integral(i, c, self.rates[i, :, c], dt)
                columns = [tests.integral(i, c, self.columns[mine, i, :, c].T, dt)]
                if more is not None and values is not None:
                    columns += [tests.integral(i, c, more.along(place, i, values), dt) for place in terms[c]]
                parts.append(np.column_stack([*columns, left]))
            out.append(tuple(parts))
        return Rows(tuple(out), tuple(acting), width, tests.hop * dt)


def directions(
    model: PhysicsModel,
    nominal: PhysicsModel,
    uncertainty: dict[str, float],
    stack: Stack,
    candidates: Sequence[tuple[str, type[Effect]]] = (),
    tick: Callable[[str], None] = lambda name: None,
) -> Directions:
    """Linearise ``model`` in its numbers, and in those of every candidate effect added to it."""
    own = entries(model, uncertainty, nominal)
    values, steps = probes(own)
    found = mean_rates(with_values(model, own, values), stack).numpy()
    at = found[0]
    columns = list((found[1:] - at) / steps[:, None, None, None])
    acts = [bool(np.abs(c).max() > 0) for c in columns]  # a model may have constants that this input does not use
    own, columns = ([x for x, a in zip(xs, acts, strict=True) if a] for xs in (own, columns))
    removals = tuple(range(len(own), len(own) + len(model.effects)))
    wide = [j for j, e in enumerate(own) if e.constant and e.scale > WIDE * abs(e.value)]
    dependants = tuple(_dependants(model, i) for i in range(len(model.effects)))
    by_constant: list[np.ndarray] = []
    reduced: list[dict[int, int]] = []
    for i in range(len(model.effects)):
        rest = replace(model, effects=tuple(e for j, e in enumerate(model.effects) if j not in {i, *dependants[i]}))
        without = mean_rates(rest, stack).numpy()
        columns.append(without - at)
        first = len(own) + len(model.effects) + len(by_constant)
        reduced.append({j: first + k for k, j in enumerate(wide)})
        by_constant += _by_constant(rest, [own[j] for j in wide], without, stack)
    columns += by_constant
    scale = float(np.abs(at).max()) or 1.0
    starts: list[Start] = []
    for name, kind in candidates:
        tick(name)
        points = _starting_points(kind)
        fitted = [effect_entries(effect, len(model.effects)) for effect in points]
        probed = [probes(where) for where in fitted]
        extended = replace(model, effects=(*model.effects, points[0]))
        plain = points == [kind.neutral()]  # then the first probe is the model itself
        together = torch.cat([values[plain:] for values, _ in probed])
        found = mean_rates(with_values(extended, fitted[0], together), stack).numpy()
        if plain:
            found = np.concatenate([at[None], found])
        for i, (effect, where) in enumerate(zip(points, fitted, strict=True)):
            x, steps = found[i * (len(where) + 1) : (i + 1) * (len(where) + 1)], probed[i][1]
            if not np.isfinite(x).all() or np.abs(x).max() > UNSTABLE * scale:
                continue  # it is unstable at this sampling rate, and says nothing
            offset = not plain
            first, width = len(columns), len(where) + offset
            columns += [x[0] - at] * offset + list((x[1:] - x[0]) / steps[:, None, None, None])
            reach = [_reach(kind, e) for e in where]
            low = (*[1.0] * offset, *(r[0] - e.value for r, e in zip(reach, where, strict=True)))
            high = (*[1.0] * offset, *(r[1] - e.value for r, e in zip(reach, where, strict=True)))
            instead = {}
            if issubclass(kind, InputEffect) and offset:
                instead = {j: len(columns) + k for k, j in enumerate(wide)}
                here = replace(model, effects=(*model.effects, effect))
                columns += _by_constant(here, [own[j] for j in wide], x[0], stack)
            starts.append(Start(name, effect, tuple(where), tuple(range(first, first + width)), low, high, instead))
    measured = [i for i in range(at.shape[-1]) if all(log.measured[i] for log in stack.logs)]
    channels = [i for i in measured if any(np.abs(c[..., i]).max() > 0 for c in columns)]
    kept = np.stack([c[..., channels] for c in columns])
    return Directions(
        model,
        stack,
        tuple(own),
        tuple(starts),
        at[..., channels],
        kept,
        tuple(channels),
        removals,
        dependants,
        tuple(reduced),
    )


def _by_constant(model: PhysicsModel, constants: Sequence[Entry], at: np.ndarray, stack: Stack) -> list[np.ndarray]:
    """How the rates ``at`` of ``model`` change with each of its constants (L, N − 1, s)."""
    if not constants:
        return []
    values, steps = probes(constants)
    found = mean_rates(with_values(model, constants, values[1:]), stack).numpy()
    return list((found - at) / steps[:, None, None, None])


def _dependants(model: PhysicsModel, place: int) -> frozenset[int]:
    """The places of effects that need the one in this place, and have no other that would do."""
    rest = {EFFECTS.name_of(type(e)) for j, e in enumerate(model.effects) if j != place} | set(model.provides)
    return frozenset(j for j, e in enumerate(model.effects) if j != place and e.requires and not rest & set(e.requires))


def _reach(kind: type[Effect], entry: Entry) -> tuple[float, float]:
    """Between which values an effect linearised at ``entry`` is believed: to the next ones of its search grid."""
    grid = kind.screen.get(entry.name, ())
    below, above = [v for v in grid if v < entry.value], [v for v in grid if v > entry.value]
    return max(below, default=entry.low), min(above, default=entry.high)


def _starting_points(kind: type[Effect]) -> list[Effect]:
    """Neutral for an effect that is linear in its parameters, else one a value of its search grid."""
    neutral = kind.neutral()
    if not kind.screen:
        return [neutral]
    grids = [dict(zip(kind.screen, values, strict=True)) for values in product(*kind.screen.values())]
    return [replace(neutral, **grid) for grid in grids]
