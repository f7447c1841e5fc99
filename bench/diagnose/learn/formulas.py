"""The simplest short formula that is not worse than a spline on recordings not fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from bench.diagnose.learn.candidates import Columns, Pair
from bench.diagnose.learn.held_out import Block, HeldOut
from bench.diagnose.settings import MATTERING, SPLINING, WORDING
from registry.terms.shapes import SHAPES, Shape, Span

_OF_BOTH_SIGNS = ("signed_square", "sign", "sign_linear", "linear_signed_square", "sides", "square_sides")


@dataclass(frozen=True, eq=False)
class Option:
    """A formula with a value of the parameter that bends it."""

    shape: Shape
    bend: float | None
    width: int
    """Number of columns: those of the parameters that it is linear in, and as many slopes with the bend."""


@dataclass(frozen=True, eq=False)
class Formula:
    """A formula fitted to a term."""

    shape: str
    values: tuple[float, ...]
    block: Block
    losses: np.ndarray
    """(folds,) on recordings not fitted."""


def span_of(x: np.ndarray) -> Span:
    """The values that a signal takes."""
    flat = x[np.isfinite(x)]
    return float(flat.min()), float(flat.max())


def options(x: np.ndarray, of_a_place: bool = True) -> list[Option]:
    """Every formula that can be one of a signal, at every bend that is tried.

    Args:
        x: the signal.
        of_a_place: whether it says where a system is: what repeats along the way follows no other signal.
    """
    low, high = span_of(x)
    largest, found = max(abs(low), abs(high)), []
    widths, periods = np.linspace(*WORDING.widths), np.arange(*WORDING.waves)
    bends = {
        "saturation": largest * widths,
        "dead_zone": largest * widths[:-1],
        "above": np.quantile(x, widths),
        "below": np.quantile(x, widths),
        "sine": 2 * np.pi * periods / (high - low),
        "wave": 2 * np.pi * periods / (high - low),
        "exponential": np.array(WORDING.decays) / (high - low),
    }
    for shape in SHAPES.values():
        if shape.positive and low <= 0:
            continue
        if not low < 0 < high and shape.name in _OF_BOTH_SIGNS:
            continue  # of one sign: they are others of the list
        if not of_a_place and shape.name in ("sine", "wave"):
            continue
        tried = [None] if shape.bent is None else [float(b) for b in bends[shape.name]]
        width = shape.linear * (1 if shape.bent is None else 2)
        found += [Option(shape, b, width) for b in tried]
    return found


def waves_of(x: np.ndarray) -> tuple[Option, ...]:
    """Waves of a signal, of every length that is tried."""
    return tuple(o for o in options(x) if o.shape.name == "wave")


def _one_sided(shape: str, values: tuple[float, ...], x: np.ndarray) -> bool:
    """Whether a signal meets one edge of a dead zone at most: that is what goes on above an edge, or below one."""
    if shape != "dead_zone":
        return False
    low, high = (float(np.quantile(x, q)) for q in (SPLINING.outer, 1 - SPLINING.outer))
    return not low < -abs(values[-1]) <= abs(values[-1]) < high


def option_columns(pair: Pair, some: Sequence[Option], signals: Sequence[dict[str, np.ndarray]]) -> Columns:
    """The columns of formulas of a pair, one option after the other."""
    span, values = span_of(signals[0][pair.signals[0]]), []
    for paths in signals:
        x = torch.from_numpy(paths[pair.signals[0]])
        found = np.concatenate([_functions(option, x, span) for option in some])
        values.append(found * paths[pair.signals[1]] if len(pair.signals) > 1 else found)
    return Columns(pair, tuple(values))


def _functions(option: Option, x: torch.Tensor, span: Span) -> np.ndarray:
    """What each parameter of a formula multiplies (width, …), then how that changes with the bend."""
    shape, out = option.shape, []

    def at(unit: int, bend: float | None) -> np.ndarray:
        p = [torch.tensor(float(i == unit), dtype=x.dtype) for i in range(shape.linear)]
        if bend is not None:
            p.append(torch.tensor(bend, dtype=x.dtype))
        return np.asarray(shape.formula(p, x, span).numpy())

    for unit in range(shape.linear):
        out.append(at(unit, option.bend))
    if option.bend is not None:
        step = WORDING.nudge * (abs(option.bend) or 1.0)
        for unit in range(shape.linear):
            out.append((at(unit, option.bend + step) - at(unit, option.bend - step)) / (2 * step))
    return np.stack(out)


def fitted(
    fits: HeldOut, some: Sequence[Option], places: np.ndarray, beside: Sequence[Block], x: np.ndarray
) -> dict[str, Formula]:
    """Every shape at its best bend, by name.

    Args:
        fits: of all columns.
        some: the formulas.
        places: of their columns.
        beside: the other terms.
        x: what the formulas follow.
    """
    best: dict[str, Formula] = {}
    for option, block in zip(some, blocks_of(some, places), strict=True):
        losses = fits.losses([*beside, block])
        name = option.shape.name
        if name not in best or losses.sum() < best[name].losses.sum():
            values = _values(option, fits.fit([*beside, block])[-1])
            if _one_sided(name, values, x):
                continue
            best[name] = Formula(name, values, block, losses)
    return best


def blocks_of(some: Sequence[Option], places: np.ndarray) -> list[Block]:
    """The columns of each formula, of those of ``some`` in ``places``."""
    ends = np.cumsum([o.width for o in some])
    return [Block(places[end - option.width : end]) for option, end in zip(some, ends, strict=True)]


def block_of(shape: str, some: Sequence[Option], places: np.ndarray) -> Block:
    """The columns of the first formula of a shape, of those of ``some`` in ``places``."""
    return next(
        block for option, block in zip(some, blocks_of(some, places), strict=True) if option.shape.name == shape
    )


def refined(best: Mapping[str, Formula]) -> list[Option]:
    """Every shape at the bend that its fit says: a Gauss–Newton step from the one that was tried."""
    out = []
    for name, formula in best.items():
        shape = SHAPES[name]
        bend = None if shape.bent is None else formula.values[-1]
        out.append(Option(shape, bend, shape.linear * (1 if shape.bent is None else 2)))
    return out


def simplest(best: Mapping[str, Formula], spline: np.ndarray, without: np.ndarray) -> Formula | None:
    """The shortest formula that is not worse than the best of all shapes; None: the spline is better than any.

    Args:
        best: every shape, as `fitted`.
        spline: losses (folds,) of the spline.
        without: losses (folds,) without the term.
    """
    levels = [spline, *(f.losses for f in best.values())]
    least = min(levels, key=lambda x: float(x.sum()))
    saved = float((without - least).sum())

    def worse(losses: np.ndarray) -> bool:
        lost = float((losses - least).sum())
        # Where more noise of the inputs was taken off than there is, less than nothing is left: no share of that.
        left = float(least.sum()) if least.sum() > 0 else np.inf
        allowed = min(WORDING.worse * saved, (MATTERING.near**2 - 1) * left)
        # Recordings differ in how far they go; by which factor a shape is worse is alike in all.
        factor = np.log(np.maximum(losses, 1e-300) / np.maximum(least, 1e-300))
        spread = float(factor.std(ddof=1)) / len(factor) ** 0.5 if len(factor) > 1 else 0.0
        surely = float(factor.mean()) > WORDING.surely * spread
        return lost > allowed and (surely or lost > 5 * allowed)

    good = [f for f in best.values() if not worse(f.losses)]
    return min(good, key=lambda f: (SHAPES[f.shape].length, float(f.losses.sum())), default=None)


def _values(option: Option, beta: np.ndarray) -> tuple[float, ...]:
    """The parameters that coefficients of the columns say: the bend moves by what its slopes ask for."""
    linear = beta[: option.shape.linear]
    if option.bend is None:
        return tuple(map(float, linear))
    slopes = beta[option.shape.linear :]
    size = float(linear @ linear)
    step = float(linear @ slopes) / size if size > 0 else 0.0
    far = 0.3 * abs(option.bend)
    return (*map(float, linear), option.bend + float(np.clip(step, -far, far)))
