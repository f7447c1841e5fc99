"""What a command says to type next runs as it stands, and what cannot be is refused before the work."""

import io
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import Typed
from swing import TOML, write_swing

import bench as api
from bench.cli import cli
from bench.diagnose.evidence import Evidence
from bench.diagnose.logs.load import load
from bench.diagnose.report.sentences import commands
from bench.diagnose.result import KINDS, Diagnosis, Errors, NamedEffect, Unexplained
from bench.experiment.asked import Asked
from registry.errors import BenchError

PHYSICS = '''
from registry.physics.oscillator import Oscillator

class Swing(Oscillator):
    """A swing."""
'''


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the recordings of a swing in "my logs", and a class for them in mine.py."""
    data = tmp_path / "my logs"
    write_swing(data)
    (tmp_path / "mine.py").write_text(PHYSICS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def parsed(command: str) -> dict[str, object]:
    """The options of a command line, by the command's own parser."""
    words = shlex.split(command)
    assert words[0] == "bench"
    found = cli.get_command(None, words[1])  # type: ignore[arg-type]
    assert found is not None
    return found.make_context(words[1], words[2:]).params


def test_the_next_commands_have_the_options_that_they_need() -> None:
    asked = Asked("mine.py:Swing", "old.toml", "look at/", ("--without", "mass", "--ignore-problem", "time shift"))
    tie = NamedEffect("stribeck_friction", {}, 0.5, {}, {}, indistinguishable_from=("coulomb_friction",))
    found = Diagnosis(
        "swing", "Swing", "tie", {}, Errors({}, {}, {}), (tie,), Unexplained(0.0), (), (),
        evidence=Evidence("my logs", asked=asked),
    )  # fmt: skip
    diagnose, design, *extend = [parsed(c) for c in commands(found)]
    for options in (diagnose, design, *extend):
        assert options["source"] == "my logs" and options["system"] == "mine.py:Swing"
    assert diagnose["model_file"] == Path("old.toml") and diagnose["out"] == Path("look at")
    assert diagnose["without"] == ("mass",) and diagnose["ignore"] == ("time shift",)
    assert design["model_file"] == Path("look at/model.toml")
    assert [e["add"] for e in extend] == [("stribeck_friction",), ("coulomb_friction",)]
    both = (replace(tie, indistinguishable_from=()), replace(tie, id="payload", indistinguishable_from=()))
    *_, extend_all = commands(replace(found, verdict="named", effects=both))
    assert parsed(extend_all)["add"] == ("stribeck_friction", "payload") and parsed(extend_all)["out"] == Path(
        "look at"
    )


def test_options_of_the_data_set_go_into_the_next_commands() -> None:
    asked = Asked(settings=("gyroscope=true",), exclude=("run 2",))
    for step in ("diagnose", "locate", "discover", "design"):
        options = parsed(asked.command(step, "nanobench"))
        assert options["settings"] == ("gyroscope=true",) and options["exclude"] == ("run 2",)


@pytest.mark.parametrize("setting", ["gyro=true", "gyroscope=maybe", "gyroscope"])
def test_an_option_that_the_data_set_has_not_is_one_sentence(setting: str) -> None:
    done = CliRunner().invoke(cli, ["diagnose", "nanobench", "--set", setting])
    assert isinstance(done.exception, BenchError) or done.exit_code == 2
    assert "gyro" in (str(done.exception) + done.output)


def test_a_step_says_the_next_one_as_it_runs(here: Path) -> None:
    said = CliRunner().invoke(cli, ["data", "check", "my logs", "--system", "mine.py:Swing"]).output
    assert "Next: bench diagnose 'my logs' --system mine.py:Swing" in said
    done = CliRunner().invoke(cli, ["locate", "my logs", "--system", "mine.py:Swing"])
    assert done.exit_code == 0, done.exception
    assert done.output.splitlines()[-1].endswith(": bench discover 'my logs' --system mine.py:Swing")


