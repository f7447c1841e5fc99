"""A model and its rivals, linearised on measured states: directions that a regression can choose from."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.regression.columns import Columns, moves, response
from bench.diagnose.regression.generic import Dictionary
from bench.diagnose.regression.parameters import Entry, effect_entries, entries, probes, with_values
from bench.diagnose.regression.rows import Rows
from bench.diagnose.regression.starting_points import StartingPoints
from bench.diagnose.regression.test_functions import TestFunctions
from bench.diagnose.regression.weak import mean_rates, midpoint_rates
from bench.diagnose.settings import LINEARISING
from registry.core import EFFECTS
from registry.dynamics import Effect, PhysicsModel


@dataclass(frozen=True)
class Candidate:
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
    through: Effect | None = None
    """An effect that acts through this one alone and comes with it, as wind does with a drag. Nothing is linear in both
    at once, but all is in the one and in their product: the last columns are those of its parameters, times `size`.
    Exact for an effect of one parameter; of several it takes them in the proportion of their typical values, which is
    near enough to start from."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Of all effects that it brings."""
        return (self.id,) if self.through is None else (self.id, EFFECTS.name_of(type(self.through)))

    def effects_at(self, beta: Sequence[float]) -> tuple[Effect, ...]:
        """The effects with the parameters that coefficients of its columns say."""
        at = list(zip(self.entries, self._values(beta), strict=True))
        effect = replace(self.effect, **{e.name: float(np.clip(v, e.low, e.high)) for e, v in at[: self._own]})
        if self.through is None:
            return (effect,)
        ends = {p.name: (p.low, p.high) for p in self.through.parameters()}
        return effect, replace(self.through, **{n: float(np.clip(v, *ends[n])) for n, v in self._carried(beta).items()})

    def within_bounds(self, beta: Sequence[float]) -> bool:
        """Whether no parameter is pushed to a bound that is not its neutral value; if one acts through it, it acts."""
        steps = list(beta)[len(self.columns) - len(self.entries) :]
        for e, value, b in zip(self.entries, self._values(beta), steps, strict=True):
            if b != 0 and e.pushed(value):
                return False
        if self.through is None:
            return True
        carried = self._carried(beta)
        ends = (
            (p.name, -np.inf if p.low is None else p.low, np.inf if p.high is None else p.high)
            for p in self.through.parameters()
        )
        return self.size(beta) > 0 and all(low < carried[n] < high for n, low, high in ends if n in carried)

    def _carried(self, beta: Sequence[float]) -> dict[str, float]:
        """Parameters of the effect that acts through this one: neutral where this one does nothing."""
        size, mine = self.size(beta), self._own
        at = zip(self.entries[mine:], self._values(beta)[mine:], strict=True)
        return {e.name: v / size if size > 0 else e.neutral for e, v in at}

    def size(self, beta: Sequence[float]) -> float:
        """The effect's own parameters that coefficients say, as a mean share of typical values."""
        at = zip(self.entries[: self._own], self._values(beta), strict=False)
        return float(np.mean([(v - e.neutral) / e.scale for e, v in at]))

    def _values(self, beta: Sequence[float]) -> list[float]:
        """Values of the entries."""
        steps = list(beta)[len(self.columns) - len(self.entries) :]
        return [e.value + b for e, b in zip(self.entries, steps, strict=True)]

    @property
    def _own(self) -> int:
        """How many of the entries are the effect's."""
        return sum(e.owner == self.entries[0].owner for e in self.entries)


