"""The commands that find missing physics: their help, one sentence for a mistake, and MLflow's falling error."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from swing import write_swing

from bench.cli import cli
from bench.cli.diagnosing import write_model
from bench.diagnose.result import GroupError
from bench.tracking import track
from registry.datasets.folder.dataset import Folder
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator

COMMANDS = ("compare", "locate", "discover", "extend", "diagnose")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches_with_examples(command: str) -> None:
    shown = CliRunner().invoke(cli, [command, "--help"])
    assert shown.exit_code == 0
    assert shown.output.count(f"bench {command} ") >= 2  # beside the usage line
    for option in ("--system", "--model", "--json"):
        assert option in shown.output


def test_the_overview_teaches_the_loop() -> None:
    shown = CliRunner().invoke(cli, ["--help"]).output
    at = [shown.index(f"bench {command} flights/") for command in COMMANDS[:4]]
    assert at == sorted(at)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two recordings of a swing, described by a dataset.toml."""
    data = tmp_path / "swing"
    write_swing(data, "oscillator")
    return data


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nowhere",), "nowhere (it does not exist) is neither a folder with a dataset.toml nor a data set"),
        (("{folder}/..",), "dataset.toml"),
        (("{folder}", "--system", "oscilator"), "did you mean oscillator"),
        (("{folder}", "--system", "mine.py:Swing"), "the file mine.py does not exist"),
        (("{folder}", "--model", "absent.toml"), "absent.toml does not exist"),
        (("pelican_twinn",), "did you mean pelican_twin"),
        (("{folder}", "--model", "{folder}/dataset.toml"), "dataset.toml is a dataset.toml: give a model.toml"),
        (("{folder}", "--system", "quadrotor"), "force"),
    ],
)
def test_a_mistake_is_one_sentence(command: str, arguments: tuple[str, ...], says: str, folder: Path) -> None:
    given = [a.format(folder=folder) for a in arguments] + (
        ["--add", "viscous_friction"] if command == "extend" else []
    )
    before = sorted(folder.parent.rglob("*"))
    done = CliRunner().invoke(cli, [command, *given])
    assert isinstance(done.exception, BenchError), done.output
    assert says in str(done.exception) and "\n" not in str(done.exception)
    assert sorted(folder.parent.rglob("*")) == before


def test_a_horizon_is_a_number(folder: Path) -> None:
    for value in ("nan", "inf", "0"):
        done = CliRunner().invoke(cli, ["compare", str(folder), "--horizon", value])
        assert done.exit_code == 2 and "--horizon" in done.output


def test_an_effect_is_added_once(folder: Path) -> None:
    twice = ["--add", "viscous_friction"] * 2
    done = CliRunner().invoke(cli, ["extend", str(folder), *twice])
    assert isinstance(done.exception, BenchError) and "is given twice" in str(done.exception)
    assert not (folder / "diagnosis").exists()


def test_what_was_learned_is_not_added_by_its_name(folder: Path) -> None:
    done = CliRunner().invoke(cli, ["extend", str(folder), "--add", "hidden_mode"])
    assert isinstance(done.exception, BenchError) and '"learned" in its place' in str(done.exception)


@pytest.mark.parametrize("command", ["discover", "diagnose"])
def test_an_effect_that_cannot_be_looked_for_is_refused(command: str, folder: Path) -> None:
    done = CliRunner().invoke(cli, [command, str(folder), "--catalogue", "rotor_drag"])
    assert isinstance(done.exception, BenchError)
    assert "--catalogue rotor_drag: it is an effect of quadrotor, not of oscillator" in str(done.exception)
    none = [command, str(folder), "--catalogue", "coulomb_friction", "--without", "coulomb_friction"]
    done = CliRunner().invoke(cli, none)
    assert isinstance(done.exception, BenchError) and "--without leaves no effect" in str(done.exception)


