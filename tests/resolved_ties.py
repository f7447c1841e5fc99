"""Whether flying what `bench design` writes tells apart what hover does not, and sooner than the stock manoeuvre.

`python tests/resolved_ties.py [--fraction 1/4] [--write results/published/resolved_ties.md]`

The cases are the ties of `bench score-discovery`: six flights that hover, with one hidden effect. Each is diagnosed;
what is tied is designed for; RotorPy flies the path of the design, and that of the best stock manoeuvre, with the
vehicle, its sensors and its hidden effect as in the hovering flights. These are diagnosed again with the new flights
beside them: `FLIGHTS` of one of `PIECES`, the shortest first, every second one held out. A tie is resolved where the
true effect is then named and stands alone, by the shortest flights after which it does. The warm-up at the beginning
of a flight is not counted, for both alike. The control hovers as long as the longest flights: it must resolve nothing.

Limits: hovering flights show no room to move, so that it is stated (`ROOM`, as `bench design --limit`), for both alike.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

from bench.claims.manifest import entered
from bench.diagnose import design, diagnose
from bench.diagnose.logs.subject import Subject
from bench.diagnose.result import Diagnosis
from bench.score import case as first
from bench.score.case import Case
from bench.score.chains import cases, measured
from bench.score.logs import subject
from bench.score.multirotor import flights, hidden
from bench.score.run import part
from registry.cache import cache_folder
from registry.dynamics import PhysicsModel

PIECES = (0.7, 1.0, 1.5, 2.5, 5.0, 10.0)
"""Lengths of a manoeuvre that are tried, each with a design of its own [s]."""
FLIGHTS = 4
"""Flights of it."""
ROOM = {
    "position.x": (-1.5, 1.5, 1.5),
    "position.y": (-1.5, 1.5, 1.5),
    "position.z": (0.5, 2.5, 1.0),
    "velocity": (-2.0, 2.0, None),
    "body_rates": (-3.0, 3.0, None),
    "yaw": (-np.pi / 2, np.pi / 2, 2.0),
}
"""Where a set-point or a state may go and how fast; SI."""


@dataclass(frozen=True)
class Told:
    """What flights of one manoeuvre told."""

    seconds: float
    """Flown until the true effect stood alone; infinite: never."""
    said: str
    """The last answer."""


def flown(case: Case, path: np.ndarray, count: int) -> list[first.Columns]:
    """Logs of ``count`` flights along one path (N, 11), sampled at the rate of the logs."""
    own = replace(case, recordings=count, seed=case.seed + 1000)
    vehicle, vessel, p = first.VEHICLES[case.vehicle], first.craft(own, first.charges(own)), first.parameters(case)
    stiff, damp = vehicle.gains
    p |= {"kp_att": np.full(3, stiff), "kd_att": np.full(3, damp), "mass": vessel.mass, "k_eta": vessel.k_eta}
    coarse, fine = np.arange(len(path)), np.arange((len(path) - 1) * flights.EVERY + 1) / flights.EVERY
    between = np.stack([np.interp(fine, coarse, column) for column in path.T], axis=1)
    still = np.concatenate([between[0, :3], np.zeros(6), between[0, 9:10], [0.0]])
    wanted = np.concatenate([np.tile(still, (round(flights.WARM_UP / flights.STEP), 1)), between])
    every = np.repeat(wanted[:, :, None], count, axis=2)
    air = hidden.wind(np.random.default_rng(0), case.effects, 2 * len(wanted) - 1, count, flights.STEP / 2)
    motors = hidden.motors(case.effects, case.drive, p["tau_m"])
    return first.clean(own, flights.fly(vessel, flights.Pilot(p), motors, every, air, 1))


def beside(case: Case, hovering: Subject, path: np.ndarray, count: int) -> Subject:
    """The hovering flights and new ones, of which every second is held out."""
    made = subject(case.id, flown(case, path, count), first.nominal(case), dict(first.UNCERTAINTY), {}, case.drive)
    logs = [replace(log, name=f"new_{i + 1}") for i, log in enumerate(made.logs)]
    logs = [replace(log, recording=replace(log.recording, name=log.name)) for log in logs]
    names = [log.name for log in logs]
    return replace(
        hovering,
        logs=(*hovering.logs, *logs),
        training=(*hovering.training, *names[::2]),
        held_out=(*hovering.held_out, *names[1::2]),
    )


def alone(case: Case, said: Diagnosis) -> bool:
    """Whether the true effect is named, no other is, and nothing is tied with it."""
    named = [e for e in said.effects if not e.learned]
    return [e.id for e in named] == list(case.names) and not any(e.indistinguishable_from for e in named)


def answer(said: Diagnosis) -> str:
    """In a few words."""
    named = [" or ".join((e.id, *e.indistinguishable_from)) for e in said.effects]
    return f"{said.verdict}: {', '.join(named)}" if named else said.verdict


def told(case: Case, hovering: Subject, path: np.ndarray, piece: float) -> Told:
    """What flights along a path of ``piece`` seconds tell."""
    said, _ = diagnose(beside(case, hovering, path, FLIGHTS), brief=True)
    return Told(FLIGHTS * piece if alone(case, said) else float("inf"), answer(said))


def both(case: Case, hovering: Subject, model: PhysicsModel, file: Path) -> list[Told]:
    """What the design and the stock manoeuvre tell, each in the shortest flights in which it resolves the tie."""
    pilot, found = model.pilot(), [Told(float("inf"), ""), Told(float("inf"), "")]
    assert pilot is not None
    for piece in PIECES:
        made = design(hovering, model, diagnosis=file, seconds=(piece, FLIGHTS * piece), limits=ROOM)
        assert made.stock is not None
        for i, plan in enumerate((made.plan, made.stock)):
            if not np.isfinite(found[i].seconds):
                found[i] = told(case, hovering, pilot.path(plan.asked, made.dt)[0], piece)
        if all(np.isfinite(t.seconds) for t in found):
            break
    return found


def control(case: Case, hovering: Subject, model: PhysicsModel) -> Told:
    """What more hovering tells."""
    pilot, dt = model.pilot(), hovering.logs[0].dt
    assert pilot is not None
    asked = np.zeros((1, round(PIECES[-1] / dt) + 1, len(pilot.set_points)))
    asked[..., 2] = 1.0  # m above the ground
    return told(case, hovering, pilot.path(asked, dt)[0], PIECES[-1])


def row(case: Case, cache: Path, scratch: Path) -> tuple[str, ...]:
    """A line of the table: case, first answer, what the design and the stock manoeuvre told, minutes of CPU."""
    begun = time.process_time()
    hovering, _ = measured(case, cache)
    said, model = diagnose(hovering, brief=True)
    if said.verdict != "tie":
        return case.id, answer(said), "no tie", "–", "–", f"{(time.process_time() - begun) / 60:.1f}"
    file = scratch / f"{case.id}.json"
    said.write(file)
    results = [*both(case, hovering, model, file), control(case, hovering, model)]
    return (
        case.id,
        answer(said),
        *(f"{f'{r.seconds:g} s' if np.isfinite(r.seconds) else 'never'}; {r.said}" for r in results),
        f"{(time.process_time() - begun) / 60:.1f}",
    )


def rows(chosen: Sequence[Case], scratch: Path) -> Iterator[tuple[str, ...]]:
    """Lines of the table."""
    for case in chosen:
        yield row(case, cache_folder() / "flights", scratch)


def main() -> None:
    """Write the table, case by case."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--seed", choices=("reported", "development"), default="reported")
    asked.add_argument("--fraction", type=Fraction, default=Fraction(1))
    asked.add_argument("--case", action="append", default=[])
    asked.add_argument("--write", type=Path)
    given = asked.parse_args()
    ties = [c for c in cases(given.seed, False, "first") if c.condition == "tie"]
    chosen = [c for c in part(ties, float(given.fraction)) if not given.case or c.id in given.case]
    words = ["python tests/resolved_ties.py", f"--seed {given.seed}", f"--fraction {given.fraction}"]
    words += [f"--case {c}" for c in given.case]
    lines = [
        "# Ties that a designed flight resolves",
        "",
        f"`{' '.join(words)}`; what was done stands at the head of that file.",
        "",
        "| case | hover says | the design says | the stock manoeuvre says | hovering on says | CPU [min] |",
        "|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as scratch:
        for found in rows(chosen, Path(scratch)):
            print(*found, sep=" | ", flush=True)
            lines.append(f"| {' | '.join(found)} |")
            if given.write:
                given.write.write_text("\n".join(lines) + "\n", encoding="utf-8")
                entered(given.write)


if __name__ == "__main__":
    np.seterr(all="ignore")
    torch.set_num_threads(1)
    main()
