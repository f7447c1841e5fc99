"""What a learned term could be: every axis with every signal that it may follow, as columns of the weak form."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch

from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.regression.generic import Dictionary, Term
from bench.diagnose.select.search import Look, Search, View
from registry.dynamics import PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.terms import signals as known

OF_PLACE = ("position.x", "position.y", "height", "velocity.x", "velocity.y", "velocity.z", "time")
"""Signals that a force along an axis of the world may follow: those of the world."""
OF_BODY_ONLY = ("velocity.x", "velocity.y", "velocity.z")
"""Signals of the world that nothing along an axis of the body follows."""

PRODUCT = 3
"""`Pair.length` of a function of one signal times another one."""


@dataclass(frozen=True)
class Pair:
    """An axis and the signals that a term along it follows."""

    axis: str
    signals: tuple[str, ...]

    @property
    def length(self) -> int:
        """What its signals cost a reader: one, the sum or difference of two, a function of one times another."""
        return PRODUCT if len(self.signals) > 1 else 1 + any(c in self.signals[0] for c in "+-")

    @property
    def equation(self) -> str:
        """What its gains are compared in: all forces, all torques, or the rate of one state."""
        return "force" if "force_" in self.axis else "torque" if self.axis in known.TORQUES else self.axis


@dataclass(frozen=True, eq=False)
class Columns:
    """Functions of signals along one axis."""

    pair: Pair
    values: tuple[np.ndarray, ...]
    """(functions, L, N − 1): as measured and, where inputs are noisy, with more noise."""


def dynamic_axes(model: PhysicsModel) -> list[str]:
    """The axes along which physics can be missing: no pose that only sums up its rate."""
    axes = list(known.axes_of(type(model)))
    if known.flies(type(model)):
        return axes
    named = model.equation_names()
    return [c.name for c in model.state_channels if c.group in named] + _coupled_drives(model)


def _coupled_drives(model: PhysicsModel) -> list[str]:
    """The inputs that move several states at once: along those that move one, a term is one of that state's rate."""
    drives, states = (
        known.drives_of(type(model)),
        torch.tensor([c.group in model.equation_names() for c in model.state_channels]),
    )
    if len(drives) != model.driving_channels:
        return []
    with torch.no_grad():
        x = torch.linspace(0.1, 1.0, len(states), dtype=torch.float64)
        still = torch.zeros(len(drives) + len(model.extras), dtype=torch.float64)
        moved = [known.rate_along(d, torch.ones((), dtype=torch.float64), model, x, still) for d in drives]
    return [d for d, rates in zip(drives, moved, strict=True) if int((rates[states] != 0).sum()) > 1]


def equation_of(model: PhysicsModel, axis: str) -> str:
    """The name of the equation that a term along an axis is in."""
    group = "velocity" if "force_" in axis else "body_rates" if axis in known.TORQUES else axis.rpartition(".")[0]
    return str(model.equation_names().get(group or axis, ""))


def pairs(model: PhysicsModel) -> list[Pair]:
    """Every axis with every signal that it may follow."""
    units = known.available(model)
    inputs = known.input_names(type(model), *known.drive_of(model))
    if not known.flies(type(model)):
        return [Pair(axis, (name,)) for axis in dynamic_axes(model) for name in units]
    if hasattr(model, "rotor_positions"):
        units = {n: u for n, u in units.items() if n not in inputs}  # their sum is the thrust; the rest is in torques
    of_world = [n for n in units if n in OF_PLACE]
    of_body = [n for n in units if n not in OF_BODY_ONLY]
    return [
        Pair(axis, (name,))
        for axis in dynamic_axes(model)
        for name in (of_world if axis.startswith("world") else of_body)
    ]


def products(offered: Sequence[Pair], around: Sequence[Pair] | None = None) -> list[Pair]:
    """A function of one signal times another one, along the same axis.

    Args:
        offered: what follows one signal alone.
        around: only products with one of these signals along its axis; None: all.
    """
    out = []
    offered = [p for p in offered if p.length == 1]
    for axis in dict.fromkeys(p.axis for p in offered):
        names = [p.signals[0] for p in offered if p.axis == axis]
        near = names if around is None else [p.signals[0] for p in around if p.axis == axis]
        out += [
            Pair(axis, (first, second))
            for first in names
            for second in names
            if first != second and (first in near or second in near)
        ]
    return out