def test_a_draft_without_signals_is_one_sentence(here: Path) -> None:
    toml = here / "my logs" / "dataset.toml"
    toml.write_text(TOML.partition("[signals]")[0].replace('input = "force"\n', "") + "[signals]\n")
    done = CliRunner().invoke(cli, ["data", "check", "my logs"])
    assert isinstance(done.exception, BenchError) and "describes no signal yet" in str(done.exception)
    assert "dropped" not in done.output


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("diagnose", "--ignore-problem", "spikes"), "did you mean spike?"),
        (("diagnose", "--horizon", "100"), "The longest stretch is 4 s"),
        (("compare", "--horizon", "100"), "The longest stretch is 4 s"),
        (("extend", "--add", "viscous_friction", "--horizon", "100"), "The longest stretch is 4 s"),
    ],
)
def test_what_is_known_at_the_start_is_said_there(
    arguments: tuple[str, ...], says: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.diagnose.select.timing.reading.noise_of", lambda *_: pytest.fail("work was begun"))
    given = [arguments[0], "my logs", "--system", "mine.py:Swing", *arguments[1:]]
    done = CliRunner().invoke(cli, given)
    assert isinstance(done.exception, BenchError) and says in str(done.exception), done.exception


def test_the_row_of_a_model_that_was_given_is_called_so(here: Path) -> None:
    """And not "calibrated", which is the nominal one."""
    from types import SimpleNamespace

    from rich.console import Console

    from bench.cli.diagnosing import show_extension

    stages = [SimpleNamespace(name=n, error={"speed": 1.0}) for n in ("nominal", "calibrated", "floor")]
    group = SimpleNamespace(name="speed", unit="m/s")
    done = SimpleNamespace(comparison=SimpleNamespace(groups=[group]), stages=stages, effects=(), notes=())
    for given, name in ((None, "calibrated"), (Path("old/better.toml"), "better.toml, fitted again")):
        out = Console(width=100, record=True, file=io.StringIO())
        show_extension(out, done, given)  # type: ignore[arg-type]
        assert out.export_text().splitlines()[2].split("  ")[0] == name


def test_a_shaft_has_a_mass_too(here: Path) -> None:
    (here / "mine.py").write_text(
        "from registry.contracts import Channel\nfrom registry.physics.state_space import Mechanical\n\n"
        "class Motor(Mechanical):\n    state_channels = (Channel('angle.a', 'rad'), Channel('angle_rate.a', 'rad/s'))\n"
        "    input_signals = ('voltage',)\n    equation = ''\n"
        "    def own_force(self, state, inputs):\n        return inputs\n"
    )
    done = CliRunner().invoke(cli, ["data", "check", "my logs", "--system", "mine.py:Motor"])
    assert "Motor derives from Mechanical, and so needs a constant called mass" in str(done.exception)


def test_effects_are_listed_by_system(here: Path) -> None:
    every = CliRunner().invoke(cli, ["list", "effects"]).output
    assert "lorenz.…" in every and "lorenz.dx" not in every.replace("such as lorenz.d", "")
    of = CliRunner().invoke(cli, ["list", "effects", "--system", "pendulum"]).output
    assert "pendulum.domega.theta3" in of and "viscous_friction" in of and "rotor_drag" not in of
    own = CliRunner().invoke(cli, ["list", "effects", "--system", "mine.py:Swing"]).output
    assert "viscous_friction" in own and "rotor_drag" not in own


def test_a_file_in_the_place_of_its_folder(here: Path) -> None:
    for command in ("diagnose", "compare"):
        done = CliRunner().invoke(cli, [command, "my logs/run_1.csv"])
        assert isinstance(done.exception, BenchError)
        assert str(done.exception) == "my logs/run_1.csv is a file: give the folder that holds it, my logs."


def test_a_wrong_dataset_toml_ends_in_exit_code_2(here: Path, monkeypatch: pytest.MonkeyPatch, typed: Typed) -> None:
    from bench.diagnose.checks.description.mistake import Mistake

    wrong = Mistake("unit", "speed", ("run_1",), "it is in cm/s", ('speed = {columns = ["v"], unit = "cm/s"}',))
    monkeypatch.setattr("bench.diagnose.checks.description.checklist.check", lambda *_: [wrong])
    code, out, _ = typed("data", "check", "my logs", "--system", "mine.py:Swing")
    assert code == 2 and "then: bench data check 'my logs' --system mine.py:Swing" in out


def test_steps_take_a_name_or_a_folder_and_one_id(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "my logs" / "dataset.toml").write_text(TOML.replace("rate_hz", 'system = "oscillator"\nrate_hz', 1))
    assert api.compare("my logs").recordings == api.compare(load("my logs")).recordings
    subject = load("my logs")
    for wrong in (3, None):
        with pytest.raises(BenchError, match="Give a folder"):
            api.discover(wrong)
    with pytest.raises(BenchError, match="did you mean viscous_friction"):
        api.extend("my logs", subject.model, "viscous_frction")


def test_the_kinds_of_problems_are_all_known() -> None:
    """Every kind that a check can give, as its source has it."""
    import re

    import bench.diagnose.checks as checks

    text = "\n".join(p.read_text() for p in Path(checks.__path__[0]).rglob("*.py"))
    given = re.findall(r'(?:Mistake|Edit)\(\s*"([^"]+)"|DataProblem\([^"()]+, (?:"\w+"|[\w.]+), "([^"]+)"', text)
    assert {a or b for a, b in given} <= set(KINDS)
    assert len(given) > 15
