"""A fleet of known vehicles, simulated with SciPy: carts on springs with one hidden effect, two or none.

`python tests/simulated_fleet.py [--vehicles 200] [--workers 2] [--write results/published/fleet.md]` kills the
diagnosis of the fleet in the middle, repeats the command, and says how many vehicles were told right.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from bench.claims.manifest import entered
from bench.fleet.stored import ANSWER, VEHICLES

MASS, DAMPING, STIFFNESS, RATE = 0.5, 0.4, 60.0, 50
"""kg, N s/m, N/m, Hz."""
NOISE = 2e-4, 2e-3
"""1σ of displacement [m] and speed [m/s]."""
CUBIC, DRAG, OFFSET = 400.0, 0.5, 0.4
"""N/m³, kg/m and N of a hidden effect of size 1."""
KINDS = {
    "nothing": {},
    "cubic_stiffness": {"cubic_stiffness": CUBIC},
    "quadratic_drag": {"quadratic_drag": DRAG},
    "offset_force": {"offset_force": OFFSET},
    "two": {"cubic_stiffness": CUBIC, "quadratic_drag": DRAG},
}
"""Hidden effects, each with its parameter at size 1."""
DESCRIPTION = f"""\
name = "cart"
system = "oscillator"
rate_hz = {RATE}
files = "run_*.csv"
time = "t"
input = "force"

[signals]
displacement = {{columns = ["x"], unit = "m"}}
speed = {{columns = ["v"], unit = "m/s"}}
force = {{columns = ["f"], unit = "N"}}

