"""The long tables that a study leaves, against the records that they are made of."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_study
from rich.console import Console

from bench.claims.evidence import COST, FILE
from bench.records.record import RunRecord
from bench.reporting import study_outputs


def test_the_tables_hold_every_step_of_every_run_that_did_not_diverge(tmp_path: Path) -> None:
    lost = synthetic_study.record(tmp_path / "runs", synthetic_study.MLP, ("body_rates.q",), 7, 3, 2, diverged=True)
    rest = synthetic_study.study(tmp_path / "runs", {5: 2, 7: 1}, axes="p", recordings=2)
    study_outputs.write_outputs(Console(quiet=True), [lost, *rest], "s", None, "bench run s", tmp_path / "out")
    steps = pd.read_parquet(tmp_path / "out" / study_outputs.STEPS)
    evidence = pd.read_parquet(tmp_path / "out" / FILE)
    assert list(dict.fromkeys(steps.key)) == list(dict.fromkeys(evidence.key)) == [r.key for r in rest]
    for r in rest:
        mine = steps[steps.key == r.key].reset_index(drop=True)
        pd.testing.assert_frame_equal(mine[r.steps.columns], r.steps)
        assert set(zip(mine.spec, mine.seed, mine.horizon, strict=True)) == {
            (r.summary["spec"], r.summary["seed"], r.summary["horizon"])
        }
        kept = r.steps[r.steps.statistic.str.startswith("mean") | (r.steps.statistic == "q99")]
        shown = evidence[(evidence.key == r.key) & (evidence.quantity != COST)]
        assert list(shown.statistic) == list(kept.statistic) and list(shown.step) == list(kept.step)
        np.testing.assert_allclose(shown.value, kept.value, rtol=2**-12)


def test_a_study_of_which_every_run_diverged_has_empty_tables(tmp_path: Path) -> None:
    lost = synthetic_study.record(tmp_path / "runs", synthetic_study.MLP, ("body_rates.q",), 7, 3, 2, diverged=True)
    study_outputs.write_outputs(Console(quiet=True), [lost], "s", None, "bench run s", tmp_path / "out")
    for name in (study_outputs.STEPS, FILE):
        assert pd.read_parquet(tmp_path / "out" / name).empty


def test_whoever_is_stopped_while_a_study_is_written_leaves_its_files_as_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write() -> dict[str, bytes]:
        with suppress(KeyboardInterrupt):
            study_outputs.write_outputs(Console(quiet=True), runs, "s", None, "bench run s", tmp_path / "out")
        return {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir()}

    def stopped(records: list[RunRecord], path: Path) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    runs = synthetic_study.study(tmp_path / "runs", {5: 2}, axes="p", recordings=2)
    before = write()
    runs = synthetic_study.study(tmp_path / "more", {5: 3}, axes="p", recordings=2)
    with monkeypatch.context() as patched:
        patched.setattr(study_outputs, "write_evidence", stopped)
        assert write() == before
    after = write()
    assert after.keys() == before.keys() and all(after[name] != before[name] for name in ("study.json", FILE))
