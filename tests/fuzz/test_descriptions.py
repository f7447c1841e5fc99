"""Descriptions that are whole TOML or JSON and say something wrong: every key, every kind of value, every reader."""

import json
import shutil
import tomllib
from datetime import timedelta
from pathlib import Path
from typing import Any

import known_fleet
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from datasets.test_folder import TOML, table
from diagnose import samples
from faults.test_foreign_code import TOML as SPRING
from faults.test_foreign_code import spring
from faults.test_kills import study
from fuzz.inputs import altered, answers, cases, one_sentence, toml
from hypothesis import given
from hypothesis import strategies as st
from optuna.distributions import IntDistribution, distribution_to_json

from bench.claims import claim
from bench.diagnose.manoeuvre import rivals
from bench.experiment.config import to_json
from bench.fleet import members, stored
from bench.fleet.read_answers import answer_of
from bench.sweep import journal
from registry.datasets.folder.dataset import check as check_folder

CLAIMS = Path(__file__).parents[2] / "results" / "paper" / "claims.toml"
MODEL = {
    "system": "quadrotor",
    "input_signal": "rotor_speed",
    "physics": {
        "mass": 0.5,
        "inertia": [3.65e-3, 3.68e-3, 7.03e-3],
        "rotor_positions": [[0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, -0.1, 0.0], [-0.1, 0.1, 0.0]],
        "rotor_directions": [1.0, -1.0, 1.0, -1.0],
    },
    "effects": [
        {"id": "rotor_drag", "k_d": 8.9e-5},
        {
            "id": "learned_term",
            "axis": "force_z",
            "signals": ["speed"],
            "shape": "linear",
            "values": [0.1],
            "span": [0.0, 3.0],
        },
        {
            "id": "hidden_mode",
            "axes": ["force_x"],
            "drivers": ["force_x"],
            "frequency": 1.0,
            "damping": 0.1,
            "gains": [0.1, 0.1],
        },
    ],
}
FLEET = tomllib.loads(known_fleet.DESCRIPTION + 'vehicle = "a"\ndate = "2026-03-01"\n' + known_fleet.SIGNALS)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("descriptions")
    (here / "spring").mkdir()
    spring(here / "spring")
    (here / "flights").mkdir()
    table(400).to_csv(here / "flights" / "a.csv", index=False)
    for name in "abc":
        known_fleet.folder(here / "fleet" / name, 1.0)
    return here


@cases(150)
@given(said=altered(tomllib.loads(SPRING)))
def test_dataset_toml_of_a_system(place: Path, said: dict[str, Any]) -> None:
    (place / "spring" / "dataset.toml").write_text(toml(said), encoding="utf-8")
    one_sentence(lambda: answers(["data", "check", str(place / "spring")]))


@cases(150)
@given(said=altered(tomllib.loads(TOML)))
def test_dataset_toml_of_a_vehicle(place: Path, said: dict[str, Any]) -> None:
    (place / "flights" / "dataset.toml").write_text(toml(said), encoding="utf-8")
    one_sentence(lambda: answers(["data", "check", str(place / "flights")]))


@cases(150)
@given(said=altered(MODEL))
def test_model_toml(place: Path, said: dict[str, Any]) -> None:
    (place / "model.toml").write_text(toml(said), encoding="utf-8")
    one_sentence(lambda: answers(["export-model", str(place / "model.toml"), "--to", "numpy"]))


@cases(100)
@given(data=st.data(), first=st.integers(0, 60))
def test_claims_toml(place: Path, data: st.DataObject, first: int) -> None:
    whole = tomllib.loads(CLAIMS.read_text(encoding="utf-8"))
    kept = {**whole, "claim": whole["claim"][first : first + 2]}
    (place / "claims.toml").write_text(toml(data.draw(altered(kept))), encoding="utf-8")
    one_sentence(lambda: claim.read(place / "claims.toml"))


KINDS = {
    "text": (pa.string(), st.text(max_size=6)),
    "bytes": (pa.binary(), st.binary(max_size=4)),
    "bool": (pa.bool_(), st.booleans()),
    "int": (pa.int64(), st.integers(-(2**63), 2**63 - 1)),
    "unsigned": (pa.uint64(), st.integers(0, 2**64 - 1)),
    "float": (pa.float64(), st.floats()),
    "half": (pa.float16(), st.floats(width=16)),
    "decimal": (pa.decimal128(20, 3), st.decimals(-(10**9), 10**9, places=3)),
    "moment": (pa.timestamp("us"), st.datetimes()),
    "day": (pa.date32(), st.dates()),
    "hour": (pa.time64("us"), st.times()),
    "span": (pa.duration("us"), st.timedeltas(timedelta(-10000), timedelta(10000))),
    "list": (pa.list_(pa.float64()), st.lists(st.floats(), max_size=2)),
    "struct": (pa.struct([("a", pa.int64())]), st.fixed_dictionaries({"a": st.integers(0, 9)})),
    "null": (pa.null(), st.none()),
    "word": (pa.dictionary(pa.int8(), pa.string()), st.sampled_from("ab")),
}
NO_NUMBERS = ("moment", "day", "hour", "span", "list", "struct", "null", "bytes")


