"""Fleets: which vehicles there are, what is kept and done again, what the vehicles say together, how it is shown."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import known_fleet
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from parsed_page import Parsed
from simulated_fleet import vehicle

import bench
from bench.cli import cli
from bench.diagnose.logs.load import load
from bench.fleet import page, stored
from bench.fleet.findings import drifts, quantities
from bench.fleet.fleet import PAGE, VALUES, Plan, conclude, execute, plan
from bench.fleet.members import Member, is_fleet, members, recordings
from bench.fleet.options import Options, environment
from bench.fleet.result import Answer, FleetDiagnosis, Number, schema
from registry.datasets.folder.dataset import Folder
from registry.errors import BenchError

EVIL = "<script>alert(1)</script>[/]"
DRAGS = [0.30, 0.31, 0.29, 0.305, 0.295, 0.30, 0.60]


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Ids of the vehicles that were diagnosed, a line each."""
    path = tmp_path / "log"
    path.touch()
    monkeypatch.setenv(known_fleet.LOG, str(path))
    return path


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Seven vehicles, the last of which has twice the drag."""
    for i, value in enumerate(DRAGS):
        known_fleet.folder(tmp_path / "fleet" / f"n{i}", value)
    return tmp_path / "fleet"


def planned(fleet: Path, asked: Options | None = None, out: Path | None = None) -> Plan:
    return plan(members(str(fleet)), asked or Options(), out or fleet / "diagnosis")


def done(fleet: Path, asked: Options | None = None, out: Path | None = None, workers: int = 1) -> FleetDiagnosis:
    todo = planned(fleet, asked, out)
    execute(todo, workers, do=known_fleet.read)
    return conclude(todo, "bench diagnose fleet")


def texts(out: Path) -> dict[str, bytes]:
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file()}


# ------------------------------------------------------------------------------------------------ which vehicles


def test_a_folder_of_folders_is_a_fleet(fleet: Path) -> None:
    (fleet / "notes").mkdir()
    (fleet / "n1" / "dataset.toml").write_text((fleet / "n1" / "dataset.toml").read_text() + "\n[oops]\n")
    text = (fleet / "n2" / "dataset.toml").read_text()
    (fleet / "n2" / "dataset.toml").write_text('vehicle = "Anna"\ndate = 2026-03-01\n' + text)
    found = members(str(fleet))
    assert found.name == "fleet" and found.notes == ("Folders without a dataset.toml are left out: notes.",)
    assert [(m.vehicle, m.date, m.id) for m in found.members][:2] == [("Anna", "2026-03-01", "n2"), ("n0", "", "n0")]
    assert "unknown key 'oops'" in next(m for m in found.members if m.id == "n1").problem
    assert [m.id for m in members(str(fleet), ("Anna", "n3")).members] == ["n2", "n3"]
    with pytest.raises(BenchError, match=r"--vehicle Ana: .* did you mean Anna"):
        members(str(fleet), ("Ana",))


def test_columns_tell_vehicles_and_days(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text(
        known_fleet.DESCRIPTION + 'vehicle = {column = "tail"}\ndate = {column = "day"}\n' + known_fleet.SIGNALS
    )
    for i, (tail, day) in enumerate(
        [("7", "2026-01-02"), ("8", "2026-01-02"), ("7", "2026-01-02 09:00"), ("7", "2026-01-03")]
    ):
        known_fleet.write(tmp_path / f"r{i}.csv", 1.0 + i, tail, day)
    known_fleet.write(tmp_path / "r8.csv", 1.0, "7", "soon")
    found = members(str(tmp_path)).members
    assert [(m.id, m.only) for m in found[:3]] == [
        ("7, 2026-01-02", ("r0.csv", "r2.csv")), ("7, 2026-01-03", ("r3.csv",)), ("8, 2026-01-02", ("r1.csv",)),
    ]  # fmt: skip
    assert found[3].id == "r8.csv" and "'soon' is no date" in found[3].problem
    assert [r.name for r in found[0].folder.load().recordings] == ["r0", "r2"]
    with pytest.raises(BenchError, match="holds the vehicles that column 'tail' names"):
        load(tmp_path)


def test_every_recording_of_a_folder_is_a_member(fleet: Path) -> None:
    source = str(fleet / "n0")
    found = recordings(source)
    assert (found.kind, [(m.id, m.only, m.part) for m in found.members]) == (
        "recording", [(f"ball_{i}", (f"ball_{i}.csv",), ("--each-recording",)) for i in (0, 1)],
    )  # fmt: skip
    assert [r.name for r in found.members[1].folder.load().recordings] == ["ball_1"]
    known_fleet.write(fleet / "n0" / "ball_2.csv", 1.0)
    assert [m.id for m in recordings(source, ("ball_1",)).members] == ["ball_0", "ball_2"]
    for left_out, says in ((("ball_1", "ball_2"), "one recording"), (("bal_1",), "did you mean ball_1")):
        with pytest.raises(BenchError, match=says):
            recordings(source, left_out)
    with pytest.raises(BenchError, match=r"has no dataset\.toml"):
        recordings(str(fleet))


def test_a_file_of_two_vehicles_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text(
        known_fleet.DESCRIPTION + 'vehicle = {column = "tail"}\n' + known_fleet.SIGNALS
    )
    (tmp_path / "r0.csv").write_text("t,h,tail\n0,1,a\n.1,1,b\n")
    with pytest.raises(BenchError, match="column 'tail': 'a' and 'b', where a recording has one vehicle: split"):
        Folder(str(tmp_path)).load()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("vehicle = 7", "vehicle must be a text or"),
        ('vehicle = ""', "vehicle must be a text or"),
        ("vehicle = {colum = 'x'}", "colum"),
        ("vehicle = {column = 1}", "must name a column"),
        ('date = "tomorrow"', "'tomorrow' is no date"),
        ("date = 12:00:00", "is no date"),
    ],
)
def test_a_wrong_mark_is_one_sentence(tmp_path: Path, line: str, says: str) -> None:
    known_fleet.folder(tmp_path / "a", 1.0, f"{line}\n")
    with pytest.raises(BenchError, match=says):
        Folder(str(tmp_path / "a")).description  # noqa: B018


def test_one_vehicle_and_no_vehicle_are_no_fleet(tmp_path: Path) -> None:
    known_fleet.folder(tmp_path / "fleet" / "only", 1.0)
    assert is_fleet(str(tmp_path / "fleet")) and not is_fleet(str(tmp_path / "fleet" / "only"))
    with pytest.raises(BenchError, match=r"holds one vehicle, only: `bench diagnose .*only` is for one dataset\.toml"):
        members(str(tmp_path / "fleet"))
    with pytest.raises(BenchError, match="is no fleet: give a folder of folders"):
        members(str(tmp_path / "nowhere"))


def test_names_of_folders_are_plain_and_never_equal() -> None:
    names = ["n1", "N1", "../n1", "a b", "a-b", EVIL, "/", "..", "ü" * 300, "a, 2026-01-01"]
    slugs = [Member(n, "", n, "", "").slug for n in names]
    assert len(set(slugs)) == len(names) and slugs[0] == "n1"
    assert all(s and "/" not in s and s.strip(".") and len(s) < 100 and s.isascii() for s in slugs)


# ------------------------------------------------------------------------------------------------ what is kept


def test_what_is_kept_is_not_done_again(fleet: Path, log: Path) -> None:
    done(fleet)
    assert sorted(log.read_text().split()) == [f"n{i}" for i in range(7)]
    before = texts(fleet / "diagnosis")
    done(fleet)
    assert len(log.read_text().split()) == 7 and texts(fleet / "diagnosis") == before


def test_what_changed_is_done_again_and_nothing_else(fleet: Path, log: Path) -> None:
    done(fleet)
    vehicles = fleet / "diagnosis" / stored.VEHICLES
    known_fleet.write(fleet / "n1" / "ball_0.csv", 0.4)
    known_fleet.write(fleet / "n1" / "ball_1.csv", 0.4)
    (fleet / "n2" / "dataset.toml").write_text((fleet / "n2" / "dataset.toml").read_text() + "# seen\n")
    (vehicles / "n3" / "diagnosis.json").write_text("{}")  # damaged
    shutil.rmtree(vehicles / "n4")
    (vehicles / "n5" / stored.ANSWER).write_text("[1]")
    (fleet / "n6" / "notes.txt").write_text("not of the data")
    log.write_text("")
    found = done(fleet)
    assert sorted(log.read_text().split()) == ["n1", "n2", "n3", "n4", "n5"]
    assert next(a for a in found.answers if a.id == "n1").numbers[0].value == 0.4
    log.write_text("")
    done(fleet, Options(horizon_s=0.3))
    assert len(log.read_text().split()) == 7


def test_an_answer_of_other_code_is_sought_anew(fleet: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done(fleet)
    monkeypatch.setattr("bench.fleet.options.environment", lambda: {"code": "other"})
    assert len(planned(fleet).todo) == 7


def test_a_worker_of_another_kind_is_refused(fleet: Path) -> None:
    from bench.fleet.work import work

    todo = planned(fleet)
    member = todo.todo[0]
    with pytest.raises(BenchError, match="would give other results: its cpu differs"):
        work(known_fleet.read, member, todo.options, todo.keys[member.id], {**environment(), "cpu": "other"})
    said, files = work(known_fleet.read, member, todo.options, "0" * 32, dict(environment()))
    assert "changed meanwhile" in said and not files


def test_ctrl_c_loses_nothing_that_was_finished(fleet: Path, log: Path) -> None:
    todo = planned(fleet)
    with pytest.raises(KeyboardInterrupt):
        execute(todo, do=known_fleet.interrupted)
    assert len(log.read_text().split()) == 2
    found = done(fleet)
    assert len(log.read_text().split()) == 7 and {a.verdict for a in found.answers} == {"named"}


def test_two_processes_give_the_same_bytes_as_one(fleet: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    done(fleet, out=one)
    done(fleet, out=two, workers=2)
    assert texts(one) == texts(two) and len(texts(one)) == 7 * 4 + 2
    assert json.loads((one / "vehicles/n6/diagnosis.json").read_text())["effects"][0]["parameters"]["c"]["value"] == 0.6


def test_what_is_wrong_with_one_stops_nobody(fleet: Path) -> None:
    for i, value in ((1, math.nan), (2, 13.0), (3, -1.0)):
        shutil.rmtree(fleet / f"n{i}")
        known_fleet.folder(fleet / f"n{i}", value)
    (fleet / "n4" / "ball_0.csv").unlink()
    (fleet / "n4" / "ball_1.csv").unlink()
    found = {a.id: a for a in done(fleet).answers}
    assert [found[f"n{i}"].verdict for i in range(7)] == [
        "named", "failed", "failed", "data_problem", "failed", "named", "named",
    ]  # fmt: skip
    assert found["n1"].sentence == f"{fleet}/n1 holds no number."
    assert found["n2"].sentence == "The diagnosis failed with ZeroDivisionError: a mistake of ours"
    assert "frozen for 0.3 s" in found["n3"].sentence and "no CSV" in found["n4"].sentence
    assert [m.id for m in planned(fleet).todo] == ["n1", "n2"]  # tried again; what has no files is known before


def test_a_model_of_a_former_answer_stays_beside(fleet: Path) -> None:
    done(fleet)
    model = fleet / "diagnosis" / stored.VEHICLES / "n0" / "model.toml"
    model.write_text(model.read_text() + "# mine\n")
    done(fleet)
    assert model.with_name("model.previous.toml").read_text().endswith("# mine\n")
    assert not model.read_text().endswith("# mine\n")
    assert not list(model.parent.parent.glob(".draft*"))


# ------------------------------------------------------------------------------------------------ what they say


def test_the_one_that_differs_is_told(fleet: Path) -> None:
    found = done(fleet)
    (quantity,) = found.quantities
    assert [d.vehicle for _, d in found.differing] == ["n6"]
    assert quantity.vehicles[6].others == pytest.approx(np.mean(DRAGS[:6]), abs=1e-6)
    assert found.headline == "Of 7 vehicles 7 lack quadratic drag; 1 differs from the others in a number."
    table = found.to_frame()
    assert table.differs.tolist() == [False] * 6 + [True] and set(table.unit) == {"kg/m"}
    assert isinstance(table, pd.DataFrame) and "<table" in found._repr_html_()


def answer(vehicle: str, date: str, value: float, half: float = 0.01, **more: object) -> Answer:
    number = Number("quadratic_drag", "c", value, value - half, value + half, "kg/m")
    return replace(Answer(f"{vehicle}, {date}", vehicle, date, "falling_body", "named", "", "", (number,)), **more)


def test_a_drift_is_the_slope_a_year() -> None:
    days = ["2026-01-01", "2026-03-01", "2026-05-01", "2026-07-01", "2026-09-01"]
    at = np.array([0, 59, 120, 181, 243]) / 365.25
    moving = [answer("a", d, 0.3 + 0.12 * t) for d, t in zip(days, at, strict=True)]
    still = [answer("b", d, 0.3 + 0.002 * (-1) ** i) for i, d in enumerate(days)]
    told = drifts([*moving, *still, answer("c", "2026-01-01", 0.4), answer("d", "", 0.4)])
    assert [d.vehicle for d in told] == ["a", "b"] and [d.drifts for d in told] == [True, False]
    assert told[0].per_year == pytest.approx(0.12) and told[0].low < 0.12 < told[0].high
    assert told[0].level == pytest.approx(0.3 + 0.12 * at.mean())
    alone = drifts([answer(f"v{i}", d, 0.3 + 0.12 * t) for i, (d, t) in enumerate(zip(days, at, strict=True))])
    assert [(d.vehicle, d.drifts) for d in alone] == [("", True)]
    fleet = FleetDiagnosis("f", tuple(moving), quantities(moving), drifts(moving))
    assert len(fleet.behind(fleet.drifts[0])) == 5 and fleet.quantities[0].vehicles[0].vehicle == "a"


def test_a_vehicle_of_several_dates_counts_once() -> None:
    (found,) = quantities([answer("a", f"2026-0{m}-01", 0.3) for m in (1, 2, 3)] + [answer("b", "", 0.5)])
    assert [d.vehicle for d in found.vehicles] == ["a", "b"] and found.mean == pytest.approx(0.4, abs=1e-3)


def test_numbers_without_an_interval_and_learned_ones_are_not_compared() -> None:
    (number,) = answer("a", "", 0.3).numbers
    numbers = replace(number, low=math.nan), replace(number, learned=True), replace(number, high=number.low)
    assert quantities([answer(f"v{i}", "", 0.3, numbers=(n,)) for i, n in enumerate(numbers)]) == ()


def test_the_json_is_as_its_schema_says(fleet: Path) -> None:
    shutil.rmtree(fleet / "n1")
    known_fleet.folder(fleet / "n1", math.nan)
    found = done(fleet)
    told = json.loads((fleet / "diagnosis" / VALUES).read_text())
    jsonschema.validate(told, schema())
    assert told == found.to_json()
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**told, "more": 1}, schema())


# ------------------------------------------------------------------------------------------------ how it is shown


def test_the_page_leads_to_every_vehicle_and_needs_nothing_from_outside(fleet: Path) -> None:
    for i in range(7):
        text = (fleet / f"n{i}" / "dataset.toml").read_text()
        (fleet / f"n{i}" / "dataset.toml").write_text(f"date = 2026-0{i + 1}-01\n" + text)
    found = done(fleet)
    parsed = Parsed((fleet / "diagnosis" / PAGE).read_text())
    links = {v for k, v in parsed.attributes if k == "href" and not v.startswith("#")}
    assert links == {f"vehicles/n{i}/diagnosis.html" for i in range(7)}
    assert all((fleet / "diagnosis" / link).is_file() for link in links)
    assert found.headline in parsed.text and not {"script", "link", "iframe", "img"} & set(parsed.tags)
    assert "0.600 kg/m" in parsed.text and "0.2000 → 0.1000".replace("0.2000", "0.200")[:5] in parsed.text


def test_markup_in_names_stays_text() -> None:
    answers = [
        replace(answer(EVIL + str(i), "2026-01-0" + str(i + 1), 0.3 + 0.1 * i), sentence=EVIL, system=EVIL)
        for i in range(4)
    ]
    answers += [Answer(EVIL, EVIL, "", "", "failed", EVIL, "")]
    found = FleetDiagnosis(EVIL, tuple(answers), quantities(answers), drifts(answers), (EVIL,))
    assert found.drifts and found.quantities
    for text in (page.render(found, EVIL), found._repr_html_()):
        assert EVIL in Parsed(text).text and "script" not in Parsed(text).tags


def test_every_vehicle_is_one_run_in_mlflow(fleet: Path, tmp_path: Path) -> None:
    from mlflow.tracking import MlflowClient

    from bench.tracking import track

    done(fleet)
    uri, vehicles = track.default_uri(tmp_path), fleet / "diagnosis" / stored.VEHICLES
    for name in ("n0", "n6", "n6"):  # twice, as when a driver is killed while it logs
        track.mirror_vehicle(uri, "fleet: f", vehicles / name)
    known = track.whole(uri, "fleet: f")
    assert known == {stored.Stored(vehicles / name).key for name in ("n0", "n6")}
    track.mirror_vehicle(uri, "fleet: f", vehicles / "n6", known)
    client = MlflowClient(tracking_uri=uri)
    runs = client.search_runs([track.find_experiment(uri, "fleet: f")])
    told = {r.info.run_name: r.data for r in runs}
    assert sorted(told) == ["n0", "n6"] and len(runs) == 2
    assert told["n6"].metrics["number/quadratic_drag c kg per m"] == 0.6
    assert told["n6"].metrics["error/speed m per s extended"] == 0.1 and told["n0"].tags["effects"] == "quadratic_drag"
    assert {f.path for f in client.list_artifacts(runs[0].info.run_id)} >= {"diagnosis.html", "model.toml"}


# ------------------------------------------------------------------------------------------------ the command


def command(*words: str) -> tuple[int, str, str]:
    ran = CliRunner().invoke(cli, ["diagnose", *words, "--no-track"])
    return ran.exit_code, ran.output, str(ran.exception or "")


def test_a_fleet_from_the_shell_and_from_python(tmp_path: Path) -> None:
    """Two real vehicles, one of them hostile by name, and a third whose data are bad."""
    fleet, evil = tmp_path / "carts", "[/]<b>cart"
    vehicle(fleet / "a", "quadratic_drag", 1, recordings=3, seconds=6.0)
    vehicle(fleet / "b", "quadratic_drag", 2, recordings=3, seconds=6.0)
    text = (fleet / "b" / "dataset.toml").read_text()
    (fleet / "b" / "dataset.toml").write_text(f'vehicle = "{evil}"\n' + text)
    shutil.copytree(fleet / "a", fleet / "c")
    (fleet / "c" / "run_1.csv").write_text("t,x,v,f\n0,1,2,three\n")
    only = ["--catalogue", "quadratic_drag", "--catalogue", "offset_force"]
    code, output, error = command(str(fleet), *only, "--json", str(tmp_path / "told.json"))
    assert "1 of 3 vehicles could not be diagnosed, such as c: " in error and "'three', not a finite number" in error
    assert "3 vehicles, 0 already diagnosed, 3 to do" in output and evil in output
    told = json.loads((tmp_path / "told.json").read_text())
    assert [v["verdict"] for v in told["vehicles"]] == ["named", "named", "failed"] or code == 2
    again = bench.fleet(fleet, catalogue=["quadratic_drag", "offset_force"])
    assert again.to_json() == told
    drag = again.to_frame().query("effect == 'quadratic_drag'")
    assert len(drag) == 2 and (drag.low < 0.5).all() and (drag.high > 0.5).all()
    shown = (fleet / "diagnosis" / stored.VEHICLES / "a" / "diagnosis.html").read_text()
    assert f"bench diagnose {fleet}/a" in Parsed(shown).text


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--exclude", "ball_0"], "--exclude names a recording of one data set"),
        (["--vehicle", "n9"], "--vehicle n9: no vehicle of"),
        (["--catalogue", "drag"], "drag"),
        (["--model", "absent.toml"], "absent.toml cannot be read"),
        (["--system", "ball"], "ball"),
        (["--workers", "2", "--cluster", "tcp://127.0.0.1:1"], "give one of them"),
    ],
)
def test_a_mistake_is_one_sentence(fleet: Path, words: list[str], says: str) -> None:
    _, _, error = command(str(fleet), *words)
    assert says in error and "\n" not in error


def test_recordings_that_differ_are_told_apart_one_by_one(tmp_path: Path) -> None:
    """The whole says in what they differ, with the numbers, and how to take each by itself."""
    folder = tmp_path / "carts"
    vehicle(folder, "quadratic_drag", 1, recordings=4, seconds=12.0)
    vehicle(tmp_path / "other", "nothing", 2, recordings=4, seconds=12.0)
    for i in (2, 3):
        (tmp_path / "other" / f"run_{i}.csv").rename(folder / f"run_{i}.csv")
    only = ["--catalogue", "quadratic_drag", "--catalogue", "offset_force"]
    whole = command(str(folder), *only)[1]
    again = f"bench diagnose {folder} --catalogue quadratic_drag --catalogue offset_force --each-recording"
    assert again in " ".join(whole.split()) and "Recordings differ in quadratic drag" in " ".join(whole.split())
    _, output, _ = command(str(folder), *only, "--each-recording")
    assert "Of 4 recordings 2 lack quadratic drag." in output
    told = json.loads((folder / "diagnosis" / "fleet.json").read_text())
    assert told["kind"] == "recording"
    assert [(v["vehicle"], v["verdict"]) for v in told["vehicles"]] == [
        ("run_0", "named"), ("run_1", "named"), ("run_2", "nothing"), ("run_3", "nothing"),
    ]  # fmt: skip
    text = Parsed((folder / "diagnosis" / "fleet.html").read_text()).text
    assert "Every recording is diagnosed by itself" in text
    own = (folder / "diagnosis" / stored.VEHICLES / "run_0" / "diagnosis.html").read_text()
    assert f"bench diagnose {folder} --each-recording" in Parsed(own).text and "--add" not in Parsed(own).text


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["silverbox", "--each-recording"], "for a folder with a dataset.toml"),
        (["{}", "--each-recording", "--vehicle", "n0"], "--exclude leaves out some"),
    ],
)
def test_recordings_one_by_one_of_what_has_none(fleet: Path, words: list[str], says: str) -> None:
    assert says in command(*(w.format(fleet / "n0") for w in words))[2]


def test_options_of_a_fleet_are_refused_for_one_vehicle(fleet: Path) -> None:
    for words in (["--vehicle", "n0"], ["--workers", "2"]):
        assert "is no fleet" in command(str(fleet / "n0"), *words)[2]
