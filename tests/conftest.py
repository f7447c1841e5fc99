"""A small data set of a known system, registered as a plug-in would register its own."""

import logging
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from click.testing import CliRunner

from bench.claims.manifest import entered
from bench.cli import cli, main
from registry.contracts import Channel, Dataset, Recording, RecordingSet, Split
from registry.core import DATASETS, option

Typed = Callable[..., tuple[int, str, str]]
"""A command with its arguments → exit code, stdout, stderr."""
CHROMIUM, DRIVER = shutil.which("chromium") or shutil.which("chromium-browser"), shutil.which("chromedriver")
FLAGS = (
    "--headless=new --no-sandbox --disable-gpu --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --window-size=1600,1200"
)


@DATASETS.register("toy")
@dataclass(frozen=True)
class Toy(Dataset):
    """Three coupled, damped, driven rates; for tests."""

    inputs: ClassVar[tuple[str, ...]] = ("pilot",)
    targets: ClassVar[tuple[str, ...]] = ("euler_rates",)

    recordings: int = option(5, "recordings", low=3)
    samples: int = option(400, "samples of each", low=50)

    def read(self) -> RecordingSet:
        made = []
        for i in range(self.recordings):
            rng = np.random.default_rng(i)
            drive = rng.normal(size=(self.samples + 20, 4))
            u = np.stack([np.convolve(d, np.ones(20) / 20, "valid")[: self.samples] for d in drive.T], 1)
            mix = np.array([[1.0, 0.2, 0, 0], [0, 1.0, 0.3, 0], [0.1, 0, 1.0, 0.5]])
            y = np.zeros((self.samples, 3))
            for k in range(1, self.samples):
                y[k] = 0.95 * y[k - 1] + 0.2 * np.tanh(mix @ u[k]) - 0.02 * y[k - 1] ** 3
            made.append(
                Recording(
                    f"toy_{i}",
                    100.0,
                    u,
                    y,
                    tuple(Channel(f"pilot.{a}", "1") for a in ("aileron", "elevator", "rudder", "collective")),
                    tuple(Channel(f"euler_rates.{a}", "rad/s") for a in ("roll", "pitch", "yaw")),
                    np.ones(self.samples, bool),
                )
            )
        return RecordingSet(tuple(made), ())

    def split(self, names: Sequence[str]) -> Split:
        return Split(tuple(names[:-2]), (names[-2],), (names[-1],))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--faults-table", metavar="FILE", help="Write what the fault tests killed, and what was lost.")
    parser.addoption("--kills", metavar="N", type=int, default=0, help="Kills at random moments, instead of a few.")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Where the header would not be seen: `-q` leaves it out."""
    from fuzz.inputs import FACTOR, SEED

    if FACTOR:
        terminalreporter.write_line(f"fuzzing: {FACTOR:g} times the inputs, BENCH_FUZZ_SEED={SEED}")


@pytest.fixture(scope="session")
def faults(request: pytest.FixtureRequest) -> Iterator[Callable[..., None]]:
    """Enters a row: what was hit, how often, results lost, results damaged, what was done again.

    Rows of tests that were not run stay as the table has them.
    """
    rows: dict[str, tuple[str, ...]] = {}
    yield lambda *row: rows.update({row[0]: tuple(map(str, row))})
    target = request.config.getoption("--faults-table", None)
    if target and rows:
        path = Path(target)
        lines = path.read_text().splitlines() if path.is_file() else []
        before = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")]
        rows = {row[0]: tuple(row) for row in before[2:]} | rows
        head = ("what was hit", "times", "finished results lost", "damaged", "done again")
        lines = [" | ".join(("", *row, "")).strip() for row in (head, ("---",) * len(head), *sorted(rows.values()))]
        command = "tox -e cluster -- --kills 200 --faults-table results/published/faults.md"
        path.write_text("\n".join(["# What dies, and what is lost", "", f"`{command}`", "", *lines, ""]))
        entered(path)


@pytest.fixture(scope="session")
def bench_data() -> Path:
    """The folder of real recordings; the test is skipped where there is none."""
    folder = Path(os.environ.get("BENCH_DATA", ""))
    if not os.environ.get("BENCH_DATA") or not folder.is_dir():
        pytest.skip("BENCH_DATA names no folder of real recordings")
    return folder


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    """Chromium without a window, driven; the test is skipped where there is none."""
    if not (CHROMIUM and DRIVER):
        pytest.skip("needs Chromium and chromedriver")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in [*FLAGS.split(), f"--user-data-dir={tmp_path / 'profile'}"]:
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def command(*arguments: object) -> str:
    """What `bench` with these arguments prints.

    Raises:
        Exception: what the command raises, a `BenchError` where it refuses.
    """
    done = CliRunner().invoke(cli, list(map(str, arguments)))
    if done.exception is not None:
        raise done.exception
    return done.output


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Typed]:
    """`bench` as a user types it, in this process."""
    log = logging.getLogger("registry")
    handlers, level = list(log.handlers), log.level
    for name in ("OMP_NUM_THREADS", "PYTHONSAFEPATH"):
        monkeypatch.setenv(name, "1")

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["bench", *map(str, arguments)])
        capsys.readouterr()
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        return code, *capsys.readouterr()

    yield run
    log.handlers[:] = handlers
    log.setLevel(level)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder for simulated flights."""
    return tmp_path_factory.mktemp("flights")
