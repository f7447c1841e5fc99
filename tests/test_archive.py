"""Archives: what an import makes of good ones, and of hostile ones."""

import hashlib
import io
import json
import os
import pickle
import stat
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from faults.test_kills import sound, study
from rich.console import Console

from bench.cli.commands.archive import import_command
from bench.execution import engine
from bench.records import archive, record
from bench.records.finished import finished_studies
from bench.records.record import RunRecord
from bench.records.stamp import canonical, plain, stamped
from bench.reporting import study_outputs
from registry.errors import BenchError


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with a finished study of two runs, and the study as an archive, a.zip."""
    results = tmp_path_factory.mktemp("made")
    records = engine.execute(engine.plan(study(2), results / "runs"), results / "runs")
    title = "<script>alert(1)</script> [/bold] on toy"
    study_outputs.write_outputs(Console(quiet=True), records, title, None, "bench run x", results / "studies" / "x")
    archive.write(next(finished_studies(results)), results / "runs", results / "a.zip")
    return results


def packed(made: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(made / "a.zip") as whole:
        return {name: whole.read(name) for name in whole.namelist()}


def test_there_and_back_is_the_same_and_what_is_there_is_kept(made: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    done = archive.read(made / "a.zip", runs)
    assert sound(runs) == sound(made / "runs") and set(done.new) == set(done.keys)
    first = runs / done.keys[0]
    ours = {**RunRecord(first).provenance, "device": "ours"}
    (first / "provenance.json").write_text(canonical(stamped(ours, (first / "record.json").read_bytes())))
    (runs / done.keys[1] / "record.json").unlink()
    assert archive.read(made / "a.zip", runs).new == (done.keys[1],)
    assert "ours" in (first / "provenance.json").read_text() and len(sound(runs)) == 2
    archive.write(next(finished_studies(made)), made / "runs", tmp_path / "b.zip")
    assert (tmp_path / "b.zip").read_bytes() == (made / "a.zip").read_bytes()


def test_the_report_is_made_anew_and_escapes_names(made: Path, tmp_path: Path) -> None:
    import_command.main([str(made / "a.zip"), "--results", str(tmp_path)], standalone_mode=False)
    (folder,) = (tmp_path / "studies").iterdir()
    page = (folder / "report.html").read_text()
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page


def test_an_altered_run_is_not_exported(made: Path, tmp_path: Path) -> None:
    finished = next(finished_studies(made))
    archive.read(made / "a.zip", tmp_path)
    (tmp_path / finished.keys[0] / "curve.parquet").write_bytes(b"x")
    with pytest.raises(BenchError, match=r"curve\.parquet was altered"):
        archive.write(finished, tmp_path, tmp_path / "b.zip")
    assert not (tmp_path / "b.zip").exists()


def entry(files: dict[str, bytes], ending: str) -> str:
    return next(name for name in files if name.endswith(ending))


def _changed_json(ending: str, **changes: object) -> Callable[[dict[str, bytes]], None]:
    def change(files: dict[str, bytes]) -> None:
        name = entry(files, ending)
        files[name] = json.dumps({**json.loads(files[name]), **changes}).encode()

    return change


def _replaced(ending: str, content: bytes) -> Callable[[dict[str, bytes]], None]:
    return lambda files: files.__setitem__(entry(files, ending), content)


def _added(name: str, content: bytes = b"x") -> Callable[[dict[str, bytes]], None]:
    return lambda files: files.__setitem__(name, content)


def _forged_table(files: dict[str, bytes]) -> None:
    """A table of other columns, whose digest is right."""
    name = entry(files, "steps.parquet")
    target = io.BytesIO()
    pd.DataFrame({"a": [1.0]}).to_parquet(target)
    files[name] = target.getvalue()
    about = name.replace("steps.parquet", "record.json")
    summary = json.loads(files[about])
    summary["files"]["steps.parquet"] = hashlib.sha256(files[name]).hexdigest()
    files[about] = json.dumps(summary).encode()
    told = name.replace("steps.parquet", "provenance.json")
    files[told] = canonical(stamped(plain(json.loads(files[told])), files[about])).encode()


KEY = "0" * 32


@pytest.mark.parametrize(
    ("attack", "says"),
    [
        (_added("../../evil"), "no part of a study"),
        (_added("/etc/evil"), "no part of a study"),
        (_added(f"runs/{KEY}/../../evil"), "no part of a study"),
        (_added(f"runs/{KEY}/model.pkl", pickle.dumps(os.getcwd)), "no part of a study"),
        (_added(f"runs/{KEY}\\record.json"), "no part of a study"),
        (_added(f"runs/{KEY}/record.json"), "not those that study.json lists"),
        (lambda files: files.pop(entry(files, "config.json")), "not whole"),
        (lambda files: files.pop("study.json"), "has no study.json"),
        (_replaced("study.json", b"[" * 100_000), "no JSON"),
        (_changed_json("study.json", title=".."), "no title"),
        (_changed_json("study.json", title="a\nb"), "no title"),
        (_changed_json("study.json", keys=["../x"]), "not those that"),
        (_changed_json("record.json", key=KEY), "not its own"),
        (_changed_json("record.json", spec="x" * 1000), "spec"),
        (_changed_json("record.json", horizon="40"), "horizon"),
        (_changed_json("record.json", metrics={"rmsse": float("nan")}), "metrics"),
        (_changed_json("record.json", surprise=1), "unknown key, 'surprise'"),
        (_changed_json("provenance.json", started_ms=10**30), "started_ms"),
        (_replaced("curve.parquet", b"PAR1"), "not the file that was recorded"),
        (_replaced("record.json", b"\x00" * (5 << 20)), "larger than 4 MiB"),
        (_forged_table, "has not the columns"),
    ],
)
def test_a_hostile_archive_is_one_sentence_and_leaves_nothing(
    attack: Callable[[dict[str, bytes]], None], says: str, made: Path, tmp_path: Path
) -> None:
    files = packed(made)
    attack(files)
    with zipfile.ZipFile(tmp_path / "evil.zip", "w", zipfile.ZIP_DEFLATED) as evil:
        for name, content in files.items():
            evil.writestr(name, content)
    with pytest.raises(BenchError, match=says) as error:
        archive.read(tmp_path / "evil.zip", tmp_path / "in" / "runs")
    assert "\n" not in str(error.value)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["evil.zip", "in", "runs"]


def test_links_and_entries_that_lie_about_their_size(made: Path, tmp_path: Path) -> None:
    files = packed(made)
    name = entry(files, "config.json")
    link = zipfile.ZipInfo(name)
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "link.zip", "w") as evil:
        for n, content in files.items():
            evil.writestr(link if n == name else n, b"/etc/passwd" if n == name else content)
    with pytest.raises(BenchError, match="a link or encrypted"):
        archive.read(tmp_path / "link.zip", tmp_path / "runs")
    # A bomb: megabytes of zeros that say they are a hundred bytes.
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as evil:
        for n, content in files.items():
            evil.writestr(n, bytes(3 << 20) if n == name else content)
    raw = bytearray((tmp_path / "bomb.zip").read_bytes())
    at = raw.rindex(name.encode()) - 46 + 24  # uncompressed size in the central directory
    assert struct.unpack_from("<I", raw, at) == (3 << 20,)
    struct.pack_into("<I", raw, at, 100)
    (tmp_path / "bomb.zip").write_bytes(raw)
    with pytest.raises(BenchError):
        archive.read(tmp_path / "bomb.zip", tmp_path / "runs")
    assert not list(record.all_records(tmp_path / "runs"))


def test_a_study_that_is_not_whole_is_not_exported(made: Path, tmp_path: Path) -> None:
    finished = replace(next(finished_studies(made)), keys=[KEY])
    with pytest.raises(BenchError, match="make it again with `bench run x`"):
        archive.write(finished, made / "runs", tmp_path / "c.zip")