@pytest.mark.parametrize(
    "arguments", [("diagnose", "--out"), ("extend", "--add", "viscous_friction", "--out"), ("discover", "--json")]
)
def test_what_cannot_be_written_is_told_first(
    arguments: tuple[str, ...], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.cli.commands.diagnose.announcer", lambda *_: pytest.fail("work was begun"))
    file = folder / "run_1.csv"
    done = CliRunner().invoke(cli, [arguments[0], str(folder), *arguments[1:], str(file / "below")])
    assert isinstance(done.exception, BenchError) and f"{file} is no folder" in str(done.exception)


def test_a_checked_folder_says_commands_that_run(folder: Path) -> None:
    """Without body rates, the default of quadrotors, the measured states of the system are predicted."""
    said = CliRunner().invoke(cli, ["data", "check", str(folder)]).output
    assert "--outputs" not in said
    assert Folder(path=str(folder)).predicted() == ("displacement", "speed")


def test_a_checked_folder_of_a_machine_says_that_a_sign_is_wrong(folder: Path) -> None:
    """As the diagnosis would, which stops there; exit code 2, so that scripts stop too."""
    file = folder / "dataset.toml"
    described = file.read_text(encoding="utf-8")
    assert '["v"]' in described
    file.write_text(described.replace('["v"]', '["-v"]'), encoding="utf-8")
    said = CliRunner().invoke(cli, ["data", "check", str(folder)])
    assert said.exit_code == 2 and "WRONG: " in said.output and "swapped sign" in said.output


@pytest.mark.parametrize(
    "arguments",
    [
        ("discover", "--catalogue", "viscous_frction"),
        ("diagnose", "--without", "viscous_frction"),
        ("extend", "--add", "viscous_frction"),
    ],
)
def test_an_unknown_effect_names_the_near_ones(arguments: tuple[str, ...], folder: Path) -> None:
    done = CliRunner().invoke(cli, [arguments[0], str(folder), *arguments[1:]])
    assert isinstance(done.exception, BenchError) and "did you mean viscous_friction" in str(done.exception)


def test_every_extension_is_a_run_that_draws_the_fall(tmp_path: Path) -> None:
    uri = track.default_uri(tmp_path)

    def by_group(x: float) -> dict[str, GroupError]:
        return {"velocity": GroupError(0.5, x, "m/s")}

    errors = {0: by_group(0.4), 1: by_group(0.2), 2: by_group(0.1)}
    known = {"rotor_drag.k_d": 1.2e-4}
    for _ in range(2):  # the same effects again replace the run
        track.log_extension(uri, "swing", ["rotor_drag"], {s: errors[s] for s in (0, 1)}, by_group(0.05), known)
    last = track.log_extension(uri, "swing", ["rotor_drag", "mass"], errors, by_group(0.05), known)
    with sqlite3.connect(tmp_path / "mlflow.db") as database:

        def rows(query: str, *values: str) -> list[tuple]:
            return database.execute(query, values).fetchall()

        assert rows("SELECT name FROM experiments WHERE name LIKE 'diagnosis%'") == [("diagnosis: swing",)]
        alive = rows("SELECT name FROM runs WHERE lifecycle_stage = 'active' ORDER BY name")
        assert alive == [("1: rotor_drag",), ("2: rotor_drag, mass",)]
        curve = "SELECT step, value FROM metrics WHERE run_uuid = ? AND key = ? ORDER BY step"
        assert rows(curve, last, "falling_error/velocity m per s") == [(0, 0.4), (1, 0.2), (2, 0.1)]
        assert rows(curve, last, "velocity over floor") == [(0, 2.0)]
        assert rows("SELECT value FROM params WHERE run_uuid = ?", last) == [("0.00012",)]


def test_a_model_that_was_there_is_kept(tmp_path: Path) -> None:
    target, model = tmp_path / "model.toml", Oscillator()
    assert write_model(target, model, ()) == write_model(target, model, ()) == [target]
    first = target.read_text()
    written = write_model(target, replace(model, mass=2.0), ())
    assert [p.name for p in written] == ["model.toml", "model.previous.toml"]
    assert written[1].read_text() == first != target.read_text()
    write_model(target, replace(model, mass=2.0), ())  # the same again is no reason to forget it
    assert written[1].read_text() == first and len(list(tmp_path.iterdir())) == 2
