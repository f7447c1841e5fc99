"""The hidden modes that a model leaves, each along all axes that show it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from bench.diagnose.compare import finite, free_runs
from bench.diagnose.learn.axis_series import AxisSeries, axis_series
from bench.diagnose.learn.candidates import pairs
from bench.diagnose.learn.learn import refitted
from bench.diagnose.learn.modes.search import Mode, sought
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.search import Search
from bench.diagnose.settings import HIDING
from bench.diagnose.simulate.free_run import errors, free_run, measured_windows
from bench.diagnose.simulate.unmeasured import hidden
from bench.execution.parallel import side_by_side
from registry.dynamics import PhysicsModel
from registry.dynamics.model import RATE_OF
from registry.effects.waves.hidden_mode import MOST_AXES, HiddenMode
from registry.terms import signals as known


def modes(subject: Subject, model: PhysicsModel, noise: Noise) -> tuple[HiddenMode, ...]:
    """What swings or relaxes in what ``model`` leaves and is driven by a measured signal, the surest first.

    They are sought in windows of several lengths, and free runs choose: what is left is told by the moment before where
    a log has many samples in each time constant, or was filtered, and a slow mode shows over longer times only.

    Args:
        subject: measurements; nothing is sought where some state was not measured.
        model: with the effects it has, its constants calibrated.
        noise: of the measurements.
    """
    if hidden(subject.logs):
        return ()
    found: list[HiddenMode] = []
    runs, windows = None, HIDING.windows
    while len(found) < HIDING.most:
        now = replace(model, effects=(*model.effects, *found))
        series = axis_series(subject, now, noise)
        candidates = _candidates(subject, now, series, windows)
        if not candidates:
            break
        near = candidates
        if len(candidates) > 1:
            runs = runs or _Runs(subject, noise)
            missed = side_by_side(runs.error, [replace(now, effects=(*now.effects, mode)) for mode, _ in candidates])
            near = [c for c, e in zip(candidates, missed, strict=True) if e <= min(missed) + HIDING.equal]
        # What a rate drives is an inertia, which is easier to say than the same driven by a pose.
        mode, count = next(((m, n) for m, n in near if _rate(m.drivers[0])), near[0])
        found.append(mode)
        windows = (count,)
    return tuple(found)


def _rate(driver: str) -> bool:
    return driver.partition(".")[0] in (*RATE_OF.values(), "body_velocity")


class _Runs:
    """Free runs of the training recordings."""

    def __init__(self, subject: Subject, noise: Noise) -> None:
        self.search = Search(subject, (), lambda what: None, noise)
        self.runs = free_runs(subject, noise, subject.training)
        self.measured = measured_windows(self.runs.logs, self.runs.at, self.runs.steps)

    def error(self, model: PhysicsModel) -> float:
        """Mean logarithm over groups of the squared error, after all numbers were fitted in the weak form."""
        with torch.no_grad():
            found = free_run(refitted(self.search, model), self.runs.logs, self.runs.at, self.runs.steps)
            squared = finite(errors(found, self.measured, self.runs.groups)).mean((0, 1))
        return float(np.log(np.maximum(squared, 1e-300)).mean())


def drivers_of(model: PhysicsModel, axis: str) -> list[str]:
    """The signals that can drive a mode along an axis: of a vehicle its own velocity, else all."""
    if not known.flies(type(model)):
        return [p.signals[0] for p in pairs(model) if p.axis == axis and p.signals[0] not in model.extras]
    along = axis[-1]
    if axis in known.TORQUES:
        return [f"body_rates.{'pqr'['xyz'.index(along)]}"]
    return [f"velocity.{along}" if axis in known.WORLD_FORCES else f"body_velocity.{along}"]


def _candidates(
    subject: Subject, model: PhysicsModel, series: Sequence[AxisSeries], windows: Sequence[int]
) -> list[tuple[HiddenMode, int]]:
    """Modes that recordings confirm in windows of so many samples, and these.

    Of each length the modes of the axis that shows one most surely; the same one along others joined.
    """
    places = {name: i for i, name in enumerate(known.available(model))}
    inputs = known.input_names(type(model), *known.drive_of(model))
    tries = len(series) * len(HIDING.windows)

    def along(task: tuple[int, AxisSeries]) -> list[Mode]:
        count, one = task
        drivers = {name: places[name] for name in drivers_of(model, one.axis)}
        return sought(one.coarser(count), drivers, subject.training, tries, inputs)

    tasks = [(count, one) for count in windows for one in series]
    told, out = side_by_side(along, tasks), list[tuple[HiddenMode, int]]()
    for count in windows:
        found = [mode for (of, _), modes in zip(tasks, told, strict=True) if of == count for mode in modes]
        found.sort(key=lambda m: -m.evidence)
        out += [(_joined([mode, *found]), count) for mode in found if mode.axis == found[0].axis]
    return out


def _joined(found: Sequence[Mode]) -> HiddenMode:
    """The surest mode, and the same one along other axes of its kind."""
    first = found[0]
    kind = first.axis[:-1]
    same = [first]
    for mode in found[1:]:
        if mode.axis in (m.axis for m in same):
            continue
        near = abs(np.log(mode.pole.frequency / first.pole.frequency)) < HIDING.alike
        if mode.axis[:-1] == kind and near and mode.pole.order == first.pole.order and len(same) < MOST_AXES:
            same.append(mode)
    weights = np.array([m.evidence for m in same])
    frequency, damping = (
        float(np.average([getattr(m.pole, of) for m in same], weights=weights)) for of in ("frequency", "damping")
    )
    same.sort(key=lambda m: m.axis)
    return HiddenMode(
        tuple(m.axis for m in same),
        tuple(m.driver for m in same),
        first.pole.order,
        frequency,
        damping,
        tuple(g for m in same for g in m.gains),
    )