[physics]
mass = {MASS}
damping = {DAMPING}
stiffness = {STIFFNESS}
"""


def vehicle(folder: Path, kind: str, seed: int, size: float = 1.0, recordings: int = 4, seconds: float = 8.0) -> Path:
    """Write the recordings of one cart."""
    random = np.random.default_rng(seed)
    for run in range(recordings):
        recorded(folder, f"run_{run}", kind, random, size, seconds)
    (folder / "dataset.toml").write_text(DESCRIPTION, encoding="utf-8")
    return folder


def recorded(
    folder: Path, name: str, kind: str, random: np.random.Generator, size: float, seconds: float, amplitude: float = 2.0
) -> None:
    """Write one recording of a cart, driven by four tones of a force that is linear between samples."""
    folder.mkdir(parents=True, exist_ok=True)
    t = np.arange(round(seconds * RATE)) / RATE
    tones = 2 * np.pi * random.uniform(0.3, 3.0, 4), random.uniform(0, 6, 4)
    drive = amplitude * sum(np.sin(w * t + p) for w, p in zip(*tones, strict=True))
    hidden = (size * KINDS[kind].get(n, 0.0) for n in ("cubic_stiffness", "quadratic_drag", "offset_force"))
    stiff, drag, offset = hidden

    def rate(at, x):
        own = offset - stiff * x[0] ** 3 - drag * abs(x[1]) * x[1]
        return x[1], (np.interp(at, t, drive) - DAMPING * x[1] - STIFFNESS * x[0] + own) / MASS

    x = solve_ivp(rate, (0, t[-1]), (0.0, 0.0), t_eval=t, max_step=0.01, rtol=1e-7, atol=1e-9).y.T
    x = x + random.normal(size=x.shape) * NOISE
    table = np.column_stack([t, x, drive])
    np.savetxt(folder / f"{name}.csv", table, "%.9g", ",", header="t,x,v,f", comments="")


def write(folder: Path, count: int) -> dict[str, tuple[str, float]]:
    """Write a fleet of all kinds in turn; by vehicle its kind and the size of what it hides, .8 to 1.2."""
    random, made = np.random.default_rng(20), {}
    for i in range(count):
        kind, size = list(KINDS)[i % len(KINDS)], float(random.uniform(0.8, 1.2))
        vehicle(folder / f"cart_{i:03}", kind, 1000 + i, size)
        made[f"cart_{i:03}"] = kind, size
    return made


def answers(folder: Path) -> dict[str, int]:
    """When each answer that is kept was written [ns], by vehicle."""
    return {p.parent.name: p.stat().st_mtime_ns for p in (folder / "diagnosis" / VEHICLES).glob(f"[!.]*/{ANSWER}")}


def diagnosed(folder: Path, workers: int) -> dict[str, int]:
    """Diagnose a fleet, killed when half is done, then by the same command again; what was kept at the kill."""
    command = [sys.executable, "-m", "bench", "diagnose", str(folder), "--workers", str(workers), "--no-track"]
    count = sum(1 for _ in folder.glob("*/dataset.toml"))
    driver = subprocess.Popen(command)
    while len(answers(folder)) < count / 2 and driver.poll() is None:
        time.sleep(0.05)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    kept = answers(folder)
    subprocess.run(command, check=True)
    return kept


def judged(folder: Path, truth: dict[str, tuple[str, float]]) -> list[str]:
    """The lines of a report."""
    told = json.loads((folder / "diagnosis" / "fleet.json").read_text(encoding="utf-8"))
    right, within, numbers, wrong = 0, 0, 0, []
    for answer in told["vehicles"]:
        kind, size = truth[answer["vehicle"]]
        hidden = KINDS[kind]
        named = {n["effect"]: n for n in answer["numbers"]}
        if set(named) == set(hidden) and answer["verdict"] == ("named" if hidden else "nothing"):
            right += 1
            numbers += len(hidden)
            within += sum(named[e]["low"] <= size * v <= named[e]["high"] for e, v in hidden.items())
        else:
            wrong.append(f"{answer['vehicle']}: hides {kind}, told {answer['verdict']} {', '.join(named)}".rstrip())
    count = len(told["vehicles"])
    lines = [f"- Told right: {right} of {count} ({right / count:.1%})."]
    lines += [f"- True values within their 95 % interval: {within} of {numbers} ({within / numbers:.0%})."]
    for q in told["quantities"]:
        sizes = [size for kind, size in truth.values() if q["effect"] in KINDS[kind]]
        true = np.array(sizes) * {**KINDS["two"], **KINDS["offset_force"]}.get(q["effect"], np.nan)
        lines.append(
            f"- {q['effect']} {q['parameter']}: mean {q['mean']:.4g} {q['unit']} ({q['low']:.4g} to {q['high']:.4g}), "
            f"spread between vehicles {q['between']:.3g}; true {true.mean():.4g} and {true.std(ddof=1):.3g}."
        )
    return lines + [f"- Wrong: {line}." for line in wrong]


def main() -> None:
    """Simulate, diagnose, judge, print and write."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--vehicles", type=int, default=200)
    asked.add_argument("--workers", type=int, default=os.cpu_count())
    asked.add_argument("--write", type=Path)
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "carts"
        truth, started = write(folder, given.vehicles), time.monotonic()
        left = diagnosed(folder, given.workers)
        minutes, now = (time.monotonic() - started) / 60, answers(folder)
        again = sum(now[name] != when for name, when in left.items())
        command = f"python tests/simulated_fleet.py --vehicles {given.vehicles} --workers {given.workers}"
        text = ["# A fleet of which the truth is known", "", f"`{command} --write results/published/fleet.md`", ""]
        text += [
            f"{given.vehicles} carts on springs; hidden, in turn: {', '.join(KINDS)}; the size of "
            "each effect drawn from .8 to 1.2 of its nominal one.",
            "",
            f"- The driver was killed (SIGKILL) with {len(left)} answers kept; the same command did {again} of them "
            f"again. {minutes:.0f} minutes in all with {given.workers} process(es), beside other work.",
            *judged(folder, truth),
        ]
    print("\n".join(text))
    if given.write:
        given.write.write_text("\n".join(text) + "\n", encoding="utf-8")
        entered(given.write)


if __name__ == "__main__":
    main()
