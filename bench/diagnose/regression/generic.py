"""A dictionary of signals that a missing term could follow, for what no effect of the catalogue explains."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Protocol, runtime_checkable

import numpy as np

from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.regression.least_squares import equilibrium, ridge, shifted
from bench.diagnose.settings import FOLLOWING
from registry.dynamics import Description, PhysicsModel, Signals


@dataclass(frozen=True)
class Term:
    """One function of measured signals, acting along one axis."""

    signal: str
    """What it follows, such as "position"."""
    text: str
    """The function, such as "v_x |v|"."""
    axis: str
    """Where it acts, such as "force x"."""


@dataclass(frozen=True, eq=False)
class Dictionary:
    """Functions of signals, each along every axis that has dynamics: a term is a pair."""

    terms: tuple[Term, ...]
    """Axis by axis."""
    values: np.ndarray
    """(functions, L, N − 1), of unit spread in the recordings that `scale` is of."""
    axes: np.ndarray
    """(axes, L, N − 1, channels): the rates that a unit along each axis adds."""
    members: tuple[np.ndarray, ...]
    """An axis: the functions that may act along it."""
    names: tuple[str, ...]
    """Of the axes, such as "force x"."""
    scale: np.ndarray
    """(functions,) what each was divided by; infinite: it does not vary."""

    @property
    def reach(self) -> tuple[frozenset[int], ...]:
        """A term: the channels that it acts on."""
        channels = self.on_channels(self.axes.shape[-1])
        out: list[set[int]] = [set() for _ in self.terms]
        for c, blocks in enumerate(channels):
            for block in blocks:
                for place in block.places:
                    out[place].add(c)
        return tuple(map(frozenset, out))

    def following(self, signals: Sequence[str]) -> "Dictionary":
        """Its terms that follow one of these signals."""
        terms, members, at = list[Term](), list[np.ndarray](), 0
        for some in self.members:
            own = self.terms[at : at + len(some)]
            kept = [i for i, term in enumerate(own) if term.signal in signals]
            terms += [own[i] for i in kept]
            members.append(some[kept])
            at += len(some)
        used = np.unique(np.concatenate(members))
        fewer: tuple[np.ndarray, ...] = tuple(np.searchsorted(used, some) for some in members)
        return Dictionary(tuple(terms), self.values[used], self.axes, fewer, self.names, self.scale[used])

    def on_channels(self, channels: int) -> list[list["Block"]]:
        """A channel: the terms that act on it, axis by axis."""
        last = np.cumsum([len(some) for some in self.members])
        blocks = [
            (axis, np.arange(end - len(some), end), some)
            for axis, (some, end) in enumerate(zip(self.members, last, strict=True))
        ]
        acts = np.abs(self.axes).max((1, 2)) > 0
        return [[Block(i, c, places, some) for i, places, some in blocks if acts[i, c]] for c in range(channels)]

    def of_log(self, log: int) -> np.ndarray:
        """Every function (N − 1, functions) of one log."""
        return np.ascontiguousarray(self.values[:, log].T)

    def along(self, block: "Block", log: int, values: np.ndarray) -> np.ndarray:
        """Rates (N − 1, terms) that the terms of a block add to its channel, of the functions `of_log`."""
        all_of_them = np.array_equal(block.members, np.arange(values.shape[1]))
        some = values if all_of_them else values[:, block.members]
        out: np.ndarray = some * self.axes[block.axis, log, :, block.channel, None]
        return out


@dataclass(frozen=True, eq=False)
class Block:
    """The terms along one axis, as they act on one channel."""

    axis: int
    channel: int
    places: np.ndarray
    """(terms,) among all terms."""
    members: np.ndarray
    """(terms,) the function that each is."""


def dictionary(
    model: PhysicsModel, stack: LogBatch, channels: tuple[int, ...], like: Dictionary | None = None
) -> Dictionary:
    """Low-order functions of every measured signal, and products of two, along every axis that has dynamics.

    Args:
        model: tells the states, the inputs and the axes.
        stack: the recordings.
        channels: state channels that are looked at.
        like: the same of other recordings, whose units the functions have, so that what was fitted there holds here;
            default: units of their own.
    """
    state = model.project(stack.between)
    inputs = ((stack.inputs[:, :-1] + stack.inputs[:, 1:]) / 2).numpy()
    slopes = ((stack.inputs[:, 1:] - stack.inputs[:, :-1]) / stack.dt).numpy()
    drives, described = inputs.shape[-1] - len(model.extras), model.description()
    base, u, du = described.signals(state), inputs[..., :drives], slopes[..., :drives]
    mixing = described.mixing(drives)
    if mixing is not None:
        u, du = u @ mixing / stack.inputs.numpy()[..., :drives].mean(), du @ mixing
    if drives:
        base["input"] = {f"u{i}": u[..., i] for i in range(drives)}
    found = _functions(base, described)
    if drives:
        found["input_rate"] = {f"du{i}/dt": du[..., i] for i in range(drives)}
    for i, name in enumerate(model.extras):
        found[name] = {name: inputs[..., drives + i]}
    found["constant"] = {"1": np.ones(state.shape[:-1])}
    names = [(signal, text) for signal, functions in found.items() for text in functions]
    values = np.stack([v for functions in found.values() for v in functions.values()])
    spread = np.array([1.0 if signal == "constant" else v.std() for (signal, _), v in zip(names, values, strict=True)])
    scale = np.where(spread > 1e-12, spread, np.inf) if like is None else like.scale
    axes = described.axes(state, channels)
    members: tuple[np.ndarray, ...] = tuple(
        np.array([i for i, (signal, _) in enumerate(names) if not axis.follows or signal in axis.follows], dtype=int)
        for axis in axes
    )
    return Dictionary(
        tuple(Term(*names[int(i)], axis.name) for axis, some in zip(axes, members, strict=True) for i in some),
        values / scale[:, None, None],
        np.stack([axis.rates for axis in axes]),
        members,
        tuple(axis.name for axis in axes),
        scale,
    )


def _functions(base: Signals, described: Description) -> Signals:
    """Squares of the signals, curves and laws of some, and products of two."""
    found = {signal: functions | {f"{k}²": v * v for k, v in functions.items()} for signal, functions in base.items()}
    for signal in described.curved(base):
        for k, v in base[signal].items():
            size = np.abs(v).max() or 1.0
            found[signal] |= {f"{k}³": v**3, f"|{k}| {k}": np.abs(v) * v}
            for n in (1, 2, 3):
                found[signal] |= {f"sin {n} {k}": np.sin(n * v), f"cos {n} {k}": np.cos(n * v)}
            found[signal] |= {f"sign {k}": np.tanh(v / size / 0.02)}
    for signal, functions in described.laws(base).items():
        found[signal] |= functions
    for (first, some), (second, others) in combinations_with_replacement(base.items(), 2):
        of = found.setdefault(first if first == second else f"{first} × {second}", {})
        of |= {f"{a} {b}": x * y for a, x in some.items() for b, y in others.items() if first != second or a < b}
    return found


@runtime_checkable
class Table(Protocol):
    """Products of columns, fold by fold; see `bench.diagnose.regression.rows.Crossings`."""

    @property
    def squares(self) -> np.ndarray:
        """(c + 1,) of every column, all folds together."""

    def of(self, columns: Sequence[int]) -> np.ndarray:
        """(folds, k, c + 1) products of k columns with all; −1 is the residual."""


class Whole:
    """Products that were all made: a fold (c + 1, c + 1)."""

    def __init__(self, grams: Sequence[np.ndarray]) -> None:
        self._grams = grams

    @cached_property
    def squares(self) -> np.ndarray:
        """See `Table`."""
        return np.asarray(sum(np.diag(gram) for gram in self._grams))

    def of(self, columns: Sequence[int]) -> np.ndarray:
        """See `Table`."""
        return np.stack([gram[list(columns)] for gram in self._grams])


@dataclass(frozen=True, eq=False)
class Folds:
    """Normal equations of the rows of every fold, as they are fitted; of hundreds of columns none is copied."""

    table: "Table"
    """Products of columns with all of them."""
    kept: Sequence[int]
    """Columns (k,) that are always fitted."""
    tails: Sequence[np.ndarray]
    """A fold: products (c + 1,) of all columns with the residual, which may be another one than in `table`."""
    held: np.ndarray | float = 0.0
    """(k, k) what is added to the products of the kept columns in each."""

    @classmethod
    def of(
        cls, products: "Table | Sequence[np.ndarray]", kept: Sequence[int], shift: np.ndarray | None = None
    ) -> "Folds":
        """As they are, but for ``shift`` (c + 1,) times the columns, which is added to the residual.

        Args:
            products: of columns; or of all of them, a fold (c + 1, c + 1).
            kept: columns that are always fitted.
            shift: see above; default: nothing.
        """
        table = products if isinstance(products, Table) else Whole(products)
        if shift is None:
            return cls(table, kept, list(table.of([-1])[:, 0]))
        moved = np.flatnonzero(shift)
        return cls(table, kept, [shifted(some, shift, moved) for some in table.of([*moved, -1])])

    def products(self, more: Sequence[int] = ()) -> list[np.ndarray]:
        """A fold: (n, n) of the kept columns, some more and the residual."""
        index = [*self.kept, *more, -1]
        out = [rows[:, index] for rows in self.table.of(index)]
        for block, tail in zip(out, self.tails, strict=True):
            block[: len(self.kept), : len(self.kept)] += self.held
            block[-1] = block[:, -1] = tail[index]
        return out


def follow(folds: Folds, first: int, most: int = 8, allowed: Sequence[int] | None = None) -> list[tuple[int, float]]:
    """What a residual follows: dictionary columns, most telling first, each with the held-out loss that it saves.

    Orthogonal matching pursuit, judged fold by fold by a fit to the others; of columns that gain alike, the first.

    Args:
        folds: of whitened rows, with dictionary columns from ``first`` on.
        first: the first dictionary column.
        most: terms at most.
        allowed: columns to choose from; default: all of the dictionary.
    """
    always = list(folds.kept)
    squares, tail = folds.table.squares, np.asarray(sum(folds.tails))
    chosen, found = always.copy(), []
    last = _held_out(folds, [])
    for _ in range(most):
        cross = folds.table.of(chosen).sum(0)
        cross[: len(always), always] += len(folds.tails) * np.asarray(folds.held)
        inner = cross[:, chosen]
        scale = equilibrium(np.diag(inner))
        inverse = np.linalg.inv(inner * np.outer(scale, scale) + 1e-9 * np.eye(len(chosen))) * np.outer(scale, scale)
        left = tail - tail[chosen] @ inverse @ cross  # what each column shares with the residual that is left
        power = squares - np.einsum("ij,ik,kj->j", cross, inverse, cross, optimize=True)
        free = power > 1e-6 * np.abs(squares)  # noise that was taken off may leave less than nothing
        gain = np.where(free, left**2 / np.where(free, power, 1.0), 0.0)
        gain[:first] = gain[-1] = 0.0
        if allowed is not None:
            gain = np.where(np.isin(np.arange(len(gain)), allowed), gain, 0.0)
        if not gain.max() > 0:
            break  # nothing is left that a column could take
        best = int(np.argmax(gain >= (1 - FOLLOWING.alike) * gain.max()))
        chosen.append(best)
        now = _held_out(folds, chosen[len(always) :])
        if now >= last:
            break
        found.append((best, last - now))
        last = now
    return found


def _held_out(folds: Folds, more: Sequence[int]) -> float:
    """Squares of the residual that the kept columns and some more leave, each fold's by a fit to the others."""
    blocks = folds.products(more)
    total = np.asarray(sum(blocks))
    vectors = (np.append(-ridge(total - block, 1e-9), 1.0) for block in blocks)
    return sum(float(v @ block @ v) for v, block in zip(vectors, blocks, strict=True))
