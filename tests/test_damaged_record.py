"""A record that is not as it was written: named, never used, made again by the same command, bit for bit."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from faults.test_kills import run, study

from bench.execution import engine
from bench.records import record, record_fields, stamp
from bench.records.record import RunRecord
from bench.training.predict import load_model
from registry.errors import BenchError

FILES = ("record.json", "config.json", "provenance.json", "model.safetensors")
FILES += tuple(f"{t}.parquet" for t in record.TABLES)
READ: dict[str, Callable[[RunRecord], object]] = {
    "record.json": lambda r: r.summary,
    "config.json": lambda r: r.config,
    "provenance.json": lambda r: r.provenance,
    "model.safetensors": lambda r: r.weights(),
    "steps.parquet": lambda r: r.steps,
    "curve.parquet": lambda r: r.curve,
    "windows.parquet": lambda r: r.windows,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return run(study(1), tmp_path_factory.mktemp("whole"))[0]


@pytest.fixture
def copy(made: RunRecord, tmp_path: Path) -> RunRecord:
    return RunRecord(Path(shutil.copytree(made.folder, tmp_path / "runs" / made.key)))


def content(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "provenance.json"}


@pytest.mark.parametrize("name", FILES)
def test_a_flipped_byte_anywhere_is_noticed_before_the_file_is_used(name: str, copy: RunRecord) -> None:
    """Of the provenance, where only a space may differ, at least no other value is taken."""
    path, whole = copy.folder / name, (copy.folder / name).read_bytes()
    told = copy.provenance
    for at in np.random.default_rng(0).integers(0, len(whole), 40):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        spoilt = RunRecord(copy.folder)
        try:
            READ[name](spoilt)
        except BenchError as error:
            assert name in str(error) and record.verify(RunRecord(copy.folder)) == [name]
        else:
            assert name == "provenance.json" and spoilt.provenance == told
    path.write_bytes(whole)
    assert record.verify(RunRecord(copy.folder)) == []


@pytest.mark.parametrize("name", FILES)
def test_the_same_command_makes_it_again(name: str, made: RunRecord, copy: RunRecord) -> None:
    whole = (copy.folder / name).read_bytes()
    (copy.folder / name).write_bytes(whole[: len(whole) // 2])
    runs = copy.folder.parent
    todo = engine.plan(study(1), runs)
    assert todo.done == [] and todo.damaged == [f"Run {made.key[:12]} is made again: {name} is damaged."]
    (again,) = engine.execute(todo, runs)
    assert content(again.folder) == content(made.folder) and record.verify(again) == []
    assert engine.plan(study(1), runs).damaged == []


@pytest.mark.parametrize("key", ["key", "spec", "units", "horizon", "history", "metrics", "outputs", "files"])
@pytest.mark.parametrize("before_stamps", [False, True])
def test_a_summary_that_lacks_a_key_is_one_sentence(key: str, before_stamps: bool, copy: RunRecord) -> None:
    if before_stamps:
        (copy.folder / "provenance.json").write_text(json.dumps(copy.provenance))
    summary = json.loads((copy.folder / "record.json").read_text())
    del summary[key]
    (copy.folder / "record.json").write_text(stamp.canonical(summary))
    for use in (lambda r: r.summary, load_model, lambda r: r.finished, lambda r: r.steps):
        with pytest.raises(BenchError, match="damaged or missing"):
            use(RunRecord(copy.folder))


def test_a_record_of_before_the_stamps_is_read_and_kept(copy: RunRecord) -> None:
    (copy.folder / "provenance.json").write_text(json.dumps(copy.provenance))
    summary = json.loads((copy.folder / "record.json").read_text())
    for name in ("context", "predicted"):
        summary.pop(name)
    (copy.folder / "record.json").write_text(stamp.canonical(summary))
    old = RunRecord(copy.folder)
    assert record.verify(old) == [] and len(old.steps) and old.weights()
    before = content(copy.folder)
    todo = engine.plan(study(1), copy.folder.parent)
    assert todo.done == [old.key] and todo.tasks == [] and content(copy.folder) == before


def test_a_whole_number_beyond_all_floats_is_no_number() -> None:
    assert (
        record_fields.finite(10**308) and not record_fields.finite(10**400) and not record_fields.finite(float("inf"))
    )
