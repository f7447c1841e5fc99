"""Step 2: where the error of a model is, in terms of what the system does."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch

from bench.analysis.display import Displayed, draw_bars, new_axes
from bench.diagnose.evidence import ResidualMap, Window
from bench.diagnose.logs.load import subject_of
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch, Subject
from bench.diagnose.regression.conditions import Condition, conditions
from bench.diagnose.regression.residuals import residual_maps
from bench.diagnose.result import Region
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import LOCATING
from bench.diagnose.simulate.floor import floor
from bench.diagnose.simulate.free_run import (
    Group,
    clear_starts,
    default_steps,
    errors,
    free_run,
    groups,
    margin,
    measured_windows,
    starts,
)
from bench.diagnose.simulate.unmeasured import completed, hidden
from registry.contracts import Dataset
from registry.dynamics import PhysicsModel
from registry.units import display

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Location(Displayed):
    """Where the error is."""

    regions: tuple[Region, ...] = ()
    """Best first; none where the error is at the floor, or is everywhere."""
    residuals: tuple[ResidualMap, ...] = ()
    windows: tuple[Window, ...] = ()
    horizon_s: float = math.nan
    """Of the free runs whose errors were located [s]."""
    above_floor: dict[str, float] = field(default_factory=dict)
    """By output group: squared error above the floor at that horizon, over the floor's."""
    notes: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """The region that holds most, or why there is none."""
        if not self.regions:
            return " ".join(self.notes)
        best = self.regions[0]
        return f"{best.region}: {best.share_of_error:.0%} of the error in {best.share_of_time:.0%} of the time"

    def to_frame(self) -> pd.DataFrame:
        """One row a region, best first.

        Returns:
            region, share_of_error, share_of_time (0 to 1), recordings (how many it is met in).
        """
        return pd.DataFrame(
            [(r.region, r.share_of_error, r.share_of_time, len(r.recordings)) for r in self.regions],
            columns=["region", "share_of_error", "share_of_time", "recordings"],
        )

    def plot(self) -> "Axes":
        """Share of the error beside share of the time, region by region: matplotlib axes."""
        (axes,) = new_axes(1)
        shares = {
            "of the error": [100 * r.share_of_error for r in self.regions],
            "of the time": [100 * r.share_of_time for r in self.regions],
        }
        draw_bars(axes, [r.region for r in self.regions], shares, "share [%]")
        return axes


