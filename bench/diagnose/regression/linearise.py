"""A model and its rivals, linearised on measured states: directions that a regression can choose from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import torch

from bench.diagnose.regression.generic import Dictionary
from bench.diagnose.regression.least_squares import Normal, filtered
from bench.diagnose.regression.parameters import Entry, effect_entries, entries, probes, with_values
from bench.diagnose.regression.weak import Stack, TestFunctions, mean_rates
from registry.core import EFFECTS
from registry.dynamics import Effect, InputEffect, PhysicsModel

UNSTABLE = 1e6
"""Rates, relative to the model's own, that no physical effect adds."""
FOLDS = 3
"""Fewest parts of which each is held out once: recordings, or stretches of them where there are fewer."""
WIDE = 0.2
"""Relative 1σ of a constant from which what an effect does depends on it too much for one linearisation."""
BLOCK_SECONDS = 4.0
"""Length of the blocks whose losses are compared: longer than what is left in a residual remembers."""


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

    def project(self, tests: TestFunctions, more: Dictionary | None = None) -> "Rows":
        """Rows of the weak form, with the terms of a dictionary as further columns."""
        dt, out = self.stack.dt, []
        for i, log in enumerate(self.stack.logs):
            columns = tests.integral(i, self.columns[:, i], dt)
            terms = columns[:0] if more is None else more.project(tests, i, dt)
            measured = tests.increment(i, log.states.numpy()[:, list(self.channels)])
            left = measured - tests.integral(i, self.rates[None, i], dt)[0]
            out.append(np.concatenate([columns, terms, left[None]]))
        return Rows(tuple(out), tests.hop * dt)


@dataclass(frozen=True, eq=False)
class Rows:
    """The weak form of a model and of what could explain its residual."""

    columns: tuple[np.ndarray, ...]
    """A log: (c + 1, J, channels), the last is the residual."""
    hop: float
    """[s]."""

    @property
    def width(self) -> int:
        """Number of columns without the residual."""
        return self.columns[0].shape[0] - 1

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.columns[0].shape[2]

    def normal(self, filters: Sequence[np.ndarray], noise: np.ndarray | None = None) -> Normal:
        """Normal equations, block by block, of the rows whitened by a filter a channel.

        Args:
            filters: whitening filters.
            noise: (channels, c + 1, c + 1) what a row owes to noise of the inputs; it is taken off.
        """
        grams, fold, count = [], [], []
        parts = 1 if len(self.columns) >= FOLDS else -(-FOLDS // len(self.columns))
        for i, x in enumerate(self.whitened(filters)):
            length = max(1, min(round(BLOCK_SECONDS / self.hop), x.shape[1] // (5 * parts)))
            for start in range(0, x.shape[1], length):
                rows = x[:, start : start + length]  # (channels, rows, c + 1)
                if rows.shape[1] >= length // 2 or x.shape[1] < length:
                    gram = np.matmul(rows.transpose(0, 2, 1), rows)
                    grams.append(gram if noise is None else gram - rows.shape[1] * noise)
                    fold.append(i * parts + min(start * parts // x.shape[1], parts - 1))
                    count.append(rows.shape[1])
        return Normal(np.stack(grams), np.array(fold), np.array(count))

    def folds(self, filters: Sequence[np.ndarray]) -> list[np.ndarray]:
        """A fold: normal equations (c + 1, c + 1) of its whitened rows, all channels together."""
        parts = 1 if len(self.columns) >= FOLDS else -(-FOLDS // len(self.columns))
        return [
            np.matmul(piece.transpose(0, 2, 1), piece).sum(0)
            for x in self.whitened(filters)
            for piece in np.array_split(x, parts, axis=1)
        ]

    def whitened(self, filters: Sequence[np.ndarray]) -> list[np.ndarray]:
        """A log: the whitened rows (channels, J', c + 1)."""
        return [
            np.stack([filtered(np.ascontiguousarray(x[:, :, c].T), f) for c, f in enumerate(filters)])
            for x in self.columns
        ]

    def noise(self, perturbed: "Rows", filters: Sequence[np.ndarray]) -> np.ndarray:
        """What a row owes to noise (channels, c + 1, c + 1), from the rows of inputs with such noise added again."""
        moved = Rows(tuple(b - a for a, b in zip(self.columns, perturbed.columns, strict=True)), self.hop)
        parts = moved.whitened(filters)
        grams = sum(np.matmul(x.transpose(0, 2, 1), x) for x in parts)
        out: np.ndarray = grams / max(1, sum(x.shape[1] for x in parts))
        return out

    def some(self, columns: Sequence[int]) -> "Rows":
        """The rows with some of the columns; the last of them stands for the residual."""
        return Rows(tuple(x[list(columns)] for x in self.columns), self.hop)

    def residuals(self, beta: np.ndarray) -> list[np.ndarray]:
        """A log: what all columns with these coefficients (c,) leave (J, channels)."""
        return [x[-1] - np.tensordot(beta, x[:-1], axes=1) for x in self.columns]


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
