"""Answers are kept, nothing is done twice, and what fails is an answer."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rotorpy")

from bench.execution import executor
from bench.score.case import Case
from bench.score.cases import DEVELOPMENT, cases
from bench.score.judge import FAILED
from bench.score.run import ALTERNATIVES, DIAGNOSIS, Job, Store, jobs, part, run, sources, work
from registry.errors import BenchError

SUITE = [Case("a"), Case("b", condition="pair"), Case("c", condition="tie"), Case("d", condition="nothing")]


def note(job: Job, folder: Path) -> dict[str, Any]:
    """Stands for the work: leaves a mark, so that one can see how often it was done."""
    with (folder / f"{job.case.id}-{job.kind}").open("a") as file:
        file.write("x")
    return {"answer": job.case.id, "noise": float("inf")}


def stop(job: Job, folder: Path) -> dict[str, Any]:
    """As `note`, but the process dies over the case "c"."""
    if job.case.id == "c":
        os._exit(9)
    return note(job, folder)


def marks(folder: Path) -> dict[str, int]:
    return {p.name: len(p.read_text()) for p in folder.iterdir()}


def test_what_is_finished_is_not_done_again(tmp_path: Path) -> None:
    seen, done = tmp_path / "seen", []
    seen.mkdir()
    first = jobs(SUITE, alternatives=False)
    run(first, Store(tmp_path), seen, 2, finished=lambda job: done.append(job.key), do=note)
    assert marks(seen) == {f"{c}-diagnosis": 1 for c in "abcd"} and len(done) == 4
    run(jobs(SUITE, alternatives=True), Store(tmp_path), seen, 1, do=note)
    alternatives = {f"{c}-alternatives": 1 for c in "abd"}  # of a tie they have no notion
    assert marks(seen) == {f"{c}-diagnosis": 1 for c in "abcd"} | alternatives
    kept = Store(tmp_path).read()
    assert kept["b", DIAGNOSIS] == {"answer": "b", "noise": float("inf")} and ("d", ALTERNATIVES) in kept


def test_a_case_that_kills_its_worker_loses_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executor, "MAX_DEATHS", 1)
    seen = tmp_path / "seen"
    seen.mkdir()
    todo = sorted(jobs(SUITE, alternatives=False), key=lambda job: job.case.id)
    with pytest.raises(BenchError, match="fewer --workers"):
        run(todo, Store(tmp_path), seen, 2, do=stop)
    kept, before = {name for name, _ in Store(tmp_path).read()}, marks(seen)
    assert kept and "c" not in kept
    run(todo, Store(tmp_path), seen, 1, do=note)
    assert {name for name, _ in Store(tmp_path).read()} == set("abcd")
    assert all(marks(seen)[f"{name}-diagnosis"] == before[f"{name}-diagnosis"] == 1 for name in kept)


def test_a_half_written_line_is_skipped_and_the_next_begins_anew(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.append(Job(SUITE[0], DIAGNOSIS), {"n": 1})
    with store.path.open("a") as file:
        file.write('{"id": "b", "kind": "diag')
    store.append(Job(SUITE[2], DIAGNOSIS), {"n": 3})
    assert Store(tmp_path).read() == {("a", DIAGNOSIS): {"n": 1}, ("c", DIAGNOSIS): {"n": 3}}


def test_answers_of_other_code_are_not_mixed_in(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.append(Job(SUITE[0], DIAGNOSIS), {"n": 1})
    line = json.loads(store.path.read_text())
    store.path.write_text(json.dumps({**line, "digest": "0" * 16}) + "\n")
    assert Store(tmp_path).read() == {}


def test_an_answer_depends_on_every_module_that_a_diagnosis_runs() -> None:
    rooms = ("bench.diagnose.", *(f"registry.{room}." for room in ("dynamics", "effects", "physics", "terms")))
    loaded = {Path(str(m.__file__)) for name, m in sys.modules.items() if name.startswith(rooms)}
    assert len(loaded) > 40
    left = {p.name for p in loaded - set(sources(DIAGNOSIS))}
    pages = {"page.py", *(f"page_{part}.py" for part in ("equations", "figures", "flights", "parts", "sections"))}
    assert left <= {*pages, "story.py"}


def test_a_case_that_fails_is_an_answer(tmp_path: Path) -> None:
    answer = work(Job(Case("a", vehicle="zeppelin"), DIAGNOSIS), tmp_path)
    assert answer["verdict"] == "error" and answer["named"] == {} and "zeppelin" in answer["notes"][0]
    assert "zeppelin" in work(Job(Case("a", vehicle="zeppelin"), ALTERNATIVES), tmp_path)[FAILED]


def test_a_case_that_fails_says_what_its_effects_make_of_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that it counts among those that must be found, where its flights could be flown."""

    def broken(case: Case, cache: Path) -> None:
        raise ValueError("oops")

    monkeypatch.setattr("bench.score.run.attempt", broken)
    monkeypatch.setattr("bench.score.run.shares", lambda case, cache: {"rotor_drag": 0.7})
    answer = work(Job(Case("a"), DIAGNOSIS), tmp_path)
    assert answer["verdict"] == "error" and answer["extra"]["shares"] == {"rotor_drag": 0.7}


def test_a_part_holds_its_share_of_every_condition_and_lies_inside_a_larger_one() -> None:
    suite = cases(DEVELOPMENT)
    third, half = ({c.id for c in part(suite, f)} for f in (1 / 3, 1 / 2))
    assert third < half
    for condition in {c.condition for c in suite}:
        of = [c.id for c in suite if c.condition == condition]
        assert abs(len(third & set(of)) - len(of) / 3) < 1
    assert [c.id for c in part(suite, 1.0)] == [c.id for c in suite]


@pytest.mark.slow
def test_the_alternatives_find_a_strong_drag_in_quiet_logs(tmp_path: Path) -> None:
    from bench.score.alternatives import attempt_all

    drag = {"rotor_drag": {"k_d": 1.19e-4}}
    one = Case("a", effects=drag, noise="low", recordings=4, seconds=10.0)
    answers = attempt_all(one, tmp_path)
    for name in ("bic", "weak_form"):
        assert answers[name].named["rotor_drag"]["k_d"] == pytest.approx(1.19e-4, rel=0.05)
    assert set(answers) == {"pysindy", "bic", "weak_form"}
    blind = attempt_all(replace(one, catalogue_without=("rotor_drag",)), tmp_path)
    assert all("rotor_drag" not in said.named for said in blind.values())
    better, worse = answers["weak_form"].error["velocity"], blind["pysindy"].error["velocity"]
    assert better < worse
