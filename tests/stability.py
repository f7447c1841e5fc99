"""Whether a diagnosis of real recordings moves with what was taken for granted.

`python tests/stability.py [--write results/published/stability.md] DATASET ...`

The constants that have an uncertainty are numbered as `parameters` lists them; those with odd numbers are stated 20 %
higher and the others 20 % lower, and once more the other way round; a vector is scaled whole. Where rates are slopes
of a local polynomial that the loader fits, its window is half and twice as long. Of each recording every second
sample is kept. An answer is the same if its names are, and each of its numbers lies in the 95 % interval of the
unchanged one.

All this was fixed before anything was run. Two things were added after a first look: gravity, which nobody states,
stays; and constants are known to 20 % at best when they are 20 % off. The first look is the rows "known as well as
stated": what is known to 2 % and 20 % off contradicts the recordings.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy.signal import savgol_filter

from bench.claims.manifest import entered
from bench.diagnose import discover, load
from bench.diagnose.logs.subject import Log, Subject
from bench.diagnose.select.discovery import Discovery
from bench.diagnose.select.verify import Estimate
from registry.dynamics import Parameter

OFF = 0.2
"""By how much a constant is stated wrongly."""


def uncertain(subject: Subject) -> list[tuple[Parameter, float]]:
    """The constants of a model that somebody stated, and the relative 1σ of each."""
    known = [(p, subject.uncertainty.get(p.name, p.uncertainty)) for p in subject.model.parameters()]
    return [(p, spread) for p, spread in known if spread > 0 and p.name != "gravity"]


def misstated(subject: Subject, first: float) -> Subject:
    """Every second constant stated higher by ``first`` and the others lower, and known to `OFF` at best."""
    new, spread = {}, {}
    for i, (p, sigma) in enumerate(uncertain(subject)):
        new[p.name] = _scaled(p.value, 1 + first * (-1) ** i)
        spread[p.name] = max(OFF, sigma)
    return replace(subject, model=replace(subject.model, **new), uncertainty={**subject.uncertainty, **spread})


def as_stated(subject: Subject, first: float) -> Subject:
    """The same, known as well as the data or the model state it."""
    return replace(misstated(subject, first), uncertainty=subject.uncertainty)


def applies(change: str, subject: Subject) -> bool:
    """Whether it changes anything more in these recordings."""
    if "window" in change:
        return subject.smoothing is not None and subject.smoothing.derived
    return "as stated" not in change or any(spread < OFF for _, spread in uncertain(subject))


def _scaled(value: object, by: float) -> object:
    return tuple(_scaled(v, by) for v in value) if isinstance(value, tuple) else float(value) * by  # type: ignore[arg-type]


def thinned(subject: Subject, every: int = 2) -> Subject:
    """Of each recording every second sample."""

    def kept(log: Log) -> Log:
        r = log.recording
        own = replace(r, rate=r.rate / every, **{n: getattr(r, n)[::every] for n in ("inputs", "outputs", "valid")})
        sensed = None if log.sensed is None else log.sensed[::every]
        some = {n: getattr(log, n)[::every].contiguous() for n in ("states", "inputs", "valid")}
        return replace(log, rate=log.rate / every, recording=own, sensed=sensed, **some)

    smoothing = subject.smoothing and subject.smoothing.resampled(every)
    return replace(subject, logs=tuple(map(kept, subject.logs)), smoothing=smoothing)


def smoothed(subject: Subject, times: float) -> Subject:
    """A speed that is the slope of a window so many times as long, and stated so."""
    assert subject.smoothing is not None and subject.smoothing.derived
    smoothing = subject.smoothing.resampled(1 / times)
    logs = []
    for log in subject.logs:
        states, valid, edge = log.states.clone(), log.valid.clone(), smoothing.window // 2
        slope = savgol_filter(states[:, 0].numpy(), smoothing.window, smoothing.order, deriv=1, delta=log.dt)
        states[:, 1], valid[:edge], valid[-edge:] = torch.from_numpy(slope), False, False
        logs.append(replace(log, states=states, valid=valid))
    return replace(subject, logs=tuple(logs), smoothing=smoothing)


CHANGES: dict[str, Callable[[Subject], Subject]] = {
    "every second constant 20 % higher, the others lower": lambda s: misstated(s, OFF),
    "the other way round": lambda s: misstated(s, -OFF),
    "half the window": lambda s: smoothed(s, 0.5),
    "twice the window": lambda s: smoothed(s, 2.0),
    "every second sample": thinned,
    "constants 20 % higher and lower, known as well as stated": lambda s: as_stated(s, OFF),
    "the other way round, known as well as stated": lambda s: as_stated(s, -OFF),
}


def numbers(found: Discovery) -> dict[str, Estimate]:
    """The parameters of the effects that were found."""
    return {f"{f.id}.{x.entry.label}": x for f in found.found for x in f.estimates}


def moved(before: Discovery, after: Discovery) -> list[str]:
    """Names that are in one answer only, and numbers that left their intervals; empty: the answer is the same."""
    one, other = ({f.id for f in found.found} for found in (before, after))
    known, now = numbers(before), numbers(after)
    left = [n for n, x in now.items() if n in known and not known[n].low <= x.value <= known[n].high]
    return [*(f"without {n}" for n in sorted(one - other)), *(f"with {n}" for n in sorted(other - one)), *left]


def rows(dataset: str) -> Iterator[tuple[str, ...]]:
    """Lines of the table: what was changed, the answer, its numbers, what moved, seconds of CPU."""
    subject, begun = load(dataset), time.process_time()
    before = discover(subject)
    yield "nothing", before.verdict, _said(before), "–", f"{time.process_time() - begun:.0f}"
    for change, made in CHANGES.items():
        if not applies(change, subject):
            continue
        begun = time.process_time()
        after = discover(made(subject))
        spent = f"{time.process_time() - begun:.0f}"
        yield change, after.verdict, _said(after), ", ".join(moved(before, after)) or "nothing", spent


def _said(found: Discovery) -> str:
    return "; ".join(f"{n} {x.value:.3g} ({x.low:.3g} to {x.high:.3g})" for n, x in numbers(found).items()) or "–"


def main() -> None:
    """Write the table, set by set."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("datasets", nargs="+")
    asked.add_argument("--write", type=Path)
    given = asked.parse_args()
    words = ["python tests/stability.py", *given.datasets, *(["--write", str(given.write)] if given.write else [])]
    lines = [
        "# Whether answers move with what was taken for granted",
        "",
        f"`{' '.join(words)}`, effects and numbers of `discover`, SI;",
        "what is changed, and when an answer is the same, stands at the head of that file.",
    ]
    for dataset in given.datasets:
        lines += ["", f"## {dataset}", "", "| changed | verdict | numbers (95 %) | what moved | CPU [s] |"]
        lines.append("|---|---|---|---|---|")
        for row in rows(dataset):
            print(dataset, *row, sep=" | ", flush=True)
            lines.append(f"| {' | '.join(row)} |")
        if given.write:
            given.write.write_text("\n".join(lines) + "\n", encoding="utf-8")
            entered(given.write)


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
