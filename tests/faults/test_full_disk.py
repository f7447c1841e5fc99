"""A disk that is full at any moment: one sentence, and every finished record as it was."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from faults.test_kills import sound, study
from optuna.storages.journal import JournalFileBackend
from rich.console import Console
from synthetic_sweep import essence, swept, toy

from bench.execution import engine
from bench.records import record
from bench.records.finished import finished_studies
from bench.reporting import study_outputs
from bench.sweep.journal import JOURNAL
from bench.training import checkpoint
from registry import atomic_io
from registry.errors import BenchError


def full(*args: object, **kwargs: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    ("owner", "name"), [(atomic_io, "flush"), (record, "sha256"), (os, "replace"), (record.pq, "write_table")]
)
def test_a_record_that_does_not_fit_is_one_sentence(
    owner: object, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configs = study(2)
    engine.execute(engine.plan(configs[:1], tmp_path), tmp_path)
    before = sound(tmp_path)
    with monkeypatch.context() as patch, pytest.raises(BenchError, match="cannot be written: No space left") as error:
        patch.setattr(owner, name, full)
        engine.execute(engine.plan(configs, tmp_path), tmp_path)
    assert "\n" not in str(error.value)
    assert sound(tmp_path) == before and not list(tmp_path.glob(".draft-*"))
    assert len(engine.execute(engine.plan(configs, tmp_path), tmp_path)) == 2


def test_checkpoints_that_do_not_fit_cost_no_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = engine.execute(engine.plan(study(1), tmp_path / "a"), tmp_path / "a")
    real, torn = Path.write_bytes, []

    def half(path: Path, content: bytes) -> int:
        torn.append(path)
        real(path, content[: len(content) // 2])
        return full()

    monkeypatch.setattr(Path, "write_bytes", half)
    again = engine.execute(engine.plan(study(1), tmp_path / "b"), tmp_path / "b")
    assert record.differences(whole[0], again[0]) == []
    assert torn and all(".safetensors" in p.name and not p.exists() for p in torn)


def test_a_torn_checkpoint_is_not_gone_on_from(tmp_path: Path) -> None:
    import torch

    place = checkpoint.Checkpoint(tmp_path / "c")
    place.save({"theta": torch.arange(100.0)}, {"update": 7})
    assert place.load() is not None
    content = bytearray(place.path.read_bytes())
    content[-40:] = bytes(40)  # a page that never reached the disk
    place.path.write_bytes(content)
    assert place.load() is None


def test_a_sweep_whose_journal_does_not_fit_goes_on_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full from the 60th entry on, which a trial in the middle makes, and has torn its line."""
    _, unbroken = swept(tmp_path / "whole", toy("planted"), 10)
    journal, real, left = tmp_path / "s" / JOURNAL, JournalFileBackend.append_logs, [60]

    def fill(self: JournalFileBackend, logs: list[dict[str, object]]) -> None:
        left[0] -= 1
        if left[0] == 0:
            with journal.open("a") as torn:
                torn.write('{"op_code": 6, "wor')
            full()
        real(self, logs)

    with monkeypatch.context() as patch, pytest.raises(BenchError, match="No space left on device; every") as error:
        patch.setattr(JournalFileBackend, "append_logs", fill)
        swept(tmp_path / "s", toy("planted"), 10)
    assert "--resume" in str(error.value) and "\n" not in str(error.value)
    _, resumed = swept(tmp_path / "s", toy("planted"), 10)
    assert essence(resumed) == essence(unbroken) and len(resumed.trials) == 11


def test_a_study_whose_report_does_not_fit_keeps_its_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faults: Callable[..., None]
) -> None:
    runs = tmp_path / "runs"
    records = engine.execute(engine.plan(study(2), runs), runs)
    before, folder = sound(runs), tmp_path / "studies" / "s"
    with monkeypatch.context() as patch, pytest.raises(BenchError, match="No space left on device; every finished"):
        patch.setattr(study_outputs.pq.ParquetWriter, "write_table", full)
        study_outputs.write_outputs(Console(quiet=True), records, "s", None, "bench run s", folder)
    assert sound(runs) == before and not list(finished_studies(tmp_path))
    study_outputs.write_outputs(Console(quiet=True), records, "s", None, "bench run s", folder)
    assert [c.title for c in finished_studies(tmp_path)] == ["s"]
    faults("the disk, full at every place that writes (ENOSPC, RLIMIT_FSIZE)", 8, 0, 0, "what did not fit")
