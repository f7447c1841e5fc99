"""Step 1: models against measurements, as free runs from many measured states, beside the noise floor."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from bench.analysis.display import Displayed
from bench.analysis.stats import MIN_RECORDINGS
from bench.diagnose.evidence import LINES as DRAWN
from bench.diagnose.evidence import Curves, Line, plot_curves
from bench.diagnose.logs.load import subject_of
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.sample import typical_length
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.result import ByGroup, GroupError
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import COMPARING
from bench.diagnose.simulate.disturbance import Observer
from bench.diagnose.simulate.floor import floor
from bench.diagnose.simulate.free_run import (
    Group,
    clear_starts,
    default_steps,
    errors,
    followed,
    free_run,
    groups,
    margin,
    measured_windows,
)
from bench.diagnose.simulate.unmeasured import hidden
from registry.contracts import Dataset
from registry.dynamics import PhysicsModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIVERGED = 1e12
"""Squared error over the floor's beyond which a free run is lost, by how much does not matter."""


@dataclass(frozen=True, eq=False)
class Comparison(Displayed):
    """Root mean square errors of free runs, by model, output group, horizon and recording; SI."""

    recordings: tuple[str, ...]
    horizon_s: tuple[float, ...]
    groups: tuple[Group, ...]
    lines: dict[str, dict[str, Line]]
    """By model, then by group: "nominal", those given, "floor"; before that "disturbance", the last one helped by a
    disturbance observer, where equations can be judged by themselves."""
    starts: int
    """Free runs a model."""
    every_s: float
    """From one start to the next [s]."""
    basis: str
    """What the intervals rest on."""
    noise: Noise
    """That the floor was made with."""
    lost_s: float | None = None
    """Default horizon, where even a perfect model would be lost at its end: runs are shorter then [s]."""

    @property
    def curves(self) -> dict[str, Curves]:
        """What the page draws, by group."""
        return {
            g.name: Curves(g.unit, self.horizon_s, {n: self.lines[n][g.name] for n in DRAWN if n in self.lines})
            for g in self.groups
        }

    def error(self, model: str) -> ByGroup:
        """Error of a model, or of the "floor", at the last horizon; empty: there is no such line."""
        of = self.lines.get(model, {})
        return {g.name: GroupError(self.horizon_s[-1], of[g.name].rmse[-1], g.unit) for g in self.groups if of}

    def above_floor(self, errors: ByGroup) -> dict[str, float]:
        """By group, squared errors at the last horizon less that of the noise floor."""
        floor = self.error("floor")
        return {g: e.rmse**2 - floor[g].rmse ** 2 for g, e in errors.items()}

    @property
    def headline(self) -> str:
        """How far each model is off at the last horizon."""
        rms = {n: ", ".join(f"{g} {e.rmse:.3g} {e.unit}" for g, e in self.error(n).items()) for n in self.lines}
        return f"Rms error after {self.horizon_s[-1]:.3g} s: " + "; ".join(f"{n}: {said}" for n, said in rms.items())

    def to_frame(self) -> pd.DataFrame:
        """One row a group of outputs, horizon and model.

        Returns:
            group, horizon_s, model, rmse, low, high (95 %, in the unit named, SI), unit.
        """
        return pd.DataFrame(
            [
                (g.name, seconds, model, of[g.name].rmse[k], of[g.name].low[k], of[g.name].high[k], g.unit)
                for g in self.groups
                for k, seconds in enumerate(self.horizon_s)
                for model, of in self.lines.items()
            ],
            columns=["group", "horizon_s", "model", "rmse", "low", "high", "unit"],
        )

    def plot(self) -> "list[Axes]":
        """Error against the horizon with 95 % intervals: matplotlib axes, one a group of outputs."""
        return plot_curves(
            {
                g.name: Curves(g.unit, self.horizon_s, {n: of[g.name] for n, of in self.lines.items()})
                for g in self.groups
            }
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, in sentences."""
        what = f"{self.starts} free runs of {self.horizon_s[-1]:.3g} s a model, one every {self.every_s:.2g} s"
        grows = "the noise of their start grows so fast that even a perfect model is lost"
        lost = [] if self.lost_s is None else [f"Shorter than {self.lost_s:.3g} s, where {grows}."]
        return (f"{what}; intervals: {self.basis}.", *lost, *self.noise.notes)


def refuse_long(subject: Subject, horizon_s: float | None) -> None:
    """Raise before the work where no recording to compare with is as long as free runs are to be.

    Raises:
        BenchError: with the longest that there is.
    """
    if horizon_s is None:
        return
    logs = subject.of(subject.held_out)
    if logs:
        clear_starts(logs, max(1, round(horizon_s * logs[0].rate)), 1)


def compare(
    subject: str | Path | Dataset | Subject,
    models: Mapping[str, PhysicsModel] | None = None,
    names: Sequence[str] | None = None,
    horizon_s: float | None = None,
    noise: Noise | None = None,
) -> Comparison:
    """Run models free from many measured states and compare with what was measured.

    Args:
        subject: measurements, or the folder or name that `load` reads; its own model is the line "nominal" unless
            ``models`` holds one of that name.
        models: by name of their line, the best one last: it is taken for exact where the floor is made. Default: none
            beside the subject's own.
        names: recordings; default: those held out.
        horizon_s: longest horizon [s]; default `free_run.default_steps`.
        noise: default `noise.noise_of`.

    Raises:
        BenchError: no recording is long enough.
    """
    subject = subject_of(subject)
    refuse_long(subject, horizon_s)
    subject, noise = prepared(subject, noise)
    models = {"nominal": subject.model} | dict(models or {})
    runs = free_runs(subject, noise, names, horizon_s)
    with torch.no_grad():
        every_sample = _squared(subject, models, noise, runs)
        told = runs.steps if horizon_s else followed(every_sample["floor"].mean(0), runs.measured, runs.groups)
    lost_s = runs.steps / runs.logs[0].rate if told < runs.steps else None
    runs = replace(runs, steps=told)
    squared = {name: finite(of[:, runs.ends]) for name, of in every_sample.items()}
    repeated = Repetition.of(runs, squared[next(reversed(models))])
    return Comparison(
        recordings=tuple(log.name for log in runs.logs),
        horizon_s=runs.horizon_s,
        groups=runs.groups,
        lines={name: repeated.lines(e, runs) for name, e in squared.items()},
        starts=len(runs.recording),
        every_s=runs.every * runs.logs[0].dt,
        basis=repeated.basis,
        noise=noise,
        lost_s=lost_s,
    )


def above_floor(
    models: Sequence[tuple[Subject, PhysicsModel]],
    noise: Noise,
    names: Sequence[str] | None = None,
    horizon_s: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """What models leave above the noise floor at the end of the same free runs, as a mean of all groups of outputs.

    Args:
        models: each with the prepared measurements that it is run on; their logs differ in when inputs are read.
        noise: of the measurements.
        names: recordings; default: those held out.
        horizon_s: of the free runs [s].

    Returns:
        (models,) and (draws, models): squared error over that of the lowest floor, less one; and draws of its mean.
    """
    runs = [free_runs(subject, noise, names, horizon_s) for subject in _judged_alike([s for s, _ in models])]
    with torch.no_grad():
        ends = [
            (
                errors(free_run(m, r.logs, r.at, r.steps), r.measured, r.groups)[:, -1:],
                floor(m, r.logs, r.at, r.steps, noise, r.groups)[..., -1, :].mean((0, 1)),
            )
            for r, (_, m) in zip(runs, models, strict=True)
        ]
    least = np.fmin.reduce([finite(of) for _, of in ends])
    over = [np.minimum(finite(of) / np.maximum(least, 1e-300), DIVERGED) for of, _ in ends]
    drawn = Repetition.of(runs[0], over[0])
    each = np.concatenate(over, axis=1).mean(-1) - 1  # (W, models)
    return each.mean(0), drawn.means(each)


def _judged_alike(subjects: Sequence[Subject]) -> list[Subject]:
    """The same recordings with inputs read in several ways, each without the samples that any of them leaves out."""
    valid = [torch.stack([log.valid for log in logs]).all(0) for logs in zip(*(s.logs for s in subjects), strict=True)]
    return [
        replace(s, logs=tuple(replace(log, valid=v) for log, v in zip(s.logs, valid, strict=True))) for s in subjects
    ]


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Which free runs models are judged by."""

    logs: tuple[Log, ...]
    at: tuple[np.ndarray, ...]
    """Of each log, the samples that a free run starts from."""
    steps: int
    """Samples of the longest horizon."""
    every: int
    """Samples from one start to the next."""
    groups: tuple[Group, ...]

    @property
    def recording(self) -> np.ndarray:
        """(W,) the log of each free run."""
        return np.repeat(np.arange(len(self.logs)), [len(a) for a in self.at])

    @property
    def measured(self) -> Tensor:
        """What was measured (W, steps + 1, s)."""
        return measured_windows(self.logs, self.at, self.steps)

    @property
    def ends(self) -> np.ndarray:
        """Samples of the horizons of a curve, the longest one last."""
        return np.unique(np.round(np.linspace(0, self.steps, COMPARING.horizons + 1)[1:]).astype(int))

    @property
    def horizon_s(self) -> tuple[float, ...]:
        """The same in seconds."""
        return tuple(float(k / self.logs[0].rate) for k in self.ends)


def free_runs(
    subject: Subject, noise: Noise, names: Sequence[str] | None = None, horizon_s: float | None = None
) -> FreeRuns:
    """The free runs that models of a prepared subject are judged by; arguments are those of `compare`.

    Raises:
        BenchError: no recording is long enough.
    """
    logs = subject.of(subject.held_out if names is None else names)
    steps = default_steps(logs, horizon_s)
    clear = margin(logs, noise.half_width)
    every = max(1, sum(map(len, logs)) // COMPARING.free_runs)
    found = clear_starts(logs, steps, every, clear)
    kept = [(log, at) for log, at in zip(logs, found, strict=True) if len(at)]
    logs = tuple(log for log, _ in kept)
    judged = groups(subject.model.state_channels, [all(m) for m in zip(*(log.measured for log in logs), strict=True)])
    return FreeRuns(logs, tuple(a for _, a in kept), steps, every, tuple(judged))


def _squared(subject: Subject, models: dict[str, PhysicsModel], noise: Noise, runs: FreeRuns) -> dict[str, Tensor]:
    """Squared errors (W, steps + 1, groups) of every line."""
    logs, at, steps, measured = runs.logs, runs.at, runs.steps, runs.measured
    squared = {name: errors(free_run(model, logs, at, steps), measured, runs.groups) for name, model in models.items()}
    last = next(reversed(models.values()))
    observed = with_observer(subject, last, noise, runs)
    if observed is not None:
        squared["disturbance"] = errors(observed, measured, runs.groups)
    for model in reversed(models.values()):
        squared["floor"] = floor(model, logs, at, steps, noise, runs.groups).mean(0)
        if torch.isfinite(squared["floor"]).all():
            break
    return squared


def with_observer(subject: Subject, model: PhysicsModel, noise: Noise, runs: FreeRuns) -> Tensor | None:
    """Free runs (W, steps + 1, s) that go on with what the past of a model's disturbance tells.

    None: nothing can be said of it.
    """
    train = subject.of(subject.training)
    if not train or hidden(train) or hidden(runs.logs):
        return None
    observer = Observer.learned(model, train, noise, runs.steps)
    if observer is None:
        return None
    return free_run(model, runs.logs, runs.at, runs.steps, observer.drift(runs.logs, runs.at))


def finite(squared: Tensor) -> np.ndarray:
    """Squared errors with inf for whatever is no number: that run diverged."""
    return np.nan_to_num(squared.numpy(), nan=np.inf, posinf=np.inf)


@dataclass(frozen=True, eq=False)
class Repetition:
    """What repeats among free runs, and how often a bootstrap draws each of it."""

    unit: np.ndarray
    """(W,) that each free run belongs to."""
    draws: np.ndarray
    """(draws, units)."""
    basis: str
    """What the intervals rest on."""

    @classmethod
    def of(cls, runs: FreeRuns, squared: np.ndarray) -> "Repetition":
        """From the squared errors (W, horizons, groups) of one model."""
        unit, basis = _units(runs, squared)
        return cls(unit, _draws(unit, runs.recording, len(runs.logs) >= MIN_RECORDINGS), basis)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Means (draws, …) of values (W, …) over the free runs of every draw."""
        sums = np.zeros((self.draws.shape[1], *values.shape[1:]))
        np.add.at(sums, self.unit, values)
        count = self.draws @ np.bincount(self.unit)
        return np.tensordot(self.draws, sums, axes=1) / count.reshape(-1, *(1,) * (values.ndim - 1))

    def lines(self, squared: np.ndarray, runs: FreeRuns) -> dict[str, Line]:
        """By group, the line of squared errors (W, horizons, groups)."""
        usable = np.where(np.isfinite(squared), squared, 0.0)
        diverged = ~np.isfinite(squared).all(0)  # (H, G)
        low, high = np.sqrt(np.quantile(self.means(usable), [0.025, 0.975], axis=0))
        rmse = np.sqrt(usable.mean(0))
        for of in (rmse, low, high):
            of[diverged] = np.inf
        single = {log.name: np.sqrt(squared[runs.recording == i].mean(0)) for i, log in enumerate(runs.logs)}
        return {
            g.name: Line(
                tuple(rmse[:, i].tolist()),
                tuple(low[:, i].tolist()),
                tuple(high[:, i].tolist()),
                {name: tuple(own[:, i].tolist()) for name, own in single.items()},
            )
            for i, g in enumerate(runs.groups)
        }


def _units(runs: FreeRuns, squared: np.ndarray) -> tuple[np.ndarray, str]:
    """The unit of repetition (W,) that each window belongs to, and what it is in words."""
    logs, recording = runs.logs, runs.recording
    if len(logs) >= MIN_RECORDINGS:
        return recording, f"95 %, bootstrap over {len(logs)} recordings"
    # Two windows that overlap are not independent, nor are two that are nearer than errors are alike.
    length = max(2 * runs.steps, 2 * runs.every * _alike(squared[:, -1], recording))
    block = np.concatenate([a // length for a in runs.at])
    unit = np.unique(np.stack([recording, block]), axis=1, return_inverse=True)[1]
    words = "recording" if len(logs) == 1 else "recordings"
    return unit, (
        f"95 %, bootstrap over blocks of {length / logs[0].rate:.2g} s within {len(logs)} {words} (too few to be "
        "drawn themselves: another recording can differ more)"
    )


def _alike(squared: np.ndarray, recording: np.ndarray) -> int:
    """Windows until the autocorrelation of their error (W, groups) falls below 1/e."""
    level = np.log(np.maximum(np.minimum(squared, 1e30), 1e-30)).mean(1)
    series = [level[recording == r] - level.mean() for r in np.unique(recording)]
    power = sum(float(x @ x) for x in series)
    for lag in range(1, typical_length(series) // 4):
        if sum(float(x[:-lag] @ x[lag:]) for x in series) < power / math.e:
            return lag
    return 1


def _draws(unit: np.ndarray, recording: np.ndarray, over_recordings: bool) -> np.ndarray:
    """How often each unit is drawn (draws, units): within its recording, or of all where recordings are the units."""
    generator, count = np.random.default_rng(0), int(unit.max()) + 1
    of = np.zeros(count, dtype=int)
    of[unit] = 0 if over_recordings else recording
    out = np.zeros((COMPARING.draws, count))
    for stratum in np.unique(of):
        among = np.flatnonzero(of == stratum)
        out[:, among] = generator.multinomial(len(among), np.full(len(among), 1 / len(among)), size=COMPARING.draws)
    return out
