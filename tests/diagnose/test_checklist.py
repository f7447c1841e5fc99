"""What a human checks first: mistakes in the description of flights are named, and the proposed lines mend them."""

import copy
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mistakes import MISTAKES, VEHICLES, Set, flown
from scipy.spatial.transform import Rotation

from bench.cli.commands.data import data_command
from bench.diagnose.checks.description.checklist import check, check_folder, check_subject
from bench.diagnose.checks.description.conventions import agreeing
from bench.diagnose.checks.description.mistake import Mistake
from bench.diagnose.checks.description.recorded import flying, of_folder
from bench.diagnose.checks.description.rotors import _turns_round
from bench.diagnose.checks.description.thrust import _correlation
from bench.diagnose.logs.load import excluding, load
from registry.datasets.folder.dataset import Folder
from registry.datasets.folder.dataset import check as read_folder


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Set]:
    cache = tmp_path_factory.mktemp("flights")
    return {v: flown(v, cache, recordings=3, seconds=8.0) for v in VEHICLES}


def stopping(found: list[Mistake]) -> list[Mistake]:
    return [m for m in found if m.stops]


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("about", MISTAKES)
def test_a_mistake_is_named_and_its_lines_mend_it(
    about: str, vehicle: str, flights: dict[str, Set], tmp_path: Path
) -> None:
    cases = MISTAKES[about]
    spoil, kind, signal = cases[VEHICLES.index(vehicle) % len(cases)]
    spoilt = copy.deepcopy(flights[vehicle])
    spoil(spoilt)
    found = stopping(check_folder(spoilt.write(tmp_path)))
    assert [(m.kind, m.signal) for m in found] == [(kind, spoilt.drive if signal == "drive" else signal)], found
    assert len(found[0].recordings) == len(spoilt.logs)
    if about != "no effect":  # nobody can tell where the rotors' columns are
        assert stopping(check_folder(spoilt.write(tmp_path, found[0].mend))) == []


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("askew", ["body_rates", "attitude"])
def test_a_sensor_that_is_mounted_askew_is_told_with_its_turn(
    askew: str, vehicle: str, flights: dict[str, Set], tmp_path: Path
) -> None:
    turn, spoilt = Rotation.from_rotvec([1.5, -2.0, 1.0], degrees=True), copy.deepcopy(flights[vehicle])
    for log in spoilt.logs:
        if askew == "attitude":
            log["attitude"] = (Rotation.from_quat(log["attitude"]) * turn).as_quat()
        for name in {"body_rates", "specific_force"} & set(log) if askew == "body_rates" else ():
            log[name] = turn.inv().apply(log[name])
    (found,) = check_folder(spoilt.write(tmp_path))
    assert (found.kind, found.signal, found.stops) == ("mounting", askew, True)
    assert "the rotors act about those of " + ("attitude" if askew == "body_rates" else "body_rates") in found.detail
    told = tomllib.loads(found.mend[0])[askew]["turned_deg"]
    assert told == pytest.approx([1.5, -2.0, 1.0], abs=0.5)  # flights of 8 s, and rates by smoothed attitudes
    assert check_folder(spoilt.write(tmp_path, found.mend)) == []


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_nothing_is_said_of_flights_that_are_read_as_they_are(
    vehicle: str, flights: dict[str, Set], tmp_path: Path
) -> None:
    """Constants may be off as those of real vehicles are; drag, motor lag and noise are in the flights."""
    wrong = copy.deepcopy(flights[vehicle])
    wrong.physics |= {
        "mass": 1.2 * float(wrong.physics["mass"]),  # type: ignore[arg-type]
        "thrust_coefficient": 0.7 * float(wrong.physics["thrust_coefficient"]),  # type: ignore[arg-type]
        "inertia": [0.6 * float(j) for j in wrong.physics["inertia"]],  # type: ignore[attr-defined]
        "torque_coefficient": 4 * float(wrong.physics["torque_coefficient"]),  # type: ignore[arg-type]
    }
    for flown_as in (flights[vehicle], wrong):
        assert check_folder(flown_as.write(tmp_path)) == []