@dataclass(frozen=True, eq=False)
class Linearization:
    """How the rates of a model over every sampling interval change with each of its numbers and with rival effects."""

    model: PhysicsModel
    stack: LogBatch
    own: tuple[Entry, ...]
    """The model's constants and its effects' parameters: the first columns."""
    starts: tuple[Candidate, ...]
    rates: np.ndarray
    """(L, N − 1, channels) of the model itself."""
    columns: Columns
    """c of (L, N − 1, channels)."""
    channels: tuple[int, ...]
    """State channels whose rates respond to any of it."""
    removals: tuple[int, ...]
    """An effect of the model: the column that takes it away, with those that cannot do without it."""
    dependants: tuple[frozenset[int], ...]
    """An effect of the model: the places of those that cannot do without it."""
    reduced: tuple[Mapping[int, int], ...]
    """An effect of the model: by column of a constant, or of an effect through which it acts or that acts through it,
    the one that this has without the effect."""
    carriers: tuple[frozenset[int], ...] = ()
    """An effect of the model: the places of those through one of which it must act; empty: it acts by itself."""

    def removed(self, dropped: Collection[int]) -> tuple[set[int], list[int]]:
        """Places of all effects that go with those in the places ``dropped``, and the columns that take them away."""
        follow = {j for i in dropped for j in self.dependants[i]}
        gone = follow | set(dropped)
        while more := {j for j, through in enumerate(self.carriers) if through and through <= gone} - gone:
            gone |= more  # through one of several that go, each by itself with its share
        return gone, [self.removals[i] for i in sorted(set(dropped) - follow)]

    def changed(self, columns: Sequence[int], dropped: Collection[int], added: Sequence[Candidate] = ()) -> list[int]:
        """Columns of ``own`` as they are without the effects in the places ``dropped``, and with those ``added``."""
        instead = {c: r for i in dropped for c, r in self.reduced[i].items()}
        instead |= {c: r for s in added for c, r in s.instead.items()}
        return [instead.get(c, c) for c in columns]

    def moved(self, noisy: "Linearization") -> "Linearization":
        """These directions with those of the same names as ``noisy`` has them."""
        same = len(self.own) + len(self.removals) + sum(map(len, self.reduced))
        by = dict(enumerate(noisy.columns.responses[:same]))
        same_start = {(s.ids, s.effect): s for s in noisy.starts}
        for s in self.starts:
            if (s.ids, s.effect) in same_start:
                its = same_start[s.ids, s.effect]
                mine, theirs = ((*of.columns, *of.instead.values()) for of in (s, its))
                by |= {j: noisy.columns.responses[i] for j, i in zip(mine, theirs, strict=True)}
        return replace(self, stack=noisy.stack, rates=noisy.rates, columns=self.columns.replaced(by))

    def project(self, tests: TestFunctions, more: Dictionary | None = None) -> Rows:
        """Rows of the weak form, with the terms of a dictionary as further columns."""
        dt, count, states = self.stack.dt, len(self.columns), self.stack.states.shape[-1]
        terms = [] if more is None else more.on_channels(len(self.channels))
        width = count + (0 if more is None else len(more.terms))
        own = [self.columns.acting(c) for c in range(len(self.channels))]
        acting = [
            np.concatenate([mine, *(count + place.places for place in places), [width]]).astype(int)
            for mine, places in zip(own, terms or [[]] * len(own), strict=True)
        ]
        out = []
        for i, log in enumerate(self.stack.logs):
            measured = tests.increment(i, log.paths[:, list(self.channels)])
            values = None if more is None else more.of_log(i)
            parts = []
            for c, mine in enumerate(own):
                left = measured[:, c] - tests.integral(i, c, self.rates[i, :, c], dt)
                columns = [tests.integral(i, c, self.columns.on(c, i, mine), dt)]
                if more is not None and values is not None:
                    columns += [tests.integral(i, c, more.along(place, i, values), dt) for place in terms[c]]
                rows = np.column_stack([*columns, left])
                # What a sensor of rates shows has an offset of its own in every recording.
                parts.append(rows - rows.mean(0) if self.channels[c] >= states and len(rows) else rows)
            out.append(tuple(parts))
        return Rows(tuple(out), tuple(acting), width, tests.stride / self.stack.logs[0].pace)


