"""Stated constants that the recordings contradict: let go, so that no other number has to bend for them.

Constants are held by what is stated of them. Where an equation wants one of its own constants far from there (torques
that follow their commands five times less than stated, say), every constant that two equations share gives way in its
place, and what is right in the other equation is lost. Such a constant is known no more, and that is said.
"""

import math

from bench.diagnose.by_equation import ObscuredConstant
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.search import View
from bench.diagnose.select.subset import Fit
from bench.diagnose.settings import CALIBRATING, LINEARISING


def contradicted(view: View, fit: Fit) -> str | None:
    """The roughly known constant whose letting go gains most, if that is more than its wider prior costs (Occam).

    Args:
        view: a linearised model.
        fit: of the effects that explain it best.
    """
    spread = {i: e.scale / abs(e.stated) for i, e in enumerate(view.linear.own) if e.constant}
    rough = {view.linear.own[i].name for i, s in spread.items() if LINEARISING.wide * (1 + 1e-9) < s < CALIBRATING.free}
    best, most = None, 0.0
    for name in sorted(rough):
        places = [i for i in spread if view.linear.own[i].name == name]
        free = view.subsets.freed(places, CALIBRATING.free).fit(fit.starts, drop=fit.dropped)
        gained = fit.loss - free.loss - sum(2 * math.log(CALIBRATING.free / spread[i]) for i in places)
        if gained > most:
            best, most = name, gained
    return best


def obscured(view: View, fit: Fit, subject: Subject) -> tuple[ObscuredConstant, ...]:
    """The constants that were let go and that a fit takes further than is believed of any.

    An input that cancels what disturbs a system seems to do nothing: then what it acts against looks too large.

    Args:
        view: of the model with its effects.
        fit: its numbers.
        subject: with what is known of the constants, those that were let go included.
    """
    far: dict[str, tuple[float, int]] = {}
    for i, e in enumerate(view.linear.own):
        value = e.value + fit.beta[i]
        if e.constant and subject.uncertainty.get(e.name) == CALIBRATING.free and value / e.stated > 0:
            times = float(value / e.stated)
            if abs(math.log(times)) > max(CALIBRATING.free, abs(math.log(far.get(e.name, (1.0, 0))[0]))):
                far[e.name] = times, i
    return tuple(_obscured(view, subject, name, times, column) for name, (times, column) in far.items())


def _obscured(view: View, subject: Subject, name: str, times: float, column: int) -> ObscuredConstant:
    model, powers = view.linear.model, dict[str, float]()
    for c, (acting, rows) in zip(view.linear.channels, view.subsets.normal.channels, strict=True):
        group = model.measured_channels[c].group
        powers[group] = powers.get(group, 0.0) + float((rows[acting == column] ** 2).sum())
    group = max(powers, key=lambda g: powers[g])
    equation = model.equation_names().get(group, group)
    return ObscuredConstant(name, times, equation, group, subject.finer.get(group, ""))
