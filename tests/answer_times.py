"""How long an answer takes where no effect of the catalogue is hidden: `python tests/answer_times.py`.

One case of each kind of the suite of unknown effects that a vehicle can have (`bench score-discovery --chain unknown`,
development seed), as six flights of 30 s at 100 Hz, each diagnosed by a process of its own while nothing else runs.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from bench.score import chains
from bench.score.unknown.condition import EMPTY, UnknownCase
from bench.score.unknown.suite import DEVELOPMENT, cases
from bench.speed.diagnosis import cost

RECORDINGS, SECONDS = 6, 30.0


def chosen() -> list[UnknownCase]:
    """The first case of each kind in which something is hidden from a vehicle."""
    first: dict[str, UnknownCase] = {}
    for case in cases(DEVELOPMENT):
        if case.system == "quadrotor" and case.condition not in EMPTY:
            first.setdefault(case.condition, replace(case, recordings=RECORDINGS, seconds=SECONDS))
    return list(first.values())


def main() -> None:
    """Print a row a case as it ends."""
    print("| hidden | time [s] | CPU [s] | memory [MiB] | said |\n|---|---|---|---|---|")
    for case in chosen():
        with tempfile.TemporaryDirectory() as kept:
            folder = Path(kept, case.id)
            chains.write_folder(case, folder, Path(kept, "flights"))
            took = cost(folder, case.recordings, case.recordings * round(case.seconds * case.rate))
        said = ", ".join(took.effects) or "nothing"
        print(f"| {case.condition} | {took.wall_s:.0f} | {took.cpu_s:.0f} | {took.peak_mb:.0f} | {said} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
