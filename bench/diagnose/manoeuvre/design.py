"""After a diagnosis: the manoeuvre that would tell its candidates apart, or narrow its intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch

from bench.analysis.display import Displayed, new_axes
from bench.diagnose.logs.subject import Subject
from bench.diagnose.manoeuvre import search
from bench.diagnose.manoeuvre.discrimination import Judge
from bench.diagnose.manoeuvre.limits import Limit, shown
from bench.diagnose.manoeuvre.play import Player
from bench.diagnose.manoeuvre.rivals import Question, between, of_diagnosis
from bench.diagnose.manoeuvre.separation import candidate, windows_of
from bench.diagnose.manoeuvre.stock import kind_of, phrase_of, stock_signals
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import COMPOSING, DESIGNING
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import PhysicsModel, Pilot
from registry.errors import BenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Plan:
    """One manoeuvre, and what so many seconds of it would tell."""

    asked: np.ndarray
    """(R, N, c): inputs or set-points; of an undriven system the states (R, 1, c) from which R runs start."""
    told: np.ndarray
    """(rows, seconds): chances 0..1 that a candidate, if it is the truth, is told from the others; or half widths
    of 95 % intervals, SI."""
    needed_s: float
    """After which the mean chance is 95 %; infinite: not within hours, NaN: no candidates."""

    @property
    def worth(self) -> float:
        """Mean chance over all truths and lengths; of half widths what is gained, by how many times they shrink."""
        return float(-np.log(self.told).mean() if np.isnan(self.needed_s) else self.told.mean())


@dataclass(frozen=True, eq=False)
class Design(Displayed):
    """A manoeuvre to fly or to do."""

    dataset: str
    rows: tuple[str, ...]
    """What `Plan.told` speaks of: candidates, or parameters with their units."""
    candidates: bool
    """Whether those are candidates."""
    seconds: tuple[float, ...]
    piece_s: float
    """Length of the manoeuvre; longer flights go through it several times."""
    dt: float
    drives: tuple[Limit, ...]
    plan: Plan
    stock: Plan | None
    """The best of the effects' own manoeuvres, within the same limits; None: of an undriven system."""
    phrase: str
    """That manoeuvre in words."""
    states: np.ndarray
    """(rows or 1, R, N, s): what each candidate makes of the plan."""
    outputs: tuple[tuple[str, str], ...]
    """Name and unit of the s states."""
    pilot: Pilot | None = None
    """Who follows set-points, of a system that is steered by them."""
    without: tuple[str, ...] = ()
    """Effects that could not be fitted to the recordings, and are no candidates."""
    now: tuple[float, ...] = ()
    """Of parameters: half widths of their intervals as the recordings have them."""

    @property
    def driven(self) -> bool:
        """Whether something drives the system; else it is let go from the states of the plan."""
        return self.plan.asked.shape[1] > 1

    @property
    def columns(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the columns of `table`."""
        own = tuple((d.name, d.unit) for d in self.drives)
        return self.pilot.path_columns if self.pilot else own

    @property
    def table(self) -> np.ndarray:
        """(R, N, columns): inputs; of a vehicle the path through its set-points; or the starts (R, 1, columns)."""
        return self.pilot.path(self.plan.asked, self.dt) if self.pilot else self.plan.asked

    @property
    def headline(self) -> str:
        """What the manoeuvre is worth."""
        told = self.plan.told
        if not self.candidates:
            parts = [
                f"{name} ±{now:.3g} → ±{after:.3g}"
                for name, now, after in zip(self.rows, self.now, told[:, -1], strict=True)
            ]
            return f"After {self.seconds[-1]:g} s: {'; '.join(parts)}."
        chances = ", ".join(f"{100 * c:.0f} % after {s:g} s" for c, s in zip(told.mean(0), self.seconds, strict=True))
        return f"The chance that a diagnosis then names which of {', '.join(self.rows)} it is: {chances}."

    def to_frame(self) -> pd.DataFrame:
        """One row a candidate (or parameter) and length.

        Returns:
            of, seconds, designed, stock: chances (0 to 1), or half widths of 95 % intervals [SI].
        """
        stock = np.full_like(self.plan.told, np.nan) if self.stock is None else self.stock.told
        return pd.DataFrame(
            [
                (row, s, self.plan.told[i, k], stock[i, k])
                for i, row in enumerate(self.rows)
                for k, s in enumerate(self.seconds)
            ],
            columns=["of", "seconds", "designed", "stock"],
        )

    def plot(self) -> "list[Axes]":
        """What is asked for over time: matplotlib axes, one a channel."""
        axes = new_axes(len(self.drives))
        for i, (ax, limit) in enumerate(zip(axes, self.drives, strict=True)):
            for run in self.plan.asked:
                ax.plot(np.arange(len(run)) * self.dt, run[:, i], "." if len(run) == 1 else "-")
            ax.set(xlabel="time [s]", ylabel=f"{limit.name} [{limit.unit}]")
        return axes


def design(
    subject: Subject,
    model: PhysicsModel | None = None,
    candidates: Sequence[str] = (),
    diagnosis: Path | None = None,
    seconds: Sequence[float] | None = None,
    limits: Mapping[str, tuple[float, float, float | None]] | None = None,
    tick: Callable[[str], None] = lambda what: None,
) -> Design:
    """The manoeuvre that separates candidates best, within what the recordings show.

    Args:
        subject: measurements, and the nominal model.
        model: that of the diagnosis, with its effects; default: the nominal one.
        candidates: effects to tell apart; default: what ``diagnosis`` leaves open.
        diagnosis: the diagnosis.json that belongs to ``model``.
        seconds: lengths of flight that are spoken of; the shortest is that of the manoeuvre.
        limits: by channel or signal, (low, high, largest change in a second or None), SI, in place of those shown.
        tick: called with what is being done.

    Raises:
        BenchError: nothing to separate, or limits that leave nothing to drive.
    """
    if at := hidden(subject.logs):
        unseen = ", ".join(subject.model.state_channels[i].name for i in at)
        raise BenchError(f"{unseen} was not measured: designs are for systems whose states all were.")
    subject, noise = prepared(subject, None, tick)
    bounds = shown(subject).told(limits or {})
    start = model or subject.model
    if candidates:
        question = between(subject, start, candidates, noise, tick)
    elif diagnosis is not None:
        question = of_diagnosis(subject, diagnosis, start, noise, tick)
    else:
        raise BenchError("Nothing to separate: give a diagnosis, or candidates.")
    lengths = _lengths(subject, seconds)
    player = Player(subject, bounds, _samples(subject, lengths[0]), noise)
    judge = _judge(subject, question, player, round(lengths[len(lengths) // 2] / lengths[0]), tick)
    others = _stock(player, question.effects)
    sought = search.best(judge, np.stack([x for _, x in others]) if others else _none(player), _share(tick))
    tick("judging")
    plan, stock, phrase = _telling_most(judge, sought, others, lengths)
    return Design(
        dataset=subject.name,
        rows=_rows(judge, question),
        candidates=not question.parameters,
        seconds=lengths,
        piece_s=lengths[0],
        dt=player.dt,
        drives=bounds.drives,
        plan=plan,
        stock=stock,
        phrase=phrase,
        states=_states(judge, plan.asked[None]),
        outputs=tuple((c.name, c.unit) for c in subject.model.state_channels),
        pilot=player.model.pilot(),
        without=question.without,
        now=_now(judge),
    )


def _lengths(subject: Subject, seconds: Sequence[float] | None) -> tuple[float, ...]:
    dt = subject.logs[0].dt
    if seconds:
        lengths = tuple(sorted(set(map(float, seconds))))
        if lengths[0] < 20 * dt:
            raise BenchError(f"--seconds {lengths[0]:g} is less than 20 samples of {dt:g} s: give more.")
        return lengths
    longer = max(subject.logs[0].second, DESIGNING.fewest * dt / DESIGNING.seconds[0])
    return tuple(s * longer for s in DESIGNING.seconds)


def _samples(subject: Subject, piece: float) -> int:
    log = subject.logs[0]
    if log.inputs.shape[1] > len(subject.model.extras):
        return round(piece * log.rate) + 1
    typical = int(np.median([len(x) for x in subject.logs]))
    return max(3, min(typical, round(piece * log.rate / COMPOSING.releases)))


def _judge(subject: Subject, question: Question, player: Player, often: float, tick: Callable[[str], None]) -> Judge:
    tick("noise")
    with torch.inference_mode():
        windows = windows_of(subject, question.models[0][1])
        if windows.steps >= player.samples:
            raise BenchError(
                f"A manoeuvre of {player.samples * player.dt:g} s is shorter than the {windows.steps * player.dt:g} s "
                "over which candidates are compared: give longer --seconds."
            )
        found = tuple(candidate(name, model, subject, windows) for name, model in question.models)
    asked = tuple(k for k, e in enumerate(found[0].where) if (e.owner, e.name) in question.parameters)
    return Judge(player, found, windows, asked, often)


def _share(tick: Callable[[str], None]) -> Callable[[float], None]:
    return lambda share: tick(f"searching, {100 * min(share, 1):.0f} %")


def _stock(player: Player, effects: Sequence[str]) -> list[tuple[str, np.ndarray]]:
    """Of each kind of stock manoeuvre the first effect that it shows, and its signals (R, N, c)."""
    if not player.driven:
        return []
    first: dict[str, str] = {}
    for name in effects:
        first.setdefault(kind_of(name), name)
    drives = player.limits.drives
    return [(name, stock_signals(kind, drives, player.samples, player.dt)) for kind, name in first.items()]


def _none(player: Player) -> np.ndarray:
    return player.asked(np.full((1, player.size), 0.5))


def _telling_most(
    judge: Judge, sought: np.ndarray, others: Sequence[tuple[str, np.ndarray]], lengths: Sequence[float]
) -> tuple[Plan, Plan | None, str]:
    """What tells most of one sought (1, R, N, c) and the stock manoeuvres, then of these alone, and that in words."""

    def judged(asked: np.ndarray) -> tuple[tuple[bool, float], Plan]:
        plan = _plan(judge, asked, lengths)
        return (judge.inside(asked), plan.worth), plan

    found = judged(sought)
    if not others:
        return found[1], None, ""
    name, best = max(((n, judged(x[None])) for n, x in others), key=lambda x: x[1][0])
    return max(best, found, key=lambda x: x[0])[1], best[1], phrase_of(name)


def _plan(judge: Judge, asked: np.ndarray, lengths: Sequence[float]) -> Plan:
    often = [max(1, round(s / lengths[0])) for s in lengths]
    if judge.asked:
        return Plan(asked[0], judge.widths(asked, often), float("nan"))
    chances, needed = judge.chances(asked, often)
    return Plan(asked[0], chances, float("inf") if needed is None else needed * lengths[0])


def _rows(judge: Judge, question: Question) -> tuple[str, ...]:
    if not judge.asked:
        return tuple(c.name for c in judge.candidates)
    where = judge.candidates[0].where
    return tuple(f"{where[k].label} [{where[k].unit}]" for k in judge.asked)


def _states(judge: Judge, asked: np.ndarray) -> np.ndarray:
    runs = [judge.player.play(c.model, asked).states.numpy() for c in judge.candidates]
    return np.stack(runs)


def _now(judge: Judge) -> tuple[float, ...]:
    if not judge.asked:
        return ()
    c = judge.candidates[0]
    spread = np.sqrt(np.diag(np.linalg.pinv(c.known)))[list(judge.asked)] * c.scales[list(judge.asked)]
    return tuple((1.96 * spread).tolist())
