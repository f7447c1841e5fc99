"""`bench settle`: the plan, seeds that are added until a claim is settled, what stops it, what it leaves."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import Typed

from bench.api.check import published_folder
from bench.claims.gathering import gather
from bench.execution import estimate
from bench.experiment import study
from bench.experiment.config import RunConfig
from bench.experiment.grid import effort, grid
from bench.experiment.study import Study
from bench.settle.sources import Scope, Source, group, published_runs
from registry.contracts import Dataset

Bench = Callable[..., tuple[int, str]]
NAME = "two_networks"
SPECS = ("MLFC: 1x4 - MLP: 4x10", "LSTM: 1x4 - MLP: 4x10", "GRU: 1x4 - MLP: 4x10", "linear")
"""The claims are about the first two."""
CLAIMS = """
[[claim]]
id = "neither-fails"
text = "Trainings of one kind fail about as often as those of the other."
source = "nowhere"
scope = "comparative"
study = "two_networks"
judge = {{kind = "diverged", a = "MLFC*", b = "LSTM*"}}
accept = [-{0}, {0}]

[[claim]]
id = "one-always-fails"
text = "All trainings of one kind fail, and none of the other."
source = "nowhere"
scope = "comparative"
study = "two_networks"
judge = {{kind = "diverged", a = "MLFC*", b = "LSTM*"}}
accept = [1.0, 1.0]
"""
"""Nothing diverges, so that an interval depends on the number of seeds alone."""


def runs(preset: str, dataset: Dataset) -> list[RunConfig]:
    axes = [(c,) for c in dataset.predicted_channels()[:1]]
    return grid(SPECS, dataset, {5: effort(2, 2)}, axes)


def baseline(dataset: Dataset) -> list[RunConfig]:
    return grid(("constant",), dataset, {5: effort(1, 1)}, [(c,) for c in dataset.predicted_channels()[:1]])


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, typed: Typed) -> Bench:
    """A command as a user types it, with a study of two small networks: exit code and everything printed."""
    made = Study(NAME, "two", "which?", "nowhere", "toy", runs, ())
    monkeypatch.setattr(study, "studies", lambda: {NAME: made})
    monkeypatch.setattr(study, "titles", lambda: {NAME: made.title})
    monkeypatch.setattr(study, "default_datasets", lambda: {NAME: "toy"})

    def run(*arguments: Any) -> tuple[int, str]:
        code, out, error = typed(*arguments)
        return code, " ".join((out + error).split())

    return run


@pytest.fixture
def here(bench: Bench, tmp_path: Path) -> list[Any]:
    """Options that name a folder where the study was published with two seeds, and a claim that five settle."""
    code, printed = bench("run", NAME, "--results", tmp_path / "first", "--no-track", "--workers", 1)
    assert code == 0, printed
    (made,) = (tmp_path / "first" / "studies").iterdir()
    shutil.copytree(made, tmp_path / "published" / NAME)
    (tmp_path / "claims.toml").write_text(CLAIMS.format(0.62))
    where = ["--results", tmp_path / "results", "--published", tmp_path / "published"]
    return [*where, "--claims", tmp_path / "claims.toml", "--workers", 1, "--no-track"]


def seeds(results: Path, kind: str = "") -> list[int]:
    """Of the trainings recorded, of a kind of network."""
    summaries = [json.loads(p.read_text()) for p in results.glob("runs/*/record.json")]
    return sorted(s["seed"] for s in summaries if s["spec"] != "linear" and s["spec"].startswith(kind))


def test_a_plan_says_what_is_open_and_trains_nothing(bench: Bench, here: list[Any], tmp_path: Path) -> None:
    code, printed = bench("settle", "--dry-run", *here)
    assert code == 0, printed
    assert "neither-fails two_networks on toy 2 about" in printed and "more seeds a configuration" in printed
    assert "1 open claim; more seeds are expected to settle 1 of them" in printed
    assert not (tmp_path / "results").exists()


def test_seeds_are_added_until_the_claim_is_settled(bench: Bench, here: list[Any], tmp_path: Path) -> None:
    wanted = Scope(tmp_path / "results", tmp_path / "published", tmp_path / "claims.toml")
    (before,) = [r for r in wanted.rows() if r.claim.id == "neither-fails"]
    assert (before.judgement.verdict, before.seeds) == ("not enough evidence", 2)
    code, printed = bench("settle", "neither-fails", *here)
    assert code == 0, printed
    (after,) = [r for r in wanted.rows() if r.claim.id == "neither-fails"]
    assert after.judgement.verdict == "reproduced" and 2 < after.seeds <= before.needed
    added = list(range(2, after.seeds))
    assert seeds(tmp_path / "results") == sorted(2 * added)  # the published ones are not trained again
    assert f"2 → {after.seeds} {2 * len(added)} " in printed and "neither-fails: reproduced, 0 (-0." in printed
    records = {p.parent.name: p.read_bytes() for p in tmp_path.glob("results/runs/*/record.json")}
    assert bench("settle", *here)[1].startswith("Nothing is open")
    again = tmp_path / "again"
    bench("run", NAME, "--seeds", after.seeds, "--results", again, "--no-track", "--workers", 1)
    assert {n: (again / "runs" / n / "record.json").read_bytes() for n in records} == records
    (folder,) = (tmp_path / "results" / "studies").iterdir()
    command = json.loads((folder / "study.json").read_text())["command"]
    assert command.startswith(f"bench run {NAME} --dataset toy --only 'MLFC: 1x4 - MLP: 4x10' --only 'LSTM")


def test_a_configuration_with_fewer_seeds_catches_up_first(bench: Bench, here: list[Any], tmp_path: Path) -> None:
    more = ("--only", "MLFC*", "--seeds", 4, "--results", tmp_path / "results", "--no-track", "--workers", 1)
    assert bench("run", NAME, *more)[0] == 0
    assert "neither-fails two_networks on toy 2 about" in bench("settle", "--dry-run", *here)[1]
    code, printed = bench("settle", NAME, *here)
    assert code == 0 and "Seed 3 of two_networks on toy" in printed, printed
    mlfc, lstm = (seeds(tmp_path / "results", kind) for kind in ("MLFC", "LSTM"))
    assert lstm == list(range(2, lstm[-1] + 1)) and mlfc == list(range(max(3, lstm[-1]) + 1))


def test_seeds_added_for_one_claim_stay_evidence_when_another_is_settled(
    bench: Bench, here: list[Any], tmp_path: Path
) -> None:
    other = CLAIMS.format(0.62).partition("\n\n")[0].replace("neither-fails", "another").replace("MLFC*", "GRU*")
    (tmp_path / "claims.toml").write_text(CLAIMS.format(0.62) + other)
    first, second = (bench("settle", claim, *here)[0] for claim in ("neither-fails", "another"))
    assert first == second == 0 and seeds(tmp_path / "results", "GRU")
    (found,) = gather(tmp_path / "published", tmp_path / "results" / "studies")
    counted = {kind: sorted(r.seed for r in found.runs if r.spec.startswith(kind)) for kind in ("MLFC", "GRU")}
    assert counted["MLFC"] == [0, 1, *seeds(tmp_path / "results", "MLFC")] and len(counted["GRU"]) > 2


def test_what_was_never_run_is_not_begun(bench: Bench, here: list[Any], tmp_path: Path) -> None:
    (tmp_path / "claims.toml").write_text(CLAIMS.format(0.62).replace("LSTM*", "[LG]*"))
    file = tmp_path / "published" / NAME / "study.json"
    content = json.loads(file.read_text())
    content["runs"] = [r for r in content["runs"] if not r["spec"].startswith("GRU")]
    file.write_text(json.dumps(content))
    assert bench("settle", NAME, *here)[0] == 0
    assert seeds(tmp_path / "results", "LSTM") and not seeds(tmp_path / "results", "GRU")


def test_a_baseline_that_was_not_published_is_not_made(
    bench: Bench, here: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    more = Study(NAME, "two", "which?", "nowhere", "toy", lambda p, d: [*runs(p, d), *baseline(d)], ())
    monkeypatch.setattr(study, "studies", lambda: {NAME: more})
    assert bench("settle", *here)[0] == 0
    made = {json.loads(p.read_text())["spec"] for p in tmp_path.glob("results/runs/*/record.json")}
    assert "linear" in made and "constant" not in made


def test_what_was_added_before_it_was_stopped_is_not_trained_again(
    bench: Bench, here: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bench.cli import settling

    done, carry_out = [], settling.carry_out

    def interrupted(*args: Any, **options: Any) -> None:
        carry_out(*args, **options)
        done.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(settling, "carry_out", interrupted)
    assert bench("settle", NAME, *here)[0] == 130 and seeds(tmp_path / "results") == [2, 2]
    written = {p: p.stat().st_mtime_ns for p in tmp_path.glob("results/runs/*/record.json")}
    monkeypatch.setattr(settling, "carry_out", carry_out)
    code, printed = bench("settle", NAME, *here)
    assert code == 0 and "3 → " in printed, printed
    assert written == {p: p.stat().st_mtime_ns for p in written}


def test_published_seeds_of_other_data_do_not_count(bench: Bench, here: list[Any], tmp_path: Path) -> None:
    file = tmp_path / "published" / NAME / "study.json"
    content = json.loads(file.read_text())
    for run in content["runs"]:
        run["metrics"] = {k: (1.02 if run["spec"] == "linear" else 1.0) * v for k, v in run["metrics"].items()}
    file.write_text(json.dumps(content))
    code, printed = bench("settle", NAME, *here)
    assert code == 0 and "do not come out as published" in printed, printed
    assert set(seeds(tmp_path / "results")) >= {0, 1, 2}


def test_the_first_look_is_at_the_fewest_seeds_of_a_study_that_was_finished(
    bench: Bench, here: list[Any], tmp_path: Path
) -> None:
    local = tmp_path / "results" / "studies"
    bench("run", NAME, "--seeds", 4, "--results", tmp_path / "results", "--no-track", "--workers", 1)
    (both,), (alone,) = gather(tmp_path / "published", local), gather(tmp_path / "none", local)
    assert (both.first, both.seeds, alone.first, alone.seeds) == (2, 4, 4, 4)


@pytest.mark.parametrize(
    ("name", "dataset"),
    [
        ("motion_model_compensation", "nanodrone"),  # a hybrid, its motion model beside it
        ("quadrotor_black_box", "nanodrone"),  # cascades, with measured rates beside
        ("washout_vs_mlp", "nanodrone"),  # an axis a network
    ],
)
def test_what_this_suite_published_is_not_trained_again(name: str, dataset: str, bench_data: Path) -> None:
    source = Source(name, dataset, "laptop", 3, ())
    there = published_runs(source, published_folder(None))
    seeds = 1 + max(seed for *_, seed in there)
    known = {spec for spec, *_ in there}
    asked, more = (group(source, n, there).configs for n in (seeds, seeds + 1))
    assert all(c.predictor.training != "gradient" for c in asked if c.spec in known)
    assert {c.seed for c in more if c.predictor.training == "gradient" and c.spec in known} == {seeds}


def test_another_choice_of_outputs_is_another_run() -> None:
    source = Source("washout_vs_mlp", "nanodrone", "laptop", 3, ())
    one, *_ = [c for c in group(source, 1).configs if c.predictor.training == "gradient"]
    (channel,), run = one.outputs, (one.spec, one.horizon, one.seed)
    signal = channel.partition(".")[0]

    def left(*outputs: str) -> bool:
        return one in group(source, 1, [(run[0], outputs, *run[1:])]).configs

    assert not left(channel) and left(f"{signal}.other") and left(channel, f"{signal}.other")


def test_a_budget_stops_it(bench: Bench, here: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimate, "seconds", lambda tasks: [1000.0 * len(t.keys) * (t.updates > 1) for t in tasks])
    code, printed = bench("settle", NAME, "--budget", "30m", *here)
    assert code == 2 and "One more seed of two_networks on toy takes about 33:20" in printed
    assert "give a longer --budget" in printed and not seeds(tmp_path / "results")
    code, printed = bench("settle", NAME, "--budget", "34m", *here)
    assert code == 0 and len(seeds(tmp_path / "results")) > 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("neither-fail",), "'neither-fail': did you mean neither-fails"),
        (("two_networks", "--budget", "soon"), "'soon' is no time"),
        (("--budget", "0m"), "'0m' is no time"),
        (("--max-seeds", "40"), "range"),
        (("--dataset", "helicopter_twin"), "There is no evidence on helicopter_twin"),
        (("--dataset", "helicopter_twni"), "helicopter_twin"),
    ],
)
def test_a_mistake_is_one_sentence(bench: Bench, here: list[Any], arguments: tuple[str, ...], says: str) -> None:
    code, printed = bench("settle", *arguments, *here)
    assert code == 2 and says in printed, printed


def test_a_claim_about_recordings_takes_no_training(bench: Bench, tmp_path: Path) -> None:
    code, printed = bench("settle", "pelican-samples", "--results", tmp_path)
    assert code == 2 and "is about recordings" in printed