def locate(
    subject: str | Path | Dataset | Subject,
    model: PhysicsModel,
    names: Sequence[str] | None = None,
    after: PhysicsModel | None = None,
    noise: Noise | None = None,
    horizon_s: float | None = None,
) -> Location:
    """Say in which conditions a model errs.

    Args:
        subject: measurements, or the folder or name that `load` reads.
        model: whose error is located.
        names: recordings; default: all.
        after: a better model, shown beside it.
        noise: default `noise.noise_of`.
        horizon_s: of the worst free runs that are shown [s]; default `free_run.default_steps`.

    Raises:
        BenchError: no recording is long enough.
    """
    subject, noise = prepared(subject_of(subject), noise)
    logs = list(subject.logs if names is None else subject.of(names))
    stack = LogBatch.of(logs)
    if hidden(logs):
        stack = replace(stack, states=completed(after or model, stack))
    steps = max(1, round(LOCATING.horizon_share * default_steps(logs)))
    judged, variance = _judged(model, logs)
    with torch.no_grad():
        every = max(1, steps // LOCATING.overlap, sum(map(len, logs)) // LOCATING.free_runs)
        at = clear_starts(logs, steps, every, margin(logs, noise.half_width))
        squared = errors(free_run(model, logs, at, steps), measured_windows(logs, at, steps), judged)[:, -1].numpy()
        chance = floor(model, logs, at, steps, noise, judged)[:, :, -1].flatten(0, 1).numpy()
        diverged = 1e3 * float(squared[np.isfinite(squared)].max(initial=1.0))
        squared = np.nan_to_num(squared, nan=diverged, posinf=diverged)
        chance = np.where(np.isfinite(chance), chance, 0.0)
        # Beside its floor every group counts alike: a pose is known to millimetres, a velocity is not.
        least = np.maximum(chance.mean(0), LOCATING.least_error**2 * variance)
        ratio = (squared - chance.mean(0)) / least
        above = {g.name: float(ratio[:, i].mean()) for i, g in enumerate(judged)}
        # Both means vary; windows that overlap count once.
        error = np.sqrt(2 * LOCATING.overlap / len(squared)) * chance.std(0) / least
        visible = ratio.mean(0) > np.maximum(LOCATING.least_excess, LOCATING.least_deviations * error)
        recording = np.repeat(np.arange(len(logs)), [len(a) for a in at])
        found: list[tuple[Region, Condition]] = []
        where = conditions(model, stack)
        if visible.any():
            score = ratio[:, visible].sum(1)
            values = [np.concatenate([c.means(i, k, steps + 1) for i, k in enumerate(at)]) for c in where]
            found = _regions(where, values, score, recording, [log.name for log in logs])
        regions = tuple(region for region, _ in found)
        named = {condition.name: region.region for region, condition in reversed(found)}
        maps = residual_maps(model, after, stack, where, noise, window=steps, regions=named)
        worst = judged[int(np.argmax(ratio.mean(0)))]
        shown = _worst(model, after, logs, worst, margin(logs, noise.half_width), default_steps(logs, horizon_s))
    spread = "The error is spread over all that the system does: no condition stands out in several recordings."
    none = spread if visible.any() else "The error is no larger than noise and smoothing make it."
    notes = () if regions else (none,)
    return Location(regions, maps, shown, steps / logs[0].rate, above, notes)


def _judged(model: PhysicsModel, logs: Sequence[Log]) -> tuple[list[Group], np.ndarray]:
    """Groups whose errors are pooled, and the variance of each."""
    found = groups(model.state_channels, [all(m) for m in zip(*(log.measured for log in logs), strict=True)])
    found = [g for g in found if g.name in model.description().located] or found
    states = torch.cat([log.states[log.valid] for log in logs])
    return found, np.array([float(states[:, list(g.at)].var(0).sum()) or 1.0 for g in found])


# --------------------------------------------------------------------------------------------------- the regions


def _regions(
    where: Sequence[Condition], values: Sequence[np.ndarray], score: np.ndarray, recording: np.ndarray, names: list[str]
) -> list[tuple[Region, Condition]]:
    """Regions with more of the error than of the time, most telling first, none that better ones hold already."""
    candidates = []
    for condition, x in zip(where, values, strict=True):
        best = _best(condition, x, score)
        if best is not None:
            gain, text, inside = best
            met = _met(inside, score, recording)
            if len(met) >= min(2, len(names)):
                candidates.append((gain, text, inside, met, condition))
    candidates.sort(key=lambda c: -c[0])
    chosen: list[tuple[Region, Condition]] = []
    taken = np.zeros(len(score), dtype=bool)
    for _, text, inside, met, condition in candidates:
        if score[inside & ~taken].sum() < LOCATING.least_new * score.sum():
            continue
        share = min(1.0, float(score[inside].sum() / score.sum()))
        recordings = tuple(names[i] for i in met)
        chosen.append((Region(text, share, float(inside.mean()), recordings), condition))
        taken |= inside
        if len(chosen) == LOCATING.regions:
            break
    return chosen


def _best(condition: Condition, x: np.ndarray, score: np.ndarray) -> tuple[float, str, np.ndarray] | None:
    """The threshold, or the interval where that says much more, that tells most about where the error is.

    What it tells is the information that it gives: s ln(s/t) + (1 − s) ln((1 − s)/(1 − t)) at the shares s and t.
    """
    unit, factor = display(condition.unit, condition.name)
    shown = x * factor
    spread = float(np.subtract(*np.quantile(shown, [0.95, 0.05])))
    if not spread > 0:
        return None
    step = 10 ** math.floor(math.log10(spread / 10))  # as many digits as anyone would say
    cuts = np.unique(np.round(np.quantile(shown, np.linspace(0.05, 0.95, LOCATING.cuts)) / step) * step)
    order = np.argsort(shown)
    place = np.concatenate([[0], np.searchsorted(shown[order], cuts), [len(x)]])
    error = (np.concatenate([[0.0], np.cumsum(score[order])]) / score.sum())[place]
    low, high = np.triu_indices(len(place), 1)
    share, time = error[high] - error[low], (place[high] - place[low]) / len(x)
    s, t = np.clip(share, 1e-9, 1 - 1e-9), np.clip(time, 1e-9, 1 - 1e-9)
    told = s * np.log(s / t) + (1 - s) * np.log((1 - s) / (1 - t))
    interval = (low > 0) & (high < len(place) - 1)
    told = np.where(
        (share - time > LOCATING.least_difference) & (share > LOCATING.least_ratio * time), told, 0.0
    ) / np.where(interval, LOCATING.interval_handicap, 1.0)
    best = int(np.argmax(told))
    if not told[best] > 0:
        return None
    digits = max(0, -round(math.log10(step)))
    ends = [f"{v + 0.0:.{digits}f}".replace("-", "−") for v in cuts]
    i, j, suffix = int(low[best]), int(high[best]), "" if unit == "1" else f" {unit}".replace("^2", "²")
    if interval[best]:
        text = f"{condition.name} from {ends[i - 1]} to {ends[j - 1]}{suffix}"
    else:
        text = f"{condition.name} < {ends[j - 1]}{suffix}" if i == 0 else f"{condition.name} > {ends[i - 1]}{suffix}"
    inside = np.zeros(len(x), dtype=bool)
    inside[order[place[i] : place[j]]] = True
    return float(told[best]), text, inside


def _met(inside: np.ndarray, score: np.ndarray, recording: np.ndarray) -> list[int]:
    """Recordings in which the region is met and holds more of the error than of the time."""
    met, usual = [], score[inside].mean()
    for r in np.unique(recording):
        own = recording == r
        here, total = own & inside, score[own].sum()
        if here.sum() < LOCATING.least_windows or score[here].mean() < LOCATING.least_recording * usual:
            continue
        if score[here].sum() > total * here.sum() / own.sum():
            met.append(int(r))
    return met


# --------------------------------------------------------------------------------------------- the worst windows


def _worst(
    model: PhysicsModel, after: PhysicsModel | None, logs: Sequence[Log], group: Group, clear: int, steps: int
) -> tuple[Window, ...]:
    """The windows of so many steps in which a group errs most, of different recordings where there are."""
    at = [starts(log, steps + clear, max(1, steps // 2), clear) for log in logs]
    if not any(map(len, at)):
        return ()
    measured, nominal = measured_windows(logs, at, steps), free_run(model, logs, at, steps)
    better = None if after is None else free_run(after, logs, at, steps)
    squared = np.nan_to_num(errors(nominal, measured, [group])[..., 0].mean(1).numpy(), nan=np.inf)
    recording, first = np.repeat(np.arange(len(logs)), [len(a) for a in at]), np.concatenate(at)
    chosen: list[int] = []
    for once_each in (True, False):
        for w in np.argsort(-squared):
            apart = all(recording[w] != recording[c] or (not once_each and abs(w - c) > 2) for c in chosen)
            if apart and len(chosen) < LOCATING.worst_windows and int(w) not in chosen:
                chosen.append(int(w))
    channels, dt = [model.state_channels[i] for i in group.at], logs[0].dt

    def rows(states: torch.Tensor, w: int) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(states[w, :, i].tolist()) for i in group.at)

    return tuple(
        Window(
            recording=logs[recording[w]].name,
            start_s=float(first[w] * dt),
            group=group.name,
            unit=channels[0].unit,
            channels=tuple(c.name for c in channels),
            t=tuple((np.arange(steps + 1) * dt).tolist()),
            measured=rows(measured, w),
            nominal=rows(nominal, w),
            extended=() if better is None else rows(better, w),
        )
        for w in chosen
    )
