"""A case of the unknown as a user would bring it: CSV files, a dataset.toml and, at need, a system of one's own."""

import hashlib
import json
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject
from bench.score import trial
from bench.score.logs import as_case, written_once
from bench.score.unknown import machines, rotorcraft
from bench.score.unknown.condition import UnknownCase

OWN = "cart.py"
"""The file in a folder of the cart that holds its class."""
AXES = {"upper_level": "h", "level": "h", "place": "x", "tilt": "theta", "pace": "x", "tilt_rate": "theta"}


def write(case: UnknownCase, path: Path) -> None:
    """Simulate ``case`` and write its folder."""
    if case.system == "quadrotor":
        trial.write_logs(case, rotorcraft.logs(case), path)
        return
    path.mkdir(parents=True, exist_ok=True)
    machine, logs = machines.MACHINES[case.system], machines.logs(case)
    for i, log in enumerate(logs):
        np.savetxt(
            path / f"run_{i}.csv",
            np.column_stack(list(log.values())),
            fmt="%.9g",
            delimiter=",",
            header=",".join(log),
            comments="",
        )
    lines = [f'name = "{case.system}"']
    lines += [] if case.system == "cart" else [f'system = "{case.system}"']
    lines += [f"rate_hz = {machine.hertz:g}", 'files = "run_*.csv"', 'time = "t"', f'input = "{machine.drive}"']
    lines += ['input_hold = "linear"', "", "[signals]"]
    signals = [(machine.drive, machine.drive_unit), *zip(machine.states, machine.units, strict=True)]
    for name, unit in signals:
        axes = f', axes = ["{AXES[name]}"]' if case.system == "cart" and name in AXES else ""
        lines.append(f'{name} = {{columns = ["{name}"], unit = "{unit}"{axes}}}')
    lines += ["", "[physics]", *(f"{k} = {v!r}" for k, v in machine.constants.items())]
    lines += ["", "[physics.uncertainty]", *(f"{k} = 0.01" for k in machine.constants)]
    (path / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    if case.system == "cart":
        shutil.copy(Path(__file__).with_name(OWN), path / OWN)


def _key(case: UnknownCase) -> str:
    """Of everything that determines the folder, the code included."""
    code = hashlib.sha256(json.dumps(asdict(case), sort_keys=True).encode())
    here = Path(__file__).parent
    names = ("case", "cart", "machines", "rotorcraft", "terms")
    sources = [here / f"{n}.py" for n in names] + sorted((here.parent / "multirotor").glob("*.py"))
    for source in sources:
        code.update(source.read_bytes())
    return code.hexdigest()[:20]


def kept(case: UnknownCase, cache: Path) -> Path:
    """The folder of ``case`` in ``cache``, written on first use."""
    return written_once(Path(cache) / "unknown" / _key(case), lambda path: write(case, path))


def measured(case: UnknownCase, cache: Path) -> Subject:
    """What a user would bring to the diagnosis: the folder, read as any other."""
    path = kept(case, cache)
    found = load(path, f"{path / OWN}:CartPendulum" if case.system == "cart" else None)
    return as_case(found, case.id, case.known)
