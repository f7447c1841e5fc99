"""Modules of every imported name lie where a command is typed and among the data: none of them is run."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from faults.test_cluster import free_port

OWN = ("bench", "registry", "studies")
TOML = """
name = "spring"
system = "oscillator"
rate_hz = 50
files = "*.csv"
time = "t"
input = "force"
[signals]
displacement = {columns = ["x"], unit = "m"}
speed = {columns = ["v"], unit = "m/s"}
force = {columns = ["f"], unit = "N"}
[physics]
mass = 1.0
stiffness = 4.0
damping = 0.3
"""
SPEC = "LSTM: 1x4 - MLP: 4x10"
SMALL = ("-T", "5", "--outputs", "speed", "--set", "training.updates=6", "--set", "training.evaluate_every=3")


def spring(folder: Path) -> None:
    """Four recordings of a damped spring, integrated in small steps."""
    (folder / "dataset.toml").write_text(TOML)
    for i in range(4):
        push = np.convolve(np.random.default_rng(i).normal(size=330), np.ones(31) / 6, "valid")
        x, rows = np.zeros(2), []
        for k, force in enumerate(push):
            rows.append((k / 50, *x, force))
            for _ in range(20):
                x = x + 1e-3 * np.array([x[1], force - 4 * x[0] - 0.3 * x[1]])
        pd.DataFrame(rows, columns=["t", "x", "v", "f"]).to_csv(folder / f"r{i}.csv", index=False)


class Hostile:
    """A folder with data and a module of every name that Python could look for; each leaves its name when run."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.ran = folder / "flights", folder / "ran"
        self.script = folder / "bin" / "bench"
        self.folder.mkdir(parents=True)
        self.script.parent.mkdir()
        self.script.write_text("from bench.cli import main\nif __name__ == '__main__':\n    main()\n")
        names = {*sys.stdlib_module_names, *packages_distributions(), *OWN, "usercustomize", "matplotlibrc"}
        for name in sorted(n for n in names if n.isidentifier()):
            code = f"open({str(self.ran)!r}, 'a').write({name!r} + ' ')\n"
            (self.folder / f"{name}.py").write_text(code)
        (self.folder / "matplotlibrc").write_text("text.usetex: True\nbackend: module://matplotlibrc\n")
        (self.folder / ".env").write_text(f"PYTHONPATH={self.folder}\n")
        spring(self.folder)

    def start(self, *arguments: str) -> "subprocess.Popen[str]":
        root = Path(__file__).parents[2]
        command = [sys.executable, *([str(self.script)] if self.script.exists() else ["-m", "bench"]), *arguments]
        environment = {**os.environ, "PYTHONPATH": str(root), "BENCH_DATA": ""}
        environment.pop("PYTHONSAFEPATH", None)
        pipe = subprocess.PIPE
        return subprocess.Popen(command, cwd=self.folder, env=environment, stdout=pipe, stderr=pipe, text=True)

    @contextmanager
    def serving(self, *arguments: str, says: str) -> Iterator[None]:
        process = self.start(*arguments)
        try:
            assert process.stdout is not None and says in process.stdout.readline()
            yield
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)
        self.nothing_ran(arguments)

    def bench(self, *arguments: str, status: int = 0) -> str:
        with self.start(*arguments) as process:
            said, trouble = process.communicate(timeout=600)
        assert process.returncode == status, said + trouble
        self.nothing_ran(arguments)
        return said

    def nothing_ran(self, by: Sequence[str]) -> None:
        assert not self.ran.exists(), f"{by}: {self.ran.read_text()}"


def test_neither_the_script_nor_the_module_imports_what_lies_where_it_is_typed(tmp_path: Path) -> None:
    hostile = Hostile(tmp_path)
    assert "4 recordings, 24.0 s in all at 50 Hz" in hostile.bench("data", "check", ".")
    description = hostile.folder / "dataset.toml"
    for name in ("numpy.py:Spring", "numpy:Spring"):  # data do not name code
        description.write_text(TOML.replace("oscillator", name))
        hostile.bench("data", "check", ".", status=2)
    shutil.rmtree(hostile.script.parent)  # `python -m bench` from here on
    for name in OWN:  # whoever types -m names a package: one of that name in the folder would be meant
        (hostile.folder / f"{name}.py").unlink()
    assert "LSTM" in hostile.bench("list")


@pytest.mark.faults
def test_no_command_runs_what_lies_in_the_folder(tmp_path: Path) -> None:
    hostile = Hostile(tmp_path)
    run = ("run", SPEC, "--dataset", ".", *SMALL)
    hostile.bench(*run, "--seeds", "2", "--workers", "2")
    key = hostile.bench("runs", "list").split("LSTM")[0].split()[-1]
    hostile.bench("runs", "show", key)
    hostile.bench("report", SPEC, "-o", "page.html")
    hostile.bench("export", SPEC, "-o", "study.zip")
    hostile.bench("import", "study.zip", "--results", "other")
    hostile.bench("sync")
    hostile.bench("diagnose", ".")
    hostile.bench("sweep", SPEC, "--dataset", ".", *SMALL, "--trials", "2", "--workers", "2")
    hostile.bench("check", "--claim", "body-rates-level")
    hostile.bench("speed", "--only", "LSTM 1x50, T 40, B 64", "--quick")
    (hostile.folder / "model.toml").write_text('system = "numpy.py:Spring"\n[physics]\nmass = 1.0\n')
    hostile.bench("compare", ".", "--model", "model.toml", status=2)
    hostile.bench("run", SPEC, "--dataset", ".", "--dry-run")


@pytest.mark.faults
def test_neither_the_page_nor_a_cluster_runs_what_lies_in_the_folder(tmp_path: Path) -> None:
    hostile, port = Hostile(tmp_path), free_port()
    with hostile.serving("cluster", "start", "--workers", "2", "--port", str(port), says="Scheduler"):
        hostile.bench("run", SPEC, "--dataset", ".", *SMALL, "--seeds", "2", "--cluster", f"tcp://127.0.0.1:{port}")
    with hostile.serving("ui", "--port", str(free_port()), says="Charts: http"):
        pass