@pytest.mark.parametrize(
    ("made", "named"),
    [
        (
            (("body rates", 0), ("rotor order", 0), ("unit of the motion", 0)),
            {("unit", "body_rates"), ("rotor order", "rotor_speed"), ("unit", "position")},
        ),
        # Both are about the accelerometer, as an estimator's acceleration among signals of an autopilot.
        ((("accelerometer", 0), ("north-east-down", 0)), {("gravity", "specific_force"), ("frame", "position")}),
    ],
)
def test_mistakes_are_mended_one_after_the_other(
    flights: dict[str, Set], made: Sequence[tuple[str, int]], named: set[tuple[str, str]], tmp_path: Path
) -> None:
    spoilt = copy.deepcopy(flights["pelican"])
    for about, case in made:
        MISTAKES[about][case][0](spoilt)
    found = stopping(check_folder(spoilt.write(tmp_path)))
    assert {(m.kind, m.signal) for m in found} == named
    mend = tuple(row for m in found for row in m.mend)
    assert len({row.split(" = ")[0] for row in mend}) == len(mend)  # none contradicts another
    assert check_folder(spoilt.write(tmp_path, mend)) == []


def test_a_slow_log_is_told_with_what_it_is_good_for(flights: dict[str, Set], tmp_path: Path) -> None:
    slow = copy.deepcopy(flights["pelican"])
    slow.rate = 10.0
    slow.logs = [{n: v[::10] for n, v in log.items()} for log in slow.logs]
    (told,) = check_folder(slow.write(tmp_path))
    assert (told.kind, told.stops) == ("slow log", False)
    assert "10 Hz is too slow for rotations" in told.detail and "drag" in told.detail


@pytest.mark.parametrize(("volts", "told"), [(11.1, False), (11_100.0, True)])
def test_a_battery_in_millivolts_is_told(volts: float, told: bool, flights: dict[str, Set], tmp_path: Path) -> None:
    """11 275 V passed without a word."""
    given = copy.deepcopy(flights["pelican"])
    given.columns["battery"] = (["vbat"], {"unit": "V"})
    for log in given.logs:
        log["battery"] = np.full((len(log["position"]), 1), volts)
    found = stopping(check_folder(given.write(tmp_path)))
    assert [(m.kind, m.signal) for m in found] == [("unit", "battery")] * told
    assert not told or stopping(check_folder(given.write(tmp_path, found[0].mend))) == []


@pytest.mark.parametrize(("size", "told"), [(0.3, False), (3.0, True)])
def test_rotors_that_change_between_samples_are_told(
    flights: dict[str, Set], size: float, told: bool, tmp_path: Path
) -> None:
    """An autopilot that answers its gyroscope's noise at 250 Hz, logged at 100."""
    busy, rng = copy.deepcopy(flights["pelican"]), np.random.default_rng(1)
    for log in busy.logs:
        u = log[busy.drive]
        apart = u - u.mean(axis=1, keepdims=True)
        log[busy.drive] = u + size * apart.std() * rng.normal(size=u.shape)
    found = check_folder(busy.write(tmp_path))
    assert [(m.kind, m.signal, m.stops) for m in found] == [("slow log", "rotor_speed", False)] * told
    assert not told or "faster than 100 Hz show" in found[0].detail


