"""What the documents say is true: every block of code in them runs, or names commands and options that exist."""

import re
import shlex
import subprocess
import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import matplotlib
import pytest
import torch
from click.testing import CliRunner

from bench.cli import cli
from registry.contracts import Problem
from registry.core import DATASETS, EFFECTS, PREDICTORS, Registry
from registry.datasets.folder.dataset import Folder
from registry.effects.rotor import RotorDrag
from registry.physics.quadrotor import Quadrotor

ROOT = Path(__file__).parent.parent
PAGES = sorted((ROOT / "docs").rglob("*.md"))
FENCE = re.compile(
    r"(?P<only> *<!-- parsed only -->\n)?^(?P<indent> *)```(?P<kind>\w+)?(?: title=\"(?P<title>[^\"]+)\")?\n"
    r"(?P<text>.*?)^ *```$",
    re.S | re.M,
)
matplotlib.use("Agg")


@dataclass(frozen=True)
class Block:
    """A block of code of a document."""

    kind: str
    title: str
    text: str
    runs: bool


def blocks(page: Path) -> Iterator[Block]:
    """In order; a block after "parsed only" is too long, or needs what is not here."""
    for found in FENCE.finditer(page.read_text(encoding="utf-8")):
        lines = [line.removeprefix(found["indent"]) for line in found["text"].splitlines()]
        yield Block(found["kind"] or "", found["title"] or "", "\n".join(lines) + "\n", not found["only"])


def saved(title: str) -> str:
    """The block that a how-to says to save under this name."""
    (text,) = [b.text for page in PAGES for b in blocks(page) if b.title == title]
    return text


def masked(text: str) -> str:
    """Without spaces, and with every number the same: other processors round otherwise."""
    return re.sub(r"[\d.,×⁻⁰¹²³⁴-⁹−]+", "#", "".join(text.split()))


def says(shown: str, expected: str) -> None:
    """Every line that a document shows was printed."""
    for line in filter(None, map(str.strip, expected.splitlines())):
        assert masked(line) in masked(shown), f"{line!r} is not in:\n{shown}"


def commands(text: str) -> Iterator[list[str]]:
    """The lines of a shell block that are commands of ours."""
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        if words and words[0] == "bench":
            yield words[1:]


def parse(command: click.Command, words: list[str]) -> None:
    """Raise `click.UsageError` where a command, an option or a choice does not exist; a path need not be there."""
    context = command.make_context(command.name, list(words), resilient_parsing=True)
    if isinstance(command, click.Group):
        assert words, f"{command.name} names no command"
        name, found, rest = command.resolve_command(context, words)
        assert found is not None, name
        parse(found, rest)
        return
    values, rest, _ = command.make_parser(context).parse_args(args=list(words))
    assert not rest, f"{command.name} does not take {rest}"
    for option in command.params:
        given = values.get(option.name)
        if isinstance(option.type, click.Path) or given is None:
            continue
        for value in given if isinstance(given, (list, tuple)) else [given]:
            option.type.convert(value, option, context)


# ------------------------------------------------------------------------------------------------ every page


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=lambda p: p.stem)
def test_every_command_exists_with_its_options(page: Path) -> None:
    for block in blocks(page):
        for words in commands(block.text) if block.kind in ("sh", "") else ():
            parse(cli, words)
    assert "bench" in page.read_text()


