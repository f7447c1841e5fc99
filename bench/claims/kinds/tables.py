"""Errors of a configuration, laid out for a contrast: one cell (seeds, recordings) for each of its channels."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis.contrast import Cell, Contrast, contrast
from bench.analysis.tables import is_baseline, phases
from bench.claims.estimate import Estimate
from bench.claims.evidence import Evidence

RATES = ("body_rates", "euler_rates")
"""What a claim calls "rates": whichever of them the data set predicts."""
Network = tuple[str, int | None]
"""Channel ("" where a whole signal is predicted) and seed (None for a model that has none)."""


@dataclass(frozen=True, eq=False)
class Table:
    """Mean error of every step on every test recording, of one network."""

    values: np.ndarray
    """(T, R)."""
    recordings: tuple[str, ...]


Errors = dict[Network, Table]
Reduce = Callable[[np.ndarray], np.ndarray]
"""(T, R) errors → (R,), one number a recording."""


@dataclass(frozen=True, eq=False)
class Row:
    """A cell and the recordings of its columns."""

    cell: Cell
    recordings: tuple[str, ...]


Rows = dict[str, Row]
"""By channel."""
Stratum = tuple[Row, Sequence[Row]]
"""One configuration on one channel, and those whose mean it is divided by; none: the row holds the ratio itself."""


def signals(role: str) -> list[str]:
    """The names that a role may stand for: "rates_forced" → "body_rates_forced", "euler_rates_forced"."""
    head, underscore, view = role.partition("_")
    return [f"{r}{underscore}{view}" for r in RATES] if head == "rates" else [role]


def errors(evidence: Evidence, spec: str, role: str, horizon: int, norm: str = "paper") -> Errors:
    """Sound runs only; of a signal predicted whole its norm, else each channel that was predicted alone. Not to change:
    the next who asks gets the same."""
    asked = (spec, role, horizon, norm)
    if asked not in evidence.laid_out:
        evidence.laid_out[asked] = _errors(evidence, *asked)
    return evidence.laid_out[asked]


def _errors(evidence: Evidence, spec: str, role: str, horizon: int, norm: str) -> Errors:
    found: Errors = {}
    for run in evidence.of(spec, horizon):
        if not run.sound:
            continue
        seed = None if is_baseline(spec) else run.seed
        for signal in signals(role):
            whole = evidence.curves.get((run.key, signal, norm))
            channels = [o for o in run.outputs if o.startswith(f"{signal}.")]
            alone = {c: evidence.curves.get((run.key, c, "axis")) for c in channels} if whole is None else {"": whole}
            for channel, curves in alone.items():
                by_recording = {s: c for s, c in (curves or {}).items() if s.startswith("mean@")}
                if by_recording:
                    values = np.stack(list(by_recording.values()), axis=1)
                    if np.isfinite(values).all():
                        found[channel, seed] = Table(values, tuple(by_recording))
    return found


def mean(values: np.ndarray) -> np.ndarray:
    """(T, R) → (R,), over all steps."""
    return values.mean(0)


def over(phase: str, horizon: int) -> Reduce:
    """Mean over a phase of the horizon: "first", "whole" or "last" as in the tables, or "start", its first step."""
    if phase == "start":
        return lambda values: values[0]
    steps = next(s for name, s in phases(horizon).items() if name.startswith(phase))
    return lambda values: values[steps].mean(0)


def rows(tables: Errors, reduce: Reduce = mean) -> Rows:
    """The logarithms of the errors, a row for each channel."""
    return gathered((network, np.log(reduce(t.values)), t.recordings) for network, t in tables.items())


def quotients(above: Errors, below: Errors, reduce: Reduce = mean, other: Reduce | None = None) -> Rows:
    """The logarithms of what each network has in one table over what it has in another."""
    return gathered(
        (network, np.log(reduce(a[0]) / (other or reduce)(a[1])), recordings)
        for network, top in above.items()
        if network in below
        for *a, recordings in [_aligned(top, below[network])]
    )


def _aligned(a: Table, b: Table) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """The columns of both that are of the same recording."""
    shared = tuple(r for r in a.recordings if r in b.recordings)
    picked = (t.values[:, [t.recordings.index(r) for r in shared]] for t in (a, b))
    return (*picked, shared)  # type: ignore[return-value]


def gathered(networks: Iterable[tuple[Network, np.ndarray, tuple[str, ...]]]) -> Rows:
    """Networks with their (R,) values as rows, on the recordings that all networks of a channel share."""
    by_channel: dict[str, list[tuple[int | None, np.ndarray, tuple[str, ...]]]] = {}
    for (channel, seed), values, recordings in networks:
        by_channel.setdefault(channel, []).append((seed, values, recordings))
    found = {}
    for channel, members in by_channel.items():
        shared = tuple(r for r in members[0][2] if all(r in m[2] for m in members))
        values = np.stack([v[[names.index(r) for r in shared]] for _, v, names in members])
        found[channel] = Row(Cell(values, fixed=all(seed is None for seed, _, _ in members)), shared)
    return found


def strata(rows: Rows, others: Sequence[Rows]) -> list[Stratum]:
    """Every channel of a configuration beside that channel of all others that have any."""
    met = [o for o in others if o]
    return [(row, [o[c] for o in met]) for c, row in rows.items() if met and all(c in o for o in met)]


def pool(evidence: Evidence, response: Callable[[str], Rows]) -> list[Cell]:
    """The cells of every trained configuration of the study, by which the spread of seeds is moderated."""
    specs = [s for s in evidence.specs("*", histories=True) if not is_baseline(s)]
    return [row.cell for s in specs for row in response(s).values()]


def ratio(name: str, wanted: Sequence[Stratum], around: Sequence[Cell] = (), recorded: bool = True) -> list[Estimate]:
    """The geometric mean over strata of the left errors to the right ones; empty without a stratum.

    Args:
        name: what is compared.
        wanted: each counts the same.
        around: cells by which the spread of seeds is moderated.
        recorded: whether the numbers were measured on recordings, of which one alone says nothing about another.
    """
    if not wanted:
        return []
    members = [r for left, right in wanted for r in (left, *right)]
    shared = [r for r in members[0].recordings if all(r in m.recordings for m in members)]
    if not shared:
        return []
    kept: dict[int, Cell] = {}
    for m in members:
        columns = [m.recordings.index(r) for r in shared]
        whole = len(columns) == len(m.recordings)
        kept.setdefault(id(m), m.cell if whole else Cell(m.cell.values[:, columns], m.cell.fixed))
    weighted = []
    for left, right in wanted:
        weighted.append((1 / len(wanted), kept[id(left)]))
        weighted += [(-1 / (len(wanted) * len(right)), kept[id(r)]) for r in right]
    own = {id(m.cell) for m in members}
    return [_estimate(name, contrast(weighted, [c for c in around if id(c) not in own]), recorded)]


def _estimate(name: str, found: Contrast, recorded: bool) -> Estimate:
    def limits(alpha: float, seeds: float, recordings: float) -> tuple[float, float]:
        half = found.half_width(alpha, seeds, recordings)
        return _exp(found.value - half), _exp(found.value + half)

    conclusive = found.trainings > 1 and (found.recordings > 1 or not recorded)
    seeds, recordings = found.trainings, found.recordings if recorded else 0
    return Estimate(
        name=name,
        value=_exp(found.value),
        limits=limits,
        basis=_basis(found, recorded),
        conclusive=conclusive,
        seeds=seeds,
        recordings=recordings,
    )


def _exp(value: float) -> float:
    return math.exp(value) if value < 700 or math.isnan(value) else math.inf


def _basis(found: Contrast, recorded: bool) -> str:
    """What an interval rests on and what it leaves out."""
    words = []
    if recorded:
        one = "one recording, which says nothing about another"
        words.append(f"t-interval over {found.recordings} recordings" if found.recordings > 1 else one)
    if found.trainings < 2:
        return "; ".join([*words, "one training, which says nothing about the next"])
    lent = f", {found.borrowed:.1f} of them lent by the rest of the study" if found.borrowed >= 0.05 else ""
    groups = f"{found.strata} group{'s' if found.strata > 1 else ''}"
    spread = f"the spread of seeds has {found.freedom:.1f} degrees of freedom{lent}"
    return "; ".join([*words, f"{found.networks} trained networks in {groups} ({spread})"])


def ratio_of_numbers(left: Iterable[float], right: Iterable[float]) -> float | None:
    """Geometric mean of the ratios, where a network has one number only; None without one."""
    logs = [math.log(a / b) for a, b in zip(left, right, strict=True) if a > 0 and b > 0]
    return math.exp(float(np.mean(logs))) if logs else None