@pytest.mark.parametrize(
    ("levels", "rate", "told"),
    [((46.7, 58.7), 40, True), ((46.7, 52.0, 58.7), 40, False), ((46.7, 58.7, 46.7, 52.0), 1, False)],
    ids=["two", "three", "three of a slow process, two in half a minute"],
)
def test_a_drive_of_two_levels_is_told(levels: tuple[float, ...], rate: int, told: bool, tmp_path: Path) -> None:
    """A saturation between the two, and a gain with a constant force, are one and the same on them."""
    rng = np.random.default_rng(0)
    for run in range(2):
        t, u = np.arange(400) / rate, np.repeat(rng.permutation(np.tile(levels, 20))[:40], 10)
        u = np.repeat(levels, 100) if rate == 1 else u
        table = np.column_stack([t, np.sin(t), np.cos(t), u])
        np.savetxt(tmp_path / f"run_{run}.csv", table, "%.9g", ",", header="t,q,v,u", comments="")
    (tmp_path / "dataset.toml").write_text(
        f'name = "ball"\nsystem = "oscillator"\nrate_hz = {rate}\nfiles = "*.csv"\ntime = "t"\ninput = "force"\n'
        'input_hold = "previous"\n[signals]\ndisplacement = {columns = ["q"], unit = "m"}\n'
        'speed = {columns = ["v"], unit = "m/s"}\nforce = {columns = ["u"], unit = "N"}\n'
        "[physics]\nmass = 1.0\ndamping = 0.1\nstiffness = 1.0\n"
    )
    found = [m for m in check_folder(tmp_path) if m.kind == "two levels"]
    assert [(m.signal, m.stops) for m in found] == ([("force", False)] if told else [])
    assert not found or "two values only, 46.7 and 58.7" in found[0].detail


def test_time_on_the_ground_is_left_out_and_said(flights: dict[str, Set], tmp_path: Path) -> None:
    grounded = copy.deepcopy(flights["hummingbird"])
    for log in grounded.logs:
        rest = {
            n: np.repeat(
                v[:1] * (0.02 if n == "rotor_speed" else 0.0 if n in ("velocity", "body_rates") else 1), 150, axis=0
            )
            for n, v in log.items()
        }
        for name in log:
            log[name] = np.concatenate([rest[name], log[name]])
        log["t"] = np.arange(len(log["t"])) / 100
    loaded = read_folder(grounded.write(tmp_path))
    assert [(f.kind, f.count) for f in loaded.findings] == [("ground", 150)] * 3
    assert "samples 0 to 149 (1.5 s) are before take-off" in loaded.findings[0].detail
    assert not loaded.recordings[0].valid[:199].any() and loaded.recordings[0].valid[201:].all()
    assert check_folder(tmp_path) == []
    assert read_folder(flights["hummingbird"].write(tmp_path)).findings == ()


def test_the_command_says_what_was_held_against_what(flights: dict[str, Set], tmp_path: Path) -> None:
    said = CliRunner().invoke(data_command, ["check", str(flights["pelican"].write(tmp_path))])
    assert said.exit_code == 0 and "Not told by these recordings" not in said.output
    (line,) = [x for x in said.output.splitlines() if x.startswith("Agree with each other: ")]
    assert "the attitude against the body rates; the position against the velocity" in line
    assert line.endswith("the order and the signs of the rotors against the torque.")
    still = copy.deepcopy(flights["pelican"])
    for log in still.logs:
        log[still.drive] = np.tile(log[still.drive].mean(axis=0), (len(log["t"]), 1))
    assert agreeing(of_folder(Folder(path=str(still.write(tmp_path)))))[1] == [
        "the thrust",
        "the order and the signs of the rotors against the torque",
    ]


def test_the_command_names_the_lines_and_fails(flights: dict[str, Set], tmp_path: Path) -> None:
    spoilt = copy.deepcopy(flights["pelican"])
    MISTAKES["rotor order"][0][0](spoilt)
    said = CliRunner().invoke(data_command, ["check", str(spoilt.write(tmp_path))])
    assert said.exit_code == 2
    assert "rotor order looks like 1-3-2-4: the residual of the torque" in said.output
    assert 'rotor_speed = {columns = ["m1", "m3", "m2", "m4"], unit = "rad/s"}' in said.output
    stopping_problems, _ = check_subject(load(tmp_path))
    assert [p.kind for p in stopping_problems] == ["rotor order"] and '"m3", "m2"' in stopping_problems[0].detail


