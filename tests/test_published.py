"""Published numbers still hold: one network a data set is trained again. And simulated flights show what can be had."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench.analysis.tables import FIRST, LAST
from bench.api.check import judged
from bench.claims import markdown
from bench.claims.evidence import FILE
from bench.claims.gathering import Folder, folders
from bench.claims.published import check
from bench.execution import engine
from bench.experiment.config import RunConfig
from bench.experiment.datasets import choose
from bench.experiment.notation import parse
from bench.reporting import report, study_outputs
from registry.units import display

ROOT = Path(__file__).parent.parent / "results" / "published"
PUBLISHED = ROOT / "washout_vs_mlp"
CLAIMS = ROOT / "claims.md"
SPEC = "MLFC: 1x50 - MLP: 60x10"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["helicopter_twin", "tailsitter", "nanodrone"])
def test_a_published_network_is_found_again(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """As `bench check` judges it: equal where it is the same run, else within what seeds differ by."""
    if name != "helicopter_twin":
        request.getfixturevalue("bench_data")
    study = json.loads((PUBLISHED / name / "study.json").read_text())
    published = next(r for r in study["runs"] if (r["spec"], r["horizon"], r["seed"]) == (SPEC, 40, 0))
    config = RunConfig(*parse(SPEC), choose(name, full=True), outputs=tuple(published["outputs"]))
    (again,) = engine.execute(engine.plan([config], tmp_path / "runs"), tmp_path / "runs")
    folder = tmp_path / "studies" / "again"
    folder.mkdir(parents=True)
    study["runs"] = [{field: again.summary[field] for field in study_outputs.PUBLISHED}]
    (folder / "study.json").write_text(json.dumps(study))
    held = check(PUBLISHED / name, tmp_path)
    assert held and max(h.band for h in held) < 0.3
    assert all(h.holds for h in held), held


FOLDERS = [f for f in folders(ROOT) if f.runs and (f.path / FILE).is_file()]
TWINS = [f for f in FOLDERS if f.runs[0].dataset.endswith("_twin")]


def name(folder: Folder) -> str:
    return folder.path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("folder", TWINS, ids=name)
def test_the_attainable_line_stands_beside_all_that_is_predicted_of_simulated_flights(folder: Folder) -> None:
    """At every horizon, of all that `constant` predicts, in the table and the evidence."""
    line = [r for r in folder.runs if r.spec == "attainable"]
    beside = [r for r in folder.runs if r.spec == "constant"]
    assert {(r.horizon, r.outputs) for r in line} == {(r.horizon, r.outputs) for r in beside}
    table = (folder.path / "table.md").read_text()
    assert table.count(" | attainable | ") == sum(len(r.metrics) for r in line)
    curves = pq.read_table(folder.path / FILE, columns=["key", "statistic", "step"]).to_pandas()
    ends = curves[curves.statistic == "mean"].groupby("key", observed=True)["step"].max()
    assert {r.key: ends.get(r.key) for r in line} == {r.key: r.horizon for r in line}


@pytest.mark.parametrize("folder", FOLDERS, ids=name)
def test_every_row_of_a_table_follows_from_the_runs_and_the_evidence(folder: Folder) -> None:
    """RMSSE from the metrics in ``study.json``; first and last steps from the curves, where the evidence has them."""
    curves = pq.read_table(folder.path / FILE).to_pandas()
    curves = curves[(curves.statistic == "mean") & curves.norm.isin(("paper", "axis"))]
    found = curves.set_index(["key", "quantity", "step"])["value"].sort_index()
    checked = 0
    for section in (folder.path / "table.md").read_text().split("\n## T = ")[1:]:
        horizon = int(section.split()[0])
        for text in (r for r in section.partition("\n### ")[0].splitlines() if re.search(r"of \d+ \|$", r)):
            shown, spec, _, unit, rmsse, *ends, _ = text.strip("| ").split(" | ")
            output = re.sub(r"^(\w+)(\.\w+)? \((\w+)\)$", r"\1_\3\2", shown)
            runs = [r for r in folder.runs if (r.spec, r.horizon) == (spec, horizon) and f"rmsse.{output}" in r.metrics]
            factor = display({"deg/s": "rad/s", "deg": "rad"}.get(unit, unit))[1]
            values = [float(r.metrics[f"rmsse.{output}"] or 0) for r in runs if r.sound]
            assert rmsse.partition(" ")[0] == report.number(factor * np.mean(values)), text
            checked += 1
            if (runs[0].key, output) in found.index:
                mean = np.mean([found[r.key, output].to_numpy() for r in runs if r.sound], axis=0)
                told = [mean[:FIRST].mean(), mean[-LAST:].mean()]
                assert [float(e) for e in ends] == pytest.approx(told, rel=6e-3), text
    assert checked >= len({(r.spec, r.horizon, r.outputs) for r in folder.runs if r.sound})


def test_the_page_of_claims_follows_from_the_evidence(tmp_path: Path) -> None:
    """But for what simulated flights say of claims about recordings that are not here."""
    made = markdown.render(judged(None, tmp_path, ROOT).rows, "bench check --simulate --markdown claims.md")
    pages = [[r for r in text.splitlines() if "| not run | needs " not in r] for text in (made, CLAIMS.read_text())]
    assert len(pages[0]) > 90 and pages[0] == pages[1]


def test_no_band_was_ever_changed() -> None:
    """Each claim has the band in every commit, and in the file as it is, that it was first written with."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
        return done.stdout if done.returncode == 0 else ""

    name = "results/paper/claims.toml"
    commits = git("log", "--reverse", "--format=%h", "--", f":/{name}").split()
    if not commits:
        pytest.skip("no git history here")
    bands: dict[str, set[str]] = {}
    for text in (*(git("show", f"{commit}:{name}") for commit in commits), (ROOT.parent.parent / name).read_text()):
        for claim in tomllib.loads(text)["claim"]:
            bands.setdefault(claim["id"], set()).add(str(claim.get("accept")))
    assert {claim: found for claim, found in bands.items() if len(found) > 1} == {}
