"""How much is left to find: a network around the last model, judged on the same free runs as that."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from bench.analysis.display import Displayed
from bench.diagnose.ceiling.autoregression import autoregression
from bench.diagnose.ceiling.deviation import axes, corrected
from bench.diagnose.ceiling.examples import Examples, Grid
from bench.diagnose.ceiling.findings import Compared, find
from bench.diagnose.ceiling.network import Networks
from bench.diagnose.compare import FreeRuns, Repetition, finite, free_runs, with_observer
from bench.diagnose.evidence import LINES, Curves, Line, Predictable, plot_curves
from bench.diagnose.logs.load import load
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.result import ByGroup, Diagnosis, GroupError
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import CEILING
from bench.diagnose.simulate.floor import floor
from bench.diagnose.simulate.free_run import Group, errors, margin, measured_windows, starts
from registry.contracts import Dataset
from registry.dynamics import PhysicsModel
from registry.errors import BenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Tick = Callable[[str], None]
Part = tuple[tuple[Log, ...], list[np.ndarray]]
"""Recordings, and the samples of each that free runs start from."""


@dataclass(frozen=True, eq=False)
class Ceiling(Displayed):
    """What a network predicts of what a model leaves, on held-out recordings; SI."""

    curves: dict[str, Curves]
    """By group: lines "extended" (the model), "disturbance" (helped by an observer), "network" and "floor"."""
    findings: tuple[Predictable, ...]
    """One a group."""
    axes: tuple[Predictable, ...]
    """One a channel of the groups that have an equation of their own."""
    notes: tuple[str, ...]
    """What was done, in sentences."""

    @property
    def error(self) -> ByGroup:
        """Of the network, at the last horizon."""
        return {f.group: GroupError(f.horizon_s, f.network, f.unit) for f in self.findings}

    @property
    def headline(self) -> str:
        """What is left to find, group by group."""
        each = (f"{f.group} {f.model:.3g} → {f.network:.3g} {f.unit} ({f.finding})" for f in self.findings)
        return f"A network on the same history and inputs: {', '.join(each)}"

    def to_frame(self) -> pd.DataFrame:
        """One row a group, then one a channel of those that have an equation of their own.

        Returns:
            output, horizon_s, model, observer, autoregression, network, floor (rms errors in the unit named, SI), unit,
            finding, axes.
        """
        return pd.DataFrame(
            [
                (f.group, f.horizon_s, *f.errors, f.unit, f.finding, ", ".join(f.axes))
                for f in (*self.findings, *self.axes)
            ],
            columns=["output", "horizon_s", *Predictable.lines, "unit", "finding", "axes"],
        )

    def plot(self) -> "list[Axes]":
        """Error against the horizon with 95 % intervals: matplotlib axes, one a group of outputs."""
        return plot_curves(self.curves)


def ceiling(
    source: str | Path | Dataset | Subject,
    model: PhysicsModel | None = None,
    system: str | None = None,
    tick: Tick = lambda what: None,
    horizon_s: float | None = None,
) -> Ceiling:
    """Train networks on what the free runs of a model leave, and judge them on the free runs that models are judged by.

    Takes minutes. A network sees what was measured before a run starts, and during it the inputs and the model's own
    states: what it predicts, a better model could. It is no bound: another network may predict more.

    Args:
        source: a folder with a dataset.toml, the name of a registered data set, or measurements already read.
        model: around which the networks stand, such as the extended one of `diagnose`; default: the nominal one.
        system: a registered physics model or "path/to/file.py:Class"; default: what the data name.
        tick: called with what is being done.
        horizon_s: longest horizon [s]; default as for `compare`.

    Raises:
        BenchError: data cannot be read, or the recordings to learn from are too short or too few.
    """
    tick("read")
    subject = source if isinstance(source, Subject) else load(source, system)
    model = subject.model if model is None else model
    subject, noise = prepared(subject, tick=tick)
    runs = free_runs(subject, noise, horizon_s=horizon_s)
    tick("free runs")
    grid, clear = Grid(runs.steps), margin(runs.logs, noise.half_width)
    known = _parts(subject.of(subject.training), runs.steps, clear)
    learned, others = (Examples.of(model, logs, at, grid, runs.groups) for logs, at in known)
    networks = Networks.learned(learned, others, _telling(tick))
    tick("free runs")
    shown = Examples.of(model, runs.logs, runs.at, grid, runs.groups)
    with torch.no_grad():
        return _judged(_Judged(subject, model, noise, runs, grid, known[0]), shown, networks.predict(shown))


def _telling(tick: Tick) -> Callable[[float], None]:
    """Says how much of a training is done, and how long the rest takes at the pace so far."""
    begun = time.monotonic()

    def tell(share: float) -> None:
        left = (time.monotonic() - begun) * (1 / max(share, 1e-9) - 1)
        tick(f"network: {share:.0%} of its training, at most {left:.0f} s left")

    return tell


@dataclass(frozen=True, eq=False)
class _Judged:
    """A model whose remaining error is judged: its free runs, and the part that networks are trained on."""

    subject: Subject
    model: PhysicsModel
    noise: Noise
    runs: FreeRuns
    grid: Grid
    learned: Part


def _parts(logs: Sequence[Log], steps: int, clear: int) -> tuple[Part, Part]:
    """Starts of the training windows and of the validation windows: other recordings, or the ends of the same ones.

    Raises:
        BenchError: they are too short or too few.
    """
    if len(logs) >= CEILING.fold:
        aside = [i % CEILING.fold == CEILING.fold // 2 for i in range(len(logs))]
        first = [
            np.zeros(0, int) if a else _starts(log, logs, steps, clear) for log, a in zip(logs, aside, strict=True)
        ]
        last = [_starts(log, logs, steps, clear) if a else np.zeros(0, int) for log, a in zip(logs, aside, strict=True)]
    else:
        cut = [len(log) - round(max(CEILING.end * len(log), CEILING.end_horizons * steps)) for log in logs]
        every = [_starts(log, logs, steps, clear) for log in logs]
        first = [at[at + steps < c] for at, c in zip(every, cut, strict=True)]
        last = [at[at >= c] for at, c in zip(every, cut, strict=True)]
    parts = _kept(logs, first, CEILING.windows), _kept(logs, last, CEILING.confirming)
    if not all(at for _, at in parts):
        raise BenchError(
            "The recordings to learn from are too short or too few for a network: give longer ones, or a shorter "
            "--horizon."
        )
    return parts


def _starts(log: Log, logs: Sequence[Log], steps: int, clear: int) -> np.ndarray:
    """Starts of windows in a log, twice as many as the training takes (`CEILING.windows` over all logs)."""
    return starts(log, steps + clear, max(1, sum(map(len, logs)) // (2 * CEILING.windows)), clear)


def _kept(logs: Sequence[Log], at: Sequence[np.ndarray], most: int) -> Part:
    """At most so many starts, evenly spread, and the logs that have some."""
    every = max(1, -(-sum(map(len, at)) // most))
    kept = [(log, a[::every]) for log, a in zip(logs, at, strict=True) if len(a)]
    return tuple(log for log, _ in kept), [a for _, a in kept]


def _judged(of: _Judged, shown: Examples, each: Tensor) -> Ceiling:
    """Errors and findings of what networks add (networks, W, T, n) to free runs."""
    runs, model = of.runs, of.model
    every = [*runs.groups, *_dynamic(model, runs.groups)]
    measured = measured_windows(runs.logs, runs.at, runs.steps)

    def squared(states: Tensor) -> np.ndarray:
        return finite(errors(states, measured, every))

    run, added = shown.run, _at_every_sample(of.grid, each)
    own = squared(run)
    lines = {"extended": own, "network": squared(corrected(run, added.mean(0), runs.groups))}
    observed = with_observer(of.subject, model, of.noise, runs)
    if observed is not None:
        lines["disturbance"] = squared(observed)
    lines["floor"] = finite(floor(model, runs.logs, runs.at, runs.steps, of.noise, every).mean(0))
    lines["still"] = squared(measured[:, :1].expand_as(measured))
    lines["autoregression"] = squared(autoregression(of.learned, (runs.logs, runs.at), runs.steps, runs.groups))
    repeated = Repetition.of(runs, own[:, runs.ends][..., : len(runs.groups)])
    last = {name: values[:, -1] for name, values in lines.items()}
    singles = [squared(corrected(run, one, runs.groups))[:, -1].mean(0) ** 0.5 for one in added]
    found, single = find(Compared(last, repeated, every), len(runs.groups), runs.horizon_s[-1])
    drawn = {n: repeated.lines(v[:, runs.ends], runs) for n, v in lines.items() if n in LINES}
    return Ceiling(
        {g.name: Curves(g.unit, runs.horizon_s, {n: of[g.name] for n, of in drawn.items()}) for g in runs.groups},
        found,
        single,
        _notes(of, found, np.array(singles), repeated.basis),
    )


def _dynamic(model: PhysicsModel, groups: Sequence[Group]) -> list[Group]:
    """Axes of the groups that have an equation of their own: a pose is wrong because its rates are."""
    own = [g for g in groups if g.name in model.equation_names()]
    return axes(own or groups, model.state_channels)


def _at_every_sample(grid: Grid, each: Tensor) -> Tensor:
    """Deviations (…, T, n) at all samples (…, steps + 1, n), 0 at the first."""
    at = np.arange(grid.steps + 1)
    hats = np.stack([np.interp(at, [0, *grid.ahead], row) for row in np.eye(len(grid.ahead) + 1)[1:]], axis=1)
    return torch.einsum("st,...tn->...sn", torch.from_numpy(hats), each)


def _notes(of: _Judged, found: Sequence[Predictable], singles: np.ndarray, basis: str) -> tuple[str, ...]:
    learned = sum(map(len, of.learned[1]))
    spread = "; ".join(
        f"{f.group.replace('_', ' ')} {singles[:, i].min():.3g} to {singles[:, i].max():.3g} {f.unit}"
        for i, f in enumerate(found)
    )
    return (
        f"The network: LSTM 1x{CEILING.hidden} around the free run of the last model, the mean of {len(singles)} "
        f"trained from seeds 0 to {len(singles) - 1} on {learned} free runs of training recordings; each alone: "
        f"{spread}. Intervals: {basis}.",
    )


def informed(diagnosis: Diagnosis, found: Ceiling) -> Diagnosis:
    """A diagnosis that says what a network predicts too."""
    curves = {}
    for group, of in diagnosis.evidence.curves.items():
        lines: dict[str, Line] = dict(of.lines)
        if group in found.curves:
            lines["network"] = found.curves[group].lines["network"]
        curves[group] = replace(of, lines={n: lines[n] for n in LINES if n in lines})
    evidence = replace(
        diagnosis.evidence,
        curves=curves,
        predictable=found.findings,
        predictable_axes=found.axes,
        notes=(*diagnosis.evidence.notes, *found.notes),
    )
    return replace(diagnosis, ceiling=found.error, evidence=evidence)
