"""Bad input to every reader: each case ends in a result or in one sentence, never in a traceback."""

import io
import json
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from datasets.test_ardupilot_logs import dataflash, flight
from datasets.test_crazyflie_logs import whole as crazyflie_log
from datasets.test_folder import TOML, table
from datasets.test_matlab_logs import TANK, save
from faults.test_kills import study
from fuzz.inputs import EDITS, VALUES, WORDS, answers, cases, edited, one_sentence
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from test_import import ROTORS, bag, telemetry, ulog

from bench.claims import claim, gathering
from bench.execution import engine
from bench.experiment.config import changed, from_json, to_json
from bench.experiment.notation import parse
from bench.records import archive
from bench.records.finished import finished_studies
from bench.records.record import RunRecord
from bench.records.record_check import check as check_record
from bench.reporting import study_outputs
from bench.training.predict import read_table
from registry import model_file
from registry.datasets.folder.dataset import check as check_folder
from registry.datasets.folder.draft import draft
from registry.datasets.logs.importing import convert
from registry.datasets.reading.matlab import read_cell_structs, read_v5

CLAIMS = Path(__file__).parents[2] / "results" / "paper" / "claims.toml"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def folder(place: Path) -> Path:
    here = place / "folder"
    here.mkdir()
    (here / "dataset.toml").write_text(TOML, encoding="utf-8")
    return here


MODEL = """system = "quadrotor"
[physics]
mass = 0.5
inertia = [3.65e-3, 3.68e-3, 7.03e-3]
[[effects]]
id = "rotor_drag"
k_d = 8.9e-5
"""


def as_parquet(path: Path) -> None:
    table().to_parquet(path)


def cells(path: Path) -> None:
    made = np.empty((2, 1), object)
    for i in range(2):
        made[i, 0] = {"Motors": np.ones((5, 4))}
    scipy.io.savemat(path, {"flights": made})


def cells_of_v73(path: Path) -> None:
    with h5py.File(path, "w") as file:
        refs = file.create_dataset("flights", (2, 1), dtype=h5py.ref_dtype)
        for i in range(2):
            group = file.create_group(f"#refs#/{i}")
            group["Motors"] = np.ones((4, 5))
            refs[i, 0] = group.ref


def matrices(path: Path) -> None:
    scipy.io.savemat(path, {"u": np.ones((1, 40)), "y": np.ones((40, 1))}, do_compression=True)


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content, encoding="utf-8")


def drafted(path: Path) -> None:
    (path.parent / "dataset.toml").write_text(draft(path.parent), encoding="utf-8")
    check_folder(path.parent)


def imported(path: Path) -> None:
    """As a log, into a folder that is read as a user's next command does."""
    out = path.parent / "imported"
    shutil.rmtree(out, ignore_errors=True)
    convert([path], out)
    check_folder(out)


def folder_of(path: Path) -> None:
    check_folder(path.parent)


def motors_of(path: Path) -> None:
    read_cell_structs(path, ["Motors"])