@cases(150)
@given(kind=st.sampled_from(sorted(KINDS)), column=st.sampled_from(["t", "f", "x"]), data=st.data())
def test_parquet_of_every_kind_of_column(place: Path, kind: str, column: str, data: st.DataObject) -> None:
    """A column that holds no numbers is never read as numbers."""
    folder, (type_, values) = place / "kinds", KINDS[kind]
    folder.mkdir(exist_ok=True)
    told = SPRING.replace("*.csv", "*.parquet") + "\n"
    where = data.draw(st.sampled_from(["", 'vehicle = {column = "v"}\n', 'date = {column = "v"}\n']))
    (folder / "dataset.toml").write_text(where + told)
    cells = data.draw(st.lists(st.none() | values, min_size=4, max_size=4))
    cells += cells[:1] * 4
    numbers: dict[str, Any] = {"t": [i / 50 for i in range(8)], "x": [0.0] * 8, "v": [1.0] * 8, "f": [0.5] * 8}
    numbers["v" if where else column] = pa.array(cells, type_)
    try:
        pq.write_table(pa.table(numbers), folder / "a.parquet")
    except (pa.ArrowNotImplementedError, pa.ArrowInvalid):
        return
    read: list[object] = []
    one_sentence(lambda: read.append(check_folder(folder)))
    assert not (read and kind in NO_NUMBERS and not where), kind


@cases(100)
@given(verdict=st.sampled_from(["named", "tie"]), data=st.data())
def test_diagnosis_json(place: Path, verdict: str, data: st.DataObject) -> None:
    (place / "diagnosis.json").write_text(json.dumps(data.draw(altered(SAID[verdict]))))
    one_sentence(lambda: rivals._read(place / "diagnosis.json"))


CELLS = st.sampled_from(["a", "7", "7.0", "2026-01-02", "nan", " "]) | st.text(max_size=8)
SAID = {v: samples.ALL[v]().to_json() for v in ("named", "tie")}


@cases(100)
@given(said=altered(FLEET), cell=st.text(max_size=8))
def test_a_fleet_of_folders(place: Path, said: dict[str, Any], cell: str) -> None:
    (place / "fleet" / "b" / "dataset.toml").write_text(toml(said), encoding="utf-8")
    one_sentence(lambda: members.members(str(place / "fleet")))


@cases(100)
@given(cells=st.lists(CELLS, min_size=4, max_size=4))
def test_a_fleet_of_columns(place: Path, cells: list[str]) -> None:
    folder = place / "columns"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    told = 'vehicle = {column = "tail"}\ndate = {column = "day"}\n'
    (folder / "dataset.toml").write_text(known_fleet.DESCRIPTION + told + known_fleet.SIGNALS)
    for i in (0, 2):
        rows = pd.DataFrame({"t": [0, 0.1, 0.2], "h": 1.0, "tail": cells[i], "day": cells[i + 1]})
        rows.to_csv(folder / f"r{i}.csv", index=False)
    one_sentence(lambda: members.members(str(folder)))


@cases(100)
@given(data=st.data(), name=st.sampled_from(["answer.json", "diagnosis.json"]))
def test_a_kept_answer_on_a_vehicle(place: Path, data: st.DataObject, name: str) -> None:
    member, out = members.Member("a", "", "a", "", ""), place / "kept"
    kept = stored.write(
        out, member, "key", {"diagnosis.json": json.dumps(SAID["named"]), "diagnosis.html": "", "model.toml": ""}
    )
    path = kept.folder / name
    path.write_text(json.dumps(data.draw(altered(json.loads(path.read_text())))))
    again = stored.place(out, member)
    if again.key:
        one_sentence(lambda: answer_of(member, again))


SWEEP = {
    "title": "LSTM",
    "configs": [to_json(study(1)[0])],
    "space": {"training.batch": json.loads(distribution_to_json(IntDistribution(8, 64)))},
    "objectives": ["RMSSE"],
    "seed": 0,
    "command": "bench sweep LSTM",
}


@cases(100)
@given(said=altered(SWEEP), resume=st.booleans())
def test_sweep_json(place: Path, said: dict[str, Any], resume: bool) -> None:
    folder = place / "results" / "sweeps" / "s"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / journal.DEFINITION).write_text(json.dumps(said))
    one_sentence(lambda: journal.read(folder))
    space = {"training.batch": IntDistribution(8, 64)}
    asked = journal.Sweep("LSTM", tuple(study(1)), space, ("RMSSE",), 0, "bench sweep LSTM")
    one_sentence(lambda: journal.begin(asked, folder, resume) and None)