def test_the_command_stops_at_a_spike_unless_it_is_told_not_to(flights: dict[str, Set], tmp_path: Path) -> None:
    """As a diagnosis would. The next sample is late: on an even clock a tenth of the spike is there."""
    spoilt = copy.deepcopy(flights["hummingbird"])
    spoilt.logs[1]["velocity"][400, 0] += 30.0
    spoilt.logs[1]["t"][401] += 0.1 / spoilt.rate
    folder = spoilt.write(tmp_path)

    def answer(*more: str) -> tuple[int, list[str]]:
        done = CliRunner().invoke(data_command, ["check", str(folder), *more])
        return done.exit_code, done.output.splitlines()

    code, said = answer()
    assert code == 2 and [line.split(": ")[:2] for line in said if "WRONG" in line] == [
        ["WRONG", "flight_1, velocity, sample 400"]
    ]
    assert said[-1].endswith(f"bench data check {folder} --ignore-problem spike")
    code, said = answer("--ignore-problem", "spike")
    assert code == 0 and any(f"Next: bench diagnose {folder} --ignore-problem spike" in line for line in said)
    code, said = answer("--exclude", "flight_1")
    assert code == 0 and any(f"Next: bench diagnose {folder} --exclude flight_1" in line for line in said)


def test_what_is_left_out_says_nothing_of_the_description(flights: dict[str, Set], tmp_path: Path) -> None:
    spoilt = copy.deepcopy(flights["pelican"])
    MISTAKES["rotor order"][0][0](spoilt)
    spoilt.logs = [*copy.deepcopy(flights["pelican"].logs), *spoilt.logs]  # other flights, with rotors in their order
    subject = load(spoilt.write(tmp_path))
    assert check_subject(subject)[0] == []
    found, _ = check_subject(excluding(subject, ["flight_0", "flight_1", "flight_2"]))
    assert [p.kind for p in found] == ["rotor order"]


def test_rotations_do_not_depend_on_the_heading_or_on_one_bad_recording(
    flights: dict[str, Set], tmp_path: Path
) -> None:
    turned = copy.deepcopy(flights["pelican"])
    turn = Rotation.from_euler("z", 2.1)
    for log in turned.logs:
        log["attitude"] = (turn * Rotation.from_quat(log["attitude"])).as_quat()
        for name in ("position", "velocity"):
            log[name] = turn.apply(log[name])
    assert check_folder(turned.write(tmp_path)) == []
    turned.logs[0]["body_rates"] *= -1  # not a matter of dataset.toml, which all recordings share
    assert check(of_folder(Folder(str(turned.write(tmp_path)))), flying("quadrotor")) == []


@pytest.mark.data
@pytest.mark.parametrize("name", ["nanodrone", "nanobench", "crazypad", "tailsitter"])
def test_nothing_that_stops_is_said_of_real_recordings(name: str, bench_data: None) -> None:
    from registry.core import DATASETS

    dataset = DATASETS.get(name)()
    if not dataset.system:
        pytest.skip("no physics model of the vehicle is registered")
    assert check_subject(load(name))[0] == []


@pytest.mark.parametrize(("hertz", "turned"), [(25.0, True), (2.0, False)])
def test_yaw_that_swings_as_fast_as_a_log_may_be_late_has_no_sign(hertz: float, turned: bool) -> None:
    """At 100 Hz: two samples are half of a swing of 25 Hz, and little of one of 2 Hz."""
    t, rng = 0.01 * np.arange(2000), np.random.default_rng(0)
    rotors = np.column_stack([np.cos(2 * np.pi * hertz * t), np.sin(2 * np.pi * hertz * t)])
    yaw = -rotors[:, 0] + 0.3 * rng.normal(size=2000)
    assert _turns_round(rotors, yaw, np.roll(yaw, -2)) is turned


def test_rotors_that_are_driven_harder_just_when_they_lose_thrust_move_it() -> None:
    """A strong loss of thrust in climb hid behind the controller: flights stopped at a correlation of .19."""
    rng = np.random.default_rng(0)
    climb, own = rng.normal(size=(2, 4000))
    level = own + 3 * climb
    needed = level - 3.3 * climb + 0.1 * rng.normal(size=4000)
    assert abs(_correlation(level, needed)) < 0.1
    assert _correlation(level, needed, climb[:, None]) > 0.9
    assert abs(_correlation(rng.normal(size=4000), needed, climb[:, None])) < 0.1