CSV, UNITS = table().to_csv(index=False), "".join(f"{10 * k},{k},{k % 3}\n" for k in range(30))
BLOCK = "".join(f"{10 * k},{k},{k % 7},{k / 9}\n" for k in range(300))
FILES: dict[str, tuple[str, Callable[[Path], object], Sequence[Callable[[Path], object]]]] = {
    "csv": ("a.csv", text(CSV), (folder_of, read_table)),
    "csv with units": ("b.csv", text(f"time,pump,level\nms,L/min,mm\n{UNITS}"), (drafted,)),
    "parquet": ("a.parquet", as_parquet, (folder_of,)),
    "description": ("dataset.toml", text(TOML), (folder_of,)),
    "model": ("model.toml", text(MODEL), (model_file.read, lambda path: model_file.read(path, "quadrotor"))),
    "cells": ("a.mat", cells, (motors_of,)),
    "cells of 7.3": ("a.mat", cells_of_v73, (motors_of,)),
    "matrices": ("a.mat", matrices, (lambda path: read_v5(path, ["u", "y"]),)),
    "crazyflie 1": ("log00", lambda path: path.write_bytes(crazyflie_log(1)), (imported,)),
    "crazyflie 2": ("log00", lambda path: path.write_bytes(crazyflie_log(2)), (imported,)),
    "cfclient": ("block.csv", text(f"Timestamp,gyro.x,gyro.y,gyro.z\n{BLOCK}"), (imported,)),
    "px4": ("flight.ulg", lambda path: ulog(path, telemetry(rate=20), ROTORS), (imported,)),
    "ros": ("run.bag", lambda path: bag(path, 1), (imported,)),
    "ardupilot": ("12.bin", lambda path: path.write_bytes(dataflash(flight())), (imported,)),
    **{f"matlab {v}": ("a.mat", lambda path, v=v: save(path, v, TANK), (imported,)) for v in ("5", "7", "7.3")},
}
"""File, what makes it whole, and what reads it."""
BESIDE = {"csv": {"dataset.toml": TOML}, "parquet": {"dataset.toml": TOML.replace("*.csv", "*.parquet")}}
BESIDE["description"] = {"a.csv": CSV}


@pytest.fixture(scope="module", params=FILES)
def file(request: pytest.FixtureRequest, place: Path) -> tuple[Path, bytes, Sequence[Callable[[Path], object]]]:
    """A file in a folder of its own, its content when it is whole, and its readers, which take it then."""
    name, make, readers = FILES[request.param]
    path = place / request.param / name
    path.parent.mkdir()
    for other, content in BESIDE.get(request.param, {}).items():
        (path.parent / other).write_text(content, encoding="utf-8")
    make(path)
    for read in readers if request.param != "cfclient" else ():  # which does not tell what drives it
        read(path)
    return path, path.read_bytes(), readers


@cases(150)
@given(edits=EDITS)
def test_a_file_with_other_bytes(
    file: tuple[Path, bytes, Sequence[Callable[[Path], object]]], edits: list[tuple[float, bytes, int]]
) -> None:
    path, whole, readers = file
    path.write_bytes(edited(whole, edits))
    for read in readers:
        one_sentence(lambda read=read: read(path))


@cases(200)
@given(cells=st.dictionaries(st.tuples(st.integers(0, 19), st.integers(0, 16)), st.sampled_from(WORDS), max_size=5))
def test_csv_of_words(folder: Path, cells: dict[tuple[int, int], str]) -> None:
    data = table().astype(object)
    for at, word in cells.items():
        data.iloc[at] = word
    data.to_csv(folder / "a.csv", index=False)
    one_sentence(lambda: check_folder(folder))


@cases(150)
@given(edits=EDITS, first=st.integers(0, 40))
def test_claims_toml(place: Path, edits: list[tuple[float, bytes, int]], first: int) -> None:
    path, parts = place / "claims.toml", CLAIMS.read_text().split("[[claim]]")
    kept = "[[claim]]".join(["", *parts[1 + first : 4 + first]])
    path.write_bytes(edited(kept.encode(), edits))
    one_sentence(lambda: claim.read(path))


SPEC_PARTS = [
    "LSTM",
    "MLFC",
    "GRU",
    "NARX",
    "TCN",
    "LRU",
    "SUBNET",
    "Neural ODE",
    "Hybrid",
    "linear",
    "LSTM TDL",
    "Washout",
    "MLP",
    "RNN",
    "Optimized",
    "Encoder",
    ":",
]
SPEC_PARTS += [" - ", "x", "×", "1x50", "60x10", "10", "0", "-1", "９", "1e3", "  ", "–", "\n", "(", ")", "²", "٣"]


@cases(300)
@given(spec=st.one_of(st.lists(st.sampled_from(SPEC_PARTS), max_size=8).map("".join), st.text(max_size=30)))
def test_spec(spec: str) -> None:
    one_sentence(lambda: parse(spec))