def directions(
    model: PhysicsModel,
    nominal: PhysicsModel,
    uncertainty: dict[str, float],
    stack: LogBatch,
    candidates: Sequence[tuple[str, type[Effect]]] = (),
    tick: Callable[[str], None] = lambda name: None,
    settled: bool = False,
    pairs: Sequence[tuple[str, type[Effect]]] = (),
    like: Linearization | None = None,
) -> Linearization:
    """Linearise ``model`` in its numbers, and in those of every candidate effect added to it.

    At measured states the rates f(θ) of a model with numbers θ are taken for f + Σ_j (∂f/∂θ_j) δ_j + Σ_i (f_i − f) ε_i:
    a step δ_j of each number, and effects i that come (ε_i = 1, linearised at f_i in their own numbers too) or go.

    Args:
        model: about which it is linearised.
        nominal: the model whose constants the uncertainties are relative to.
        uncertainty: relative 1σ of constants as stated.
        stack: the recordings.
        candidates: ids and kinds of effects that could be added.
        tick: called with the id of each.
        settled: whether no effect of the model is to go: what each does alone need not be known then.
        pairs: ids and kinds of effects that act only through candidates, each of which is tried with them too.
        like: the same on recordings without noise: numbers, channels and starting points are those of it.
    """
    own = entries(model, uncertainty, nominal)
    values, steps = probes(own)
    found = midpoint_rates(with_values(model, own, values), stack).numpy()
    at = found[0].copy("K")
    # A model may have constants that this input does not use.
    acts = [moves(x - at) if like is None else e in like.own for e, x in zip(own, found[1:], strict=True)]
    columns = [c for c, a in zip(_slopes(found[1:], at, steps, stack), acts, strict=True) if a]
    own = [e for e, a in zip(own, acts, strict=True) if a]
    wide = {j: e for j, e in enumerate(own) if e.constant and e.scale > LINEARISING.wide * abs(e.value)}
    dependants = tuple(_dependants(model, i) for i in range(0 if settled else len(model.effects)))
    columns[len(columns) :], reduced = _without(model, dependants, at, own, stack)
    starts: list[Candidate] = []
    points = starting_points(model, stack if like is None else like.stack)
    for name, kind in candidates:
        tick(name)
        starts += _starts(points, name, kind, at, wide=wide, stack=stack, columns=columns)
    for _, kind in pairs:
        single = [s for s in starts if s.through is None and s.id in kind.requires]
        starts += [_paired(points, s, kind, stack, columns) for s in single]
    channels = tuple(i for i in stack.measured if any(i in c for c in columns)) if like is None else like.channels
    return Linearization(
        model=model,
        stack=stack,
        own=tuple(own),
        starts=tuple(starts),
        rates=mean_rates(model, stack).numpy()[..., channels],
        columns=Columns(tuple(columns), channels, at.shape[:-1]),
        channels=channels,
        removals=tuple(range(len(own), len(own) + len(dependants))),
        dependants=dependants,
        reduced=reduced,
        carriers=tuple(_carriers(model, e) for e in model.effects),
    )


def starting_points(model: PhysicsModel, stack: LogBatch) -> StartingPoints:
    """Where searches for effects in a model start on these recordings."""
    states, inputs = (stack.samples(x) for x in (stack.states, stack.inputs))
    return StartingPoints.of(model, states, inputs, stack.logs[0], stack.noise)


Response = dict[int, np.ndarray]
"""By channel that responds, a change of its rates (L, N − 1)."""


def _slopes(found: np.ndarray, at: np.ndarray, steps: np.ndarray, stack: LogBatch) -> list[Response]:
    """How rates change with each number: ``found`` (P, L, N − 1, s) after steps (P,) from where they are ``at``."""
    return [response(x, at, stack.measured, step) for x, step in zip(found, steps, strict=True)]


def _without(
    model: PhysicsModel,
    dependants: Sequence[frozenset[int]],
    at: np.ndarray,
    own: Sequence[Entry],
    stack: LogBatch,
) -> tuple[list[Response], tuple[Mapping[int, int], ...]]:
    """What taking each effect of a model away adds to its rates, and how other numbers act without it.

    Args:
        model: with the effects.
        dependants: by effect, the places of those that go with it.
        at: rates of the model.
        own: the model's numbers, the first columns.
        stack: the recordings.

    Returns:
        A column an effect, then those of the numbers, and `Linearization.reduced`.
    """
    removals: list[Response] = []
    changed: list[Response] = []
    reduced: list[Mapping[int, int]] = []
    for i, others in enumerate(dependants):
        left = [j for j in range(len(model.effects)) if j not in {i, *others}]
        rest = replace(model, effects=tuple(model.effects[j] for j in left))
        without = midpoint_rates(rest, stack).numpy()
        removals.append(response(without, at, stack.measured))
        through = [j for j in left if _tied(model.effects[i], model.effects[j])]
        numbers = [(c, e) for c, e in enumerate(own) if e.constant or e.owner in through]
        first = len(own) + len(dependants) + len(changed)
        reduced.append({c: first + k for k, (c, _) in enumerate(numbers)})
        there = [e if e.constant else replace(e, owner=left.index(e.owner)) for _, e in numbers]
        changed += _with_each(rest, there, without, stack)
    return [*removals, *changed], tuple(reduced)


def _tied(one: Effect, other: Effect) -> bool:
    """Whether one of two effects acts through the other, maybe among others."""
    return any(EFFECTS.name_of(type(b)) in a.requires for a, b in ((one, other), (other, one)))