def crosses(offered: Sequence[Pair]) -> list[Pair]:
    """Every two signals of those offered along an axis, once."""
    by: dict[str, list[str]] = {}
    for p in offered:
        if p.length == 1:
            by.setdefault(p.axis, []).append(p.signals[0])
    return [Pair(axis, two) for axis, names in by.items() for two in combinations(names, 2)]


def with_axes(model: PhysicsModel) -> PhysicsModel:
    """The model with a constant of zero along every axis: linearised, they are the directions of all terms."""
    constants = tuple(LearnedTerm(axis, (), "constant", (0.0,)) for axis in dynamic_axes(model))
    return replace(model, effects=(*model.effects, *constants))


def paths(model: PhysicsModel, stack: LogBatch) -> dict[str, np.ndarray]:
    """Every signal (L, N − 1) that a term can follow, at the middle of each sampling interval."""
    state = model.project(stack.between)
    before, after = stack.inputs[:, :-1], stack.inputs[:, 1:]
    inputs = before if model.input_hold == "previous" else (before + after) / 2
    with torch.no_grad():
        if known.flies(type(model)):
            motion = model.unloaded(state, inputs)[0]  # type: ignore[attr-defined]
            found = {n: known.of_motion(n, motion) for n in known.available(model)}
        else:
            found = {n: known.of_state(n, model, state, inputs) for n in known.available(model)}
    return {n: x.numpy() for n, x in found.items()}


def view_of(search: Search, look: Look, base: int, columns: Sequence[Columns]) -> tuple[View, list[np.ndarray]]:
    """Whitened normal equations with the columns of all pairs, and the places of each pair's.

    Args:
        search: of the subject.
        look: at the model `with_axes`.
        base: number of effects of the model without those.
        columns: what is to be fitted.
    """
    linear, moved = look.linear, look.moved
    order = dynamic_axes(linear.model)
    axis_column = {order[e.owner - base]: j for j, e in enumerate(linear.own) if e.owner >= base}
    columns = [c for c in columns if c.pair.axis in axis_column]
    present = [axis for axis in order if axis in axis_column and any(c.pair.axis == axis for c in columns)]
    sorted_columns = [c for axis in present for c in columns if c.pair.axis == axis]
    counts = [len(c.values[0]) for c in sorted_columns]
    ends = np.cumsum(counts)
    once = {id(c.values[0]): c for c in sorted_columns}  # what acts along several axes is the same functions
    begins = dict(zip(once, np.cumsum([0, *(len(c.values[0]) for c in once.values())]), strict=False))
    by_axis = {
        axis: np.concatenate(
            [
                begins[id(c.values[0])] + np.arange(n)
                for c, n in zip(sorted_columns, counts, strict=True)
                if c.pair.axis == axis
            ]
        )
        for axis in present
    }
    inputs = known.input_names(type(linear.model), *known.drive_of(linear.model))
    touched = {"thrust", *inputs}
    terms = tuple(
        Term("input" if touched & set(c.pair.signals) else ",".join(c.pair.signals), str(i), c.pair.axis)
        for c, n in zip(sorted_columns, counts, strict=True)
        for i in range(n)
    )

    def dictionary(number: int, of: Sequence[np.ndarray]) -> Dictionary:
        functions = np.concatenate([c.values[min(number, len(c.values) - 1)] for c in once.values()])
        axes = np.stack([of[axis_column[axis]] for axis in present])
        return Dictionary(
            terms, functions, axes, tuple(by_axis[axis] for axis in present), tuple(present), np.ones(len(functions))
        )

    words = dictionary(0, linear.columns)
    noisy = None if moved is None else dictionary(1, moved.columns)
    view = search.views(Look(linear, moved, words, noisy))[0]
    first = len(linear.columns)
    places = {id(c): first + np.arange(end - n, end) for c, n, end in zip(sorted_columns, counts, ends, strict=True)}
    return view, [places.get(id(c), np.zeros(0, dtype=int)) for c in columns]


UPRIGHT = ("force_z", "world_force_z")
"""Axes along which a constant is thrust or weight; both together lean as the vehicle does against a gust."""


def own_columns(view: View, base: int, upright: bool = False) -> list[int]:
    """Places of the numbers of the model itself; of the constants along the axes only, if asked, those `UPRIGHT`."""
    effects = view.linear.model.effects
    kept = [i for i, e in enumerate(effects) if i < base or (upright and e.axis in UPRIGHT)]  # type: ignore[attr-defined]
    return [j for j, e in enumerate(view.linear.own) if e.owner < 0 or e.owner in kept]