@pytest.fixture(scope="module")
def results(place: Path) -> Path:
    made = place / "results"
    records = engine.execute(engine.plan(study(1), made / "runs"), made / "runs")
    study_outputs.write_outputs(Console(quiet=True), records, "s", None, "bench run s", made / "studies" / "s")
    (finished,) = finished_studies(made)
    archive.write(finished, made / "runs", place / "s.zip")
    return made


@cases(200)
@given(
    path=st.sampled_from(
        [
            "horizon",
            "training",
            "training.updates",
            "predictor",
            "predictor.name",
            "initializer.hidden",
            "dataset",
            "outputs",
            "seed",
            "new",
        ]
    ),
    value=VALUES,
)
def test_configuration(path: str, value: Any) -> None:
    plain = to_json(study(1)[0])
    part, _, name = path.rpartition(".")
    (plain[part] if part else plain)[name] = value
    one_sentence(lambda: from_json(plain).resolved())
    if isinstance(value, str) and path != "new":
        one_sentence(lambda: changed(study(1)[0], {path: value}))


def _records(results: Path) -> Iterator[tuple[Path, Path]]:
    (folder,) = (p for p in (results / "runs").iterdir())
    copy = results / "copy" / folder.name
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy)
    yield folder, copy


def _read_all(record: RunRecord) -> None:
    for name in ("summary", "config", "provenance", "steps", "curve", "windows"):
        one_sentence(lambda name=name: getattr(record, name))
    one_sentence(record.weights)
    one_sentence(lambda: check_record(record))


@cases(250)
@given(
    edits=EDITS,
    name=st.sampled_from(["record.json", "config.json", "provenance.json", "steps.parquet", "model.safetensors"]),
)
def test_record(results: Path, edits: list[tuple[float, bytes, int]], name: str) -> None:
    for whole, copy in _records(results):
        (copy / name).write_bytes(edited((whole / name).read_bytes(), edits))
        _read_all(RunRecord(copy))


@cases(200)
@given(file=st.sampled_from(["record.json", "provenance.json"]), data=st.data())
def test_record_of_wrong_values(results: Path, file: str, data: st.DataObject) -> None:
    for whole, copy in _records(results):
        content = json.loads((whole / file).read_text())
        content[data.draw(st.sampled_from(sorted(content)))] = data.draw(VALUES)
        (copy / file).write_text(json.dumps(content))
        _read_all(RunRecord(copy))


@cases(150)
@given(edits=EDITS)
def test_study_json(place: Path, results: Path, edits: list[tuple[float, bytes, int]]) -> None:
    here = place / "again" / "studies" / "s"
    here.mkdir(parents=True, exist_ok=True)
    (here / "study.json").write_bytes(edited((results / "studies" / "s" / "study.json").read_bytes(), edits))
    one_sentence(lambda: list(finished_studies(place / "again")))
    one_sentence(lambda: list(gathering.folders(place / "again")))
    one_sentence(lambda: answers(["runs", "errors", "--study", "s", "--results", str(place / "again")]))


@cases(250)
@given(edits=EDITS)
def test_zip(place: Path, results: Path, edits: list[tuple[float, bytes, int]]) -> None:
    path, runs = place / "edited.zip", place / "imported"
    path.write_bytes(edited((place / "s.zip").read_bytes(), edits))
    one_sentence(lambda: archive.read(path, runs))
    assert not [p for p in runs.glob(".import-*")]


@cases(200)
@given(
    name=st.sampled_from(["record.json", "config.json", "provenance.json", "study.json"]),
    key=st.integers(0, 30),
    value=VALUES,
)
def test_zip_of_wrong_values(place: Path, results: Path, name: str, key: int, value: Any) -> None:
    path, packed = place / "wrong.zip", io.BytesIO((place / "s.zip").read_bytes())
    with zipfile.ZipFile(packed) as whole, zipfile.ZipFile(path, "w") as wrong:
        for info in whole.infolist():
            content = whole.read(info)
            if info.filename.endswith(name):
                plain = json.loads(content)
                plain[sorted(plain)[key % len(plain)]] = value
                content = json.dumps(plain).encode()
            wrong.writestr(info, content)
    one_sentence(lambda: archive.read(path, place / "imported2"))