def _starts(
    points: StartingPoints,
    name: str,
    kind: type[Effect],
    at: np.ndarray,
    wide: Mapping[int, Entry],
    stack: LogBatch,
    columns: list[Response],
) -> list[Candidate]:
    """An effect linearised about every value of its search grid; what it makes of the rates goes to ``columns``.

    Args:
        points: in the model to which it is added.
        name: its id.
        kind: of effect.
        at: rates of the model itself.
        wide: by column, the widely uncertain constants.
        stack: the recordings.
        columns: of the model and of effects before.
    """
    starts, offset = [], bool(kind.screen)
    model = points.model
    for effect, where, x, steps in _probed(points, kind, at, stack):
        first, width = len(columns), len(where) + offset
        columns += [response(x[0], at, stack.measured)] * offset + _slopes(x[1:], x[0], steps, stack)
        reach = [points.reach(kind, e) for e in where]
        low = (*[1.0] * offset, *(r[0] - e.value for r, e in zip(reach, where, strict=True)))
        high = (*[1.0] * offset, *(r[1] - e.value for r, e in zip(reach, where, strict=True)))
        instead = {}
        if kind.changes_model and offset:
            instead = {j: len(columns) + k for k, j in enumerate(wide)}
            here = replace(model, effects=(*model.effects, effect))
            columns += _with_each(here, list(wide.values()), x[0], stack)
        own = tuple(range(first, first + width))
        starts.append(Candidate(name, effect, tuple(where), own, low=low, high=high, instead=instead))
    return starts


def _paired(
    points: StartingPoints, start: Candidate, kind: type[Effect], stack: LogBatch, columns: list[Response]
) -> Candidate:
    """An effect with another one that acts through it; what its typical size makes of that goes to ``columns``."""
    model, second = points.model, points.neutral(kind)[0]
    typical = replace(start.effect, **{e.name: e.neutral + e.scale for e in start.entries})
    both = replace(model, effects=(*model.effects, typical, second))
    where = effect_entries(second, len(model.effects) + 1)
    values, steps = probes(where)
    found = midpoint_rates(with_values(both, where, values), stack).numpy()
    more = tuple(range(len(columns), len(columns) + len(where)))
    columns += _slopes(found[1:], found[0], steps, stack)
    free = (np.inf,) * len(where)
    return replace(
        start,
        entries=(*start.entries, *(replace(e, low=-np.inf, high=np.inf) for e in where)),
        columns=(*start.columns, *more),
        low=(*start.low, *(-f for f in free)),
        high=(*start.high, *free),
        through=second,
    )


def _probed(
    points: StartingPoints, kind: type[Effect], at: np.ndarray, stack: LogBatch
) -> Iterator[tuple[Effect, list[Entry], np.ndarray, np.ndarray]]:
    """Starting points of an effect, their numbers, rates (P + 1, L, N − 1, s) there and after steps (P,), and these.

    Args:
        points: in the model to which the effect is added.
        kind: of effect.
        at: rates of the model itself.
        stack: the recordings.
    """
    model, begun = points.model, points.neutral(kind)
    fitted = [effect_entries(effect, len(model.effects), points.sizes) for effect in begun]
    probed = [probes(where) for where in fitted]
    extended = replace(model, effects=(*model.effects, begun[0]))
    plain = not kind.screen  # then the first probe is the model itself
    limit = LINEARISING.unstable * (float(np.abs(at).max()) or 1.0)
    each = len(fitted[0]) + 1
    some = max(1, -(-LINEARISING.together // each))
    for first in range(0, len(begun), some):
        part = slice(first, first + some)
        together = torch.cat([values[plain:] for values, _ in probed[part]])
        found = midpoint_rates(with_values(extended, fitted[0], together), stack).numpy()
        if plain:
            found = np.concatenate([at[None], found])
        for i, (effect, where, (_, steps)) in enumerate(zip(begun[part], fitted[part], probed[part], strict=True)):
            x = found[i * each : (i + 1) * each]
            if x.max() <= limit and x.min() >= -limit:  # else it is unstable at this sampling rate
                yield effect, where, x, steps


def _with_each(model: PhysicsModel, numbers: Sequence[Entry], at: np.ndarray, stack: LogBatch) -> list[Response]:
    """How the rates ``at`` of ``model`` change with each of some numbers of it."""
    if not numbers:
        return []
    values, steps = probes(numbers)
    return _slopes(midpoint_rates(with_values(model, numbers, values[1:]), stack).numpy(), at, steps, stack)


def _carriers(model: PhysicsModel, effect: Effect) -> frozenset[int]:
    """The places of effects through one of which this one must act; empty: the model does that, or it needs none."""
    if effect.met_by(model.provides):
        return frozenset()
    return frozenset(j for j, e in enumerate(model.effects) if EFFECTS.name_of(type(e)) in effect.requires)


def _dependants(model: PhysicsModel, place: int) -> frozenset[int]:
    """The places of effects that need the one in this place, and have no other that would do."""
    rest = {EFFECTS.name_of(type(e)) for j, e in enumerate(model.effects) if j != place} | set(model.provides)
    return frozenset(j for j, e in enumerate(model.effects) if j != place and not e.met_by(rest))