def test_a_command_that_does_not_exist_is_seen() -> None:
    for wrong in ("rnu x", "run x --sed 3", "run x --preset huge", "data chekc x", "compare a b"):
        with pytest.raises((click.UsageError, AssertionError)):
            parse(cli, wrong.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the documents are followed, with the recordings that the tutorial writes."""
    made = tmp_path_factory.mktemp("documents")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        exec(compile(next(blocks(ROOT / "docs/tutorial.md")).text, "tutorial.md", "exec"), {})
    return made


HERE = [p for p in PAGES if p.name not in ("own-predictor.md", "own-effect.md", "own-study.md", "own-data-set.md")]


@pytest.mark.parametrize("page", sorted(HERE, key=lambda p: p.name != "tutorial.md"), ids=lambda p: p.stem)
def test_every_block_runs_and_prints_what_is_shown(
    page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    module = types.ModuleType("rolling")
    monkeypatch.setitem(sys.modules, "rolling", module)
    printed = ""
    for block in blocks(page):
        if block.kind == "python" and block.runs:
            if "class " in block.text:
                (folder / "rolling.py").write_text(block.text)
            exec(compile(block.text, page.name, "exec"), module.__dict__)
            printed = capsys.readouterr().out
        elif block.kind == "sh" and block.runs:
            printed = ""
            for words in commands(block.text):
                if words[:2] == ["data", "init"]:
                    (folder / "spring/dataset.toml").rename(folder / "complete.toml")
                done = CliRunner().invoke(cli, words, catch_exceptions=False)
                assert done.exit_code == 0, done.output
                printed += done.output
                if words[:2] == ["data", "init"]:
                    (folder / "complete.toml").replace(folder / "spring/dataset.toml")
        elif block.kind == "text":
            says(printed, block.text)


@pytest.mark.slow
def test_the_controller_flies_better_with_the_effects() -> None:
    pytest.importorskip("casadi", reason="CasADi is not installed: the extra `export`")
    found: dict[str, Any] = {"__name__": "mpc"}
    exec(compile(saved("mpc.py"), "mpc.py", "exec"), found)
    errors = {drag: found["fly"](Quadrotor(effects=(RotorDrag(k_d=drag),)), 45)[-1] for drag in (0.0, 8.0e-5)}
    assert errors[8.0e-5] < 0.1 * errors[0.0] < 2e-3


def test_the_dataset_toml_of_the_reference_is_right(tmp_path: Path) -> None:
    from registry.datasets.folder.description import describe
    from registry.datasets.folder.signals import FRAMES

    text = (ROOT / "docs/reference/dataset-toml.md").read_text()
    vehicle, process = [b for b in blocks(ROOT / "docs/reference/dataset-toml.md") if b.kind == "toml"]
    (tmp_path / "dataset.toml").write_text(vehicle.text)
    assert describe(tmp_path).signals["rotor_speed"].delay == 0.012
    (tmp_path / "dataset.toml").write_text(process.text)
    named = [c.name for c in Folder(str(tmp_path)).recorded]
    assert named == ["flow_l_min.acid", "flow_l_min.base", "heater", "ph", "temperature"]
    assert (Folder(str(tmp_path)).predicted(), describe(tmp_path).tick) == (("ph",), 1e-3)
    for signal, frames in FRAMES.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{signal}` | `") and frames[0] in line]
        assert re.findall(r"`(\w+)`", row) == [signal, *frames]


# ------------------------------------------------------------------------------------------------ what is to be saved


TITLES = [b.title for page in PAGES for b in blocks(page) if b.title.endswith(".py")]


@pytest.mark.parametrize("title", TITLES)
@pytest.mark.parametrize("gate", ["check", "format --check"])
def test_what_is_to_be_saved_passes_the_gates(title: str, gate: str) -> None:
    pytest.importorskip("ruff", reason="comes with the development tools")
    command = [sys.executable, "-m", "ruff", *gate.split(), "--no-cache", "--stdin-filename", title, "-"]
    done = subprocess.run(command, cwd=ROOT, input=saved(title), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def execute(registry: Registry, name: str, title: str, monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """A module made of a block, as if it had been saved; it may have been, and registers the name anew."""
    registry.names()  # loads them: what is restored afterwards is all of them
    monkeypatch.setattr(registry, "_entries", {k: v for k, v in registry._entries.items() if k != name})
    module = types.ModuleType(title.removesuffix(".py").replace("/", "."))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(saved(title), title, "exec"), module.__dict__)
    return module


def test_the_predictor_works(monkeypatch: pytest.MonkeyPatch) -> None:
    execute(PREDICTORS, "drift", "registry/predictors/drift.py", monkeypatch)
    predictor = PREDICTORS.get("drift")(fade=0.5).build(Problem.plain(1, 1, 3, 10))
    state = predictor.init_buffers(torch.zeros(1, 10, 1), torch.arange(10.0).reshape(1, 10, 1))
    assert predictor(torch.zeros(1, 3, 1), state).flatten().tolist() == [9.5, 9.75, 9.875]


def test_the_effect_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    execute(EFFECTS, "tether", "registry/effects/tether.py", monkeypatch)
    found: dict[str, Any] = {}
    exec(compile(saved("tests/physics/test_tether.py"), "test_tether.py", "exec"), found)
    conformance = found["TestTether"]()
    names = [name for name in dir(conformance) if name.startswith("test_")]
    assert len(names) > 3
    for name in names:
        getattr(conformance, name)()


def test_the_study_is_one() -> None:
    found: dict[str, Any] = {}
    exec(compile(saved("studies/gru_vs_lstm.py"), "gru_vs_lstm.py", "exec"), found)
    made = found["STUDY"].runs("laptop", DATASETS.get("helicopter_twin")())
    assert [(r.spec, r.seed) for r in made] == [
        *(("GRU: 1x50 - MLP: 60x10", s) for s in range(3)),
        *(("LSTM: 1x50 - MLP: 60x10", s) for s in range(3)),
        ("linear", 0),
    ]


def test_the_data_set_with_a_signal_of_its_own_is_predicted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import bench

    execute(DATASETS, "heated_room", "registry/datasets/heated_room.py", monkeypatch)
    table = bench.run("linear", "heated_room", horizon=5, results=tmp_path).to_frame()
    assert set(table.unit) == {"K"}
    errors = table.set_index("spec").rmsse
    assert errors["linear"] < 0.1 * errors["constant"]  # a first-order system is linear


# ------------------------------------------------------------------------------------------------ README


def test_ci_runs_the_test_command_of_the_readme() -> None:
    command = re.search(r"^\((python3 -m venv .*)\) 2>&1", (ROOT / ".ci/run").read_text(), re.M)
    assert command and command[1] in (ROOT / "README.md").read_text()


def test_the_readme_is_short_and_names_what_exists() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 100
    for page in (text, (ROOT / "CONTRIBUTING.md").read_text()):
        for link in re.findall(r"\]\((?!https?:)([^)#]+)", page):
            assert (ROOT / link).exists(), link
    for file in re.findall(r"`((?:bench|registry|studies|tests)/[\w/]+\.\w+)`", (ROOT / "CONTRIBUTING.md").read_text()):
        assert (ROOT / file).exists(), file


def test_the_python_of_the_readme_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (block,) = [b for b in blocks(ROOT / "README.md") if b.kind == "python"]
    monkeypatch.chdir(folder)
    exec(compile(block.text.replace("my_flights", "spring"), "README.md", "exec"), {})
    assert "cubic_stiffness" in capsys.readouterr().out
