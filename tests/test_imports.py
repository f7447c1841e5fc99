"""What importing and asking costs: names, help and lists come from sources, with nothing heavy imported."""

import os
import pkgutil
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import bench.cli.commands
from bench.execution.executor import run_jobs
from bench.experiment import study
from registry import outline
from registry.core import REGISTRIES, Registry
from registry.errors import BenchError

HEAVY = ("torch", "pandas", "mlflow", "optuna", "scipy", "matplotlib", "seaborn", "pyarrow", "distributed")
LIST_LOADED = f"print('loaded:', *(m for m in {HEAVY} if m in sys.modules), file=sys.stderr)"


def python(code: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Another interpreter; a variable that is given as empty is not set there."""
    env = {k: v for k, v in {**os.environ, **environment}.items() if v}
    command = [sys.executable, "-c", f"import atexit, sys\natexit.register(lambda: {LIST_LOADED})\n{code}", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=env, timeout=120)


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("--help", "bench diagnose flights/"),
        ("list", "washout_vs_mlp"),
        ("list effects", "rotor_drag"),
        ("list effects --system oscilator", "did you mean oscillator"),
        ("list studies", "washout_vs_mlp"),
        ("rnu", "did you mean run"),
        ("run washout_vs_mpl", "did you mean washout_vs_mlp"),
        ("run 'LSTN: 1x50 - MLP: 60x10'", "did you mean LSTM"),
        ("run constant --dataset nanodron", "did you mean nanodrone"),
        ("sweep washout_vs_mpl", "did you mean washout_vs_mlp"),
        ("show LSTN", "did you mean LSTM"),
        ("data inspect nanodron", "did you mean nanodrone"),
        ("diagnose no/such/folder", "does not exist"),
        ("diagnose pelican_twin --system oscilator", "did you mean oscillator"),
        ("diagnose pelican_twin --system mine.py:Class", "mine.py does not exist"),
        ("discover pelican_twin --catalogue rotor_drg", "did you mean rotor_drag"),
        ("extend pelican_twin --add rotor_drg", "did you mean rotor_drag"),
        *((f"{name} --help", f" {name} ") for name in ("run", "sweep", "check", "report", "data", "runs", "diagnose")),
    ],
)
def test_the_command_line_answers_without_loading_what_is_heavy(command: str, says: str) -> None:
    done = python("from bench.cli import main; main()", *shlex.split(command))
    assert says in done.stdout + done.stderr
    assert done.stderr.splitlines()[-1] == "loaded:"


def test_claims_are_judged_without_what_trains(tmp_path: Path) -> None:
    """The published evidence is read and judged; torch alone takes longer to import."""
    done = python("from bench.cli import main; main()", "check", "--claim", "lstm-at-once", "--results", str(tmp_path))
    assert "reproduced" in done.stdout, done.stderr
    assert not {"torch", "mlflow", "matplotlib", "distributed"} & set(done.stderr.splitlines()[-1].split())


def test_no_command_module_loads_what_is_heavy() -> None:
    names = [m.name for m in pkgutil.iter_modules(bench.cli.commands.__path__, "bench.cli.commands.")]
    assert len(names) > 10
    assert python(f"import {', '.join(names)}").stderr == "loaded:\n"


def test_importing_bench_does_nothing_else() -> None:
    code = "import os; before = dict(os.environ); import bench; print(dict(os.environ) == before)"
    done = python(code, OMP_NUM_THREADS="")
    assert done.stdout == "True\n" and done.stderr == "loaded:\n"


@pytest.mark.parametrize(("asked", "threads"), [("", "1"), ("2", "2")])
def test_a_command_has_one_thread_unless_asked(asked: str, threads: str) -> None:
    code = "from bench.cli import main; main(); import torch; print('threads', torch.get_num_threads())"
    assert f"threads {threads}\n" in python(code, "--version", OMP_NUM_THREADS=asked).stdout


def test_a_worker_has_one_thread_unless_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    job = ("threads", os.getenv, ("OMP_NUM_THREADS",))
    assert list(run_jobs(iter([job]), 2, print, str)) == [("threads", "1")]
    assert "OMP_NUM_THREADS" not in os.environ


@pytest.mark.parametrize("kind", REGISTRIES)
def test_sources_tell_what_loading_tells(kind: str) -> None:
    registry = REGISTRIES[kind]
    fresh = Registry(registry.kind, registry.package)
    read = fresh.outline()
    assert not fresh._loaded
    own = [n for n in registry.names() if registry.get(n).__module__.startswith("registry.")]  # other tests file toys
    assert list(read.items()) == [(name, registry.summary(name)) for name in own]


def test_the_sources_of_studies_tell_what_loading_tells() -> None:
    assert study.titles() == {name: s.title for name, s in study.studies().items()}


def test_a_plug_in_that_its_source_does_not_tell_is_loaded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plain = "from registry.core import {0}\n@{0}.register('{1}')\nclass A: 'First line.'\n"
    assert outline.registered(plain.format("EFFECTS", "kite"), "EFFECTS") == {"kite": "First line."}
    assert outline.registered(plain.format("EFFECTS as E", "kite").replace("@EFFECTS as E", "@E"), "EFFECTS") == {}
    (tmp_path / "kite_plugin.py").write_text(
        "from dataclasses import dataclass\nfrom registry.core import INITIALIZERS as entries\n"
        "@entries.register('Kite')\n@dataclass(frozen=True)\nclass Kite:\n    'Told by loading.'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from importlib.metadata import EntryPoint

    registry = REGISTRIES["initializers"]
    point = EntryPoint("kite", "kite_plugin", registry.group)
    monkeypatch.setattr("registry.core.entry_points", lambda group: [point] if group == registry.group else [])
    monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    monkeypatch.setattr(registry, "_loaded", False)
    monkeypatch.setattr("registry.outline.modules", lambda package: iter(()))
    assert registry.outline()["Kite"] == "Told by loading."
    registry.check("kite")
    with pytest.raises(BenchError, match="did you mean Kite"):
        registry.check("Kit")
