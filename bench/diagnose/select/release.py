"""Stated constants that the recordings contradict: let go, so that no other number has to bend for them.

Constants are held by what is stated of them. Where an equation wants one of its own constants far from there (torques
that follow their commands five times less than stated, say), every constant that two equations share gives way in its
place, and what is right in the other equation is lost. Such a constant is known no more, and that is said.
"""

import math
from collections.abc import Sequence

import numpy as np

from bench.diagnose.by_equation import ObscuredConstant
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.least_squares import equilibrium
from bench.diagnose.regression.parameters import Entry
from bench.diagnose.select.search import View
from bench.diagnose.select.subset import Fit
from bench.diagnose.settings import CALIBRATING, LINEARISING, RELEASING


def contradicted(view: View, fit: Fit) -> str | None:
    """The roughly known constant whose letting go gains most, if that is more than its wider prior costs (Occam).

    Args:
        view: a linearised model.
        fit: of the effects that explain it best.
    """
    spread = {i: e.scale / abs(e.stated) for i, e in enumerate(view.linear.own) if e.constant}
    held = {i: e.name for i, e in enumerate(view.linear.own) if e.constant and not e.hardly_known}
    rough = {name for i, name in held.items() if spread[i] > LINEARISING.wide * (1 + 1e-9)}
    loose = [i for i in range(len(view.linear.own)) if i not in held]
    best, most = None, 0.0
    for name in sorted(rough):
        places = [i for i in spread if view.linear.own[i].name == name]
        if _holds_scale(view, places, loose):
            continue
        free = view.subsets.freed(places, CALIBRATING.free).fit(fit.starts, drop=fit.dropped)
        gained = fit.loss - free.loss - sum(2 * math.log(CALIBRATING.free / spread[i]) for i in places)
        if gained > most:
            best, most = name, gained
    return best


def _holds_scale(view: View, places: Sequence[int], loose: Sequence[int]) -> bool:
    """Whether a common factor of these constants and of the ``loose`` numbers changes nothing, such as that of a mass
    and of all forces on it: recordings tell ratios of them, and the last one that is stated says how large they are.
    """
    among = [*places, *loose]
    gram = view.subsets.normal.total[np.ix_(among, among)]
    factor = equilibrium(np.diag(gram))
    values, vectors = np.linalg.eigh(gram * np.outer(factor, factor))
    flat = vectors[: len(places), values < RELEASING.flat * values[-1]]
    return bool((flat**2).sum() > RELEASING.flat)


def obscured(view: View, fit: Fit, subject: Subject) -> tuple[ObscuredConstant, ...]:
    """The constants that were let go and that a fit takes further than is believed of any.

    An input that cancels what disturbs a system seems to do nothing: then what it acts against looks too large.

    Args:
        view: of the model with its effects.
        fit: its numbers.
        subject: with what is known of the constants, those that were let go included.
    """
    far: dict[str, tuple[float, int]] = {}
    for i, e in _freed(view, subject):
        value = e.value + fit.beta[i]
        if value / e.stated > 0:
            times = float(value / e.stated)
            if abs(math.log(times)) > max(CALIBRATING.free, abs(math.log(far.get(e.name, (1.0, 0))[0]))):
                far[e.name] = times, i
    names = view.linear.model.equation_names()
    return tuple(
        ObscuredConstant(name, times, names.get(group, group), group, subject.finer.get(group, ""))
        for name, (times, i) in far.items()
        for group in [_group(view, i)]
    )


def equations_of_freed(view: View, subject: Subject) -> dict[str, str]:
    """The constants that were let go, each with the equation that it acts in most, such as "torques"."""
    names = view.linear.model.equation_names()
    groups = {e.name: _group(view, i) for i, e in _freed(view, subject)}
    return {name: names.get(group, group) for name, group in groups.items()}


def _freed(view: View, subject: Subject) -> list[tuple[int, Entry]]:
    """Columns of the constants that were let go."""
    free = {name for name, spread in subject.uncertainty.items() if spread == CALIBRATING.free}
    return [(i, e) for i, e in enumerate(view.linear.own) if e.constant and e.name in free]


def _group(view: View, column: int) -> str:
    """The states that the equation moves in which a number acts most."""
    powers: dict[str, float] = {}
    for c, (acting, rows) in zip(view.linear.channels, view.subsets.normal.channels, strict=True):
        group = view.linear.model.measured_channels[c].group
        powers[group] = powers.get(group, 0.0) + float((rows[acting == column] ** 2).sum())
    return max(powers, key=lambda g: powers[g])
