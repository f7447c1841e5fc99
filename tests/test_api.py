"""What `import bench` offers: complete, typed, shown in a notebook, and the same numbers as the rooms behind it."""

import inspect
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest
from diagnose.undriven import undriven

import bench
from bench.diagnose.logs.subject import Subject
from registry.core import EFFECTS

matplotlib.use("Agg")
EVIL = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def damped() -> Subject:
    """A pendulum with friction that the model lacks; two of its recordings bear a hostile name."""
    starts = [[1.5, 0.0], [0.4, 1.0], [-1.0, 0.5], [0.8, -0.7]]
    subject = undriven("pendulum", [EFFECTS.get("viscous_friction")(0.1)], starts, 0.02, 500, 1e-3)
    return replace(subject, name=EVIL)


def test_every_public_name_is_there_with_a_text_and_a_signature() -> None:
    assert set(bench.__all__) <= set(dir(bench))
    for name in bench.__all__:
        found = getattr(bench, name)
        assert inspect.getdoc(found), name
        if not inspect.isclass(found):
            parameters = inspect.signature(found).parameters.values()
            assert all(p.annotation is not inspect.Parameter.empty for p in parameters), name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        bench.nothing  # noqa: B018


def test_packages_that_are_called_stay_packages() -> None:
    code = "import bench.diagnose.result, bench; print(bench.diagnose.result.VERDICTS[0], callable(bench.diagnose))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "named True\n"
    assert next(iter(inspect.signature(bench.sweep).parameters)) == "target"


def test_the_steps_show_themselves(damped: Subject) -> None:
    compared = bench.compare(damped)  # no empty dictionary
    table = compared.to_frame()
    assert list(table.columns) == ["group", "horizon_s", "model", "rmse", "low", "high", "unit"]
    last = table[(table.model == "nominal") & (table.horizon_s == compared.horizon_s[-1])].set_index("group")
    assert {g: e.rmse for g, e in compared.error("nominal").items()} == last.rmse.to_dict()
    axes = compared.plot()
    assert [a.get_ylabel() for a in axes] == ["rms error of angle [deg]", "rms error of angle_rate [deg/s]"]
    assert all(a.get_xlabel() == "horizon [s]" for a in axes)
    drawn = {line.get_label(): line.get_ydata() for line in axes[0].get_lines()}
    assert np.allclose(drawn["nominal"], np.degrees(compared.lines["nominal"]["angle"].rmse))

    located = bench.locate(damped, damped.model)
    assert list(located.to_frame().region) == [r.region for r in located.regions]
    assert located.plot().get_xlabel() == "share [%]"

    found = bench.discover(damped)
    row = found.to_frame().iloc[0]
    assert row.effect == "viscous_friction" and row.low < 0.1 < row.high
    assert "[%]" in found.plot().get_xlabel()

    extended = bench.extend(damped, damped.model, ["viscous_friction"])
    stages = extended.to_frame().pivot(index="stage", columns="group", values="rmse")
    assert stages.angle["viscous_friction"] < 0.3 * stages.angle["nominal"]
    for result in (compared, located, found, extended):
        assert "<table" in result._repr_html_() and isinstance(result.to_frame(), pd.DataFrame)


def test_a_diagnosis_shows_itself_and_escapes_what_others_wrote(damped: Subject) -> None:
    found, _ = bench.diagnose(damped, brief=True)
    assert found.to_frame().effect.tolist() == ["viscous_friction"]
    assert found.plot()[0].get_xlabel() == "horizon [s]"
    shown = found._repr_html_()
    assert EVIL not in shown and "&lt;script&gt;" in shown
    hostile = replace(found.effects[0], id=EVIL)
    assert EVIL not in replace(found, effects=(hostile,))._repr_html_()


def test_runs_and_sweeps_from_python_are_those_of_the_command_line(tmp_path: Path) -> None:
    options = {"training.updates": 40, "training.evaluate_every": 20}
    done = bench.run("GRU: 1x4 - MLP: 4x5", "toy", horizon=4, options=options, results=tmp_path)
    table = done.to_frame()
    assert set(table.spec) == {"GRU: 1x4 - MLP: 4x5", "constant", "linear"} and table.rmsse.notna().all()
    assert all("[s]" in a.get_xlabel() for a in done.plot())
    assert "<table" in done._repr_html_()
    assert str(done).startswith(done.headline) and "GRU: 1x4 - MLP: 4x5" in str(done)
    page = done.write_report(tmp_path / "report.html").read_text()
    assert "GRU: 1x4 - MLP: 4x5" in page
    again = bench.run("GRU: 1x4 - MLP: 4x5", "toy", horizon=4, options=options, results=tmp_path)
    assert [r.key for r in again.records] == [r.key for r in done.records]

    swept = bench.sweep("GRU: 1x4 - MLP: 4x5", "toy", trials=2, options={**options, "horizon": 4}, results=tmp_path)
    assert len(swept.to_frame()) == 2 and (swept.folder / "report.html").is_file()
    assert swept.plot().get_xlabel() == "trial" and swept.best.horizon == 4


def test_checks_from_python(tmp_path: Path) -> None:
    found = bench.check(["body-rates-level"], results=tmp_path)
    assert set(found.to_frame().claim) == {"body-rates-level"} and not found.lost
    with pytest.raises(bench.BenchError, match="did you mean body-rates-level"):
        bench.check(["body-rates-levl"])
