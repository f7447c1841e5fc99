import gzip
import json
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from registry.contracts import Channel
from registry.core import PHYSICS
from registry.datasets.folder.dataset import Folder, check, draft
from registry.dynamics import constant
from registry.errors import BenchError
from registry.physics.state_space import Mechanical
from registry.stated import refuse_unstated

TOML = """
name = "mine"
system = "quadrotor"
rate_hz = 100
files = "*.csv"
time = "t"
input = "rotor_speed"
[signals]
position = {columns = ["x","y","z"], unit = "mm"}
attitude = {columns = ["roll","pitch","yaw"], unit = "deg", convention = "euler_zyx"}
velocity = {columns = ["vx","vy","vz"], unit = "m/s", frame = "body"}
body_rates = {columns = ["p","q","r"], unit = "deg/s"}
rotor_speed = {columns = ["rotor1","rotor2","rotor3","rotor4"], unit = "rpm"}
battery = {columns = ["vbat"], unit = "mV"}
[physics]
mass = 0.5
[physics.uncertainty]
mass = 0.01
[processing]
noise = {position = 0.0004}
[environment]
gravity = 9.81
"""
NAMES = [*"xyz", "roll", "pitch", "yaw", "vx", "vy", "vz", *"pqr", *(f"rotor{i}" for i in (1, 2, 3, 4)), "vbat"]


def table(samples=20):
    data = pd.DataFrame(np.random.default_rng(3).uniform(1, 40, (samples, len(NAMES))), columns=NAMES)
    data.insert(0, "t", np.arange(samples) / 100)
    return data


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "dataset.toml").write_text(TOML, encoding="utf-8")
    table().to_csv(tmp_path / "a.csv", index=False)
    return tmp_path


def test_units_frames_and_conventions(folder):
    (r,), data = check(folder).recordings, table()
    rotation = Rotation.from_euler("ZYX", np.deg2rad(data[["yaw", "pitch", "roll"]].to_numpy().copy()))
    assert [c.name for c in r.input_channels] == [f"rotor_speed.{i}" for i in (1, 2, 3, 4)]
    assert r.inputs == pytest.approx(data[NAMES[12:16]].to_numpy() * 2 * np.pi / 60)
    assert r.pick(["position"])[0] == pytest.approx(data[["x", "y", "z"]].to_numpy() / 1000)
    assert r.pick(["battery"])[0] == pytest.approx(data[["vbat"]].to_numpy() / 1000)
    assert r.pick(["velocity"])[0] == pytest.approx(rotation.apply(data[["vx", "vy", "vz"]].to_numpy().copy()))
    assert r.channels == Folder(str(folder)).recorded  # as it is known before anything is read
    q = r.pick(["attitude"])[0]
    assert np.abs((q * rotation.as_quat()).sum(axis=1)) == pytest.approx(1)
    assert r.pick(["body_rates"])[0] == pytest.approx(np.deg2rad(data[["p", "q", "r"]].to_numpy()))
    assert r.pick(["euler_rates"])[0].shape == (20, 3)
    d = Folder(path=str(folder)).description
    assert (d.physics["mass"], d.environment["gravity"], d.processing["noise"]) == (0.5, 9.81, {"position": 0.0004})


def test_every_kind_of_file_gives_the_same_recording(folder):
    expected = check(folder).recordings[0].digest()
    data = table()
    (folder / "a.csv").unlink()
    with gzip.open(folder / "b.csv.gz", "wt", encoding="utf-8") as stream:
        data.to_csv(stream, index=False)
    data.to_parquet(folder / "c.parquet")
    for pattern in ("*.csv.gz", "*.parquet"):
        (folder / "dataset.toml").write_text(TOML.replace("*.csv", pattern), encoding="utf-8")
        assert check(folder).recordings[0].digest() == expected


def test_quaternions_wxyz(folder):
    data = table()
    q = Rotation.random(len(data), random_state=1).as_quat()
    q *= np.sign((q * np.roll(q, 1, axis=0)).sum(axis=1)).reshape(-1, 1)
    data[["qw", "qx", "qy", "qz"]] = q[:, [3, 0, 1, 2]]
    data.to_csv(folder / "a.csv", index=False)
    old = '["roll","pitch","yaw"], unit = "deg", convention = "euler_zyx"'
    toml = TOML.replace(old, '["qw","qx","qy","qz"], convention = "quaternion_wxyz"')
    (folder / "dataset.toml").write_text(toml, encoding="utf-8")
    found = check(folder).recordings[0].pick(["attitude"])[0]
    assert np.abs((found * q).sum(axis=1)) == pytest.approx(1)


def test_a_jittering_clock_is_put_on_a_uniform_grid(folder):
    data = table(200)
    data["t"] += np.random.default_rng(5).uniform(-0.002, 0.002, 200)
    data["x"] = 1000 * data["t"]  # mm: the position is the time
    data.to_csv(folder / "a.csv", index=False)
    x = check(folder).recordings[0].pick(["position.x"])[0][:, 0]
    assert np.diff(x) == pytest.approx(0.01)


def edit(column, row, value):
    def change(folder):
        data = table().astype(object)
        data.loc[row, column] = value
        data.to_csv(folder / "a.csv", index=False)

    return change


def toml(old, new):
    return lambda folder: (folder / "dataset.toml").write_text(TOML.replace(old, new), encoding="utf-8")


def raw(data, name="a.csv"):
    return lambda folder: (folder / name).write_bytes(data)


def outside(folder):
    (folder / "inner").mkdir()
    (folder / "inner" / "dataset.toml").write_text(TOML, encoding="utf-8")
    (folder / "inner" / "b.csv").symlink_to(folder / "a.csv")
    return folder / "inner"


def without_column(folder):
    table().drop(columns="vy").to_csv(folder / "a.csv", index=False)


def jump(folder):
    data = table()
    data.loc[7:, "t"] += 50
    data.to_csv(folder / "a.csv", index=False)


def torn_parquet(folder):
    table().to_parquet(folder / "p.parquet")
    (folder / "p.parquet").write_bytes((folder / "p.parquet").read_bytes()[:-40])
    toml("*.csv", "*.parquet")(folder)


def torn_gzip(folder):
    (folder / "p.csv.gz").write_bytes(gzip.compress(table().to_csv().encode())[:-60])
    toml("*.csv", "*.csv.gz")(folder)


@pytest.mark.parametrize(
    ("breakage", "says"),
    [
        (lambda f: (f / "dataset.toml").unlink(), ["dataset.toml does not exist", "bench data init"]),
        (lambda f: (f / "a.csv").unlink(), ["no CSV", "*.csv"]),
        (without_column, ["a.csv", "no column 'vy'", "did you mean"]),
        (edit("q", slice(None), ""), ["a.csv: column 'q' has no number in any of 20 rows", "NaN"]),
        (edit("t", 4, ""), ["a.csv", "'t' has no number in 1 of 20 rows", "first in row 6", "fill them in"]),
        (edit("q", 4, "inf"), ["a.csv", "'q'", "row 6", "not a finite number"]),
        (edit("q", 4, "1e300"), ["a.csv", "'q'", "row 6", "not a finite number (of at most 1e+60)"]),
        (edit("vbat", 9, "full"), ["a.csv", "'vbat'", "row 11", "'full'"]),
        (jump, ["a.csv", "'t'", "row 9", "50.01 s"]),
        (edit("t", 3, 0.01), ["a.csv", "row 5", "clock"]),
        (raw(b"t,x\n1,\xc3\xa4\xff2\n"), ["a.csv", "(line 2, character 4)", "save it as UTF-8"]),
        (raw(b""), ["a.csv", "is empty"]),
        (raw(b"t,x\n1,2,3,4\n1,2\n1,2,3,4,5,6\n"), ["a.csv"]),
        (raw(",".join(["t", *NAMES]).encode() + b"\n"), ["a.csv", "no samples"]),
        (torn_parquet, ["p.parquet", "cannot be read"]),
        (torn_gzip, ["p.csv.gz", "cannot be read"]),
        (raw(b"\xff", "dataset.toml"), ["dataset.toml", "UTF-8"]),
        (toml("[physics]", "[physics"), ["dataset.toml cannot be read"]),
        (toml("mass = 0.5", "mass = " + 2000 * "["), ["dataset.toml cannot be read"]),
        (toml('name = "mine"', ""), ["no key 'name'"]),
        (toml('name = "mine"', 'nmae = "mine"'), ["unknown key 'nmae'", "did you mean name"]),
        (toml('"quadrotor"', '"quadrotr"'), ["dataset.toml: There is no", "quadrotr", "did you mean quadrotor"]),
        (toml("rate_hz = 100", "rate_hz = 0"), ["rate_hz"]),
        (toml("rate_hz = 100", "rate_hz = 100\nskip_s = -1"), ["skip_s must be a number of seconds, 0 or more"]),
        (toml("rate_hz = 100", "rate_hz = 100\nskip_s = 0.2"), ["a.csv is no longer than the 0.2 s", "skip_s"]),
        (toml("rate_hz = 100", "rate_hz = 100\ncommands = 'cmd'"), ["commands must be the signal", "'cmd'"]),
        (toml("rate_hz = 100", "rate_hz = 100\ncommands = 'rotor_speed'"), ["commands must be the signal"]),
        (
            toml("rate_hz = 100", "rate_hz = 100\ninput_hold = 'previous'\ncommands = 'battery'"),
            ["commands are told of a measured input"],
        ),
        (toml("rate_hz = 100", "rate_hz = 10000"), ["'t'", "come at 100 Hz", "rate_hz"]),
        (toml('"rpm"', '"rmp"'), ["rotor_speed", "'rmp'", "did you mean rpm"]),
        (toml('"rpm"', '"m"'), ["rotor_speed", "rad/s"]),
        (toml("body_rates", "bodyrates"), ["'bodyrates'", "did you mean body_rates"]),
        (toml('"euler_zyx"', '"euler_zy"'), ["euler_zy", "did you mean euler_zyx"]),
        (toml('["p","q","r"]', '["p","q"]'), ["body_rates needs 3 columns"]),
        (toml('["p","q","r"]', '["p","q","q"]'), ["'q' is used twice"]),
        (toml('input = "rotor_speed"', 'input = "battery"'), ["cannot be driven by battery"]),
        (toml('input = "rotor_speed"', 'input = "pwm"'), ["'pwm' is none of its signals"]),
        (toml("mass = 0.5", "mas = 0.5"), ["[physics]", "'mas'", "did you mean mass"]),
        (toml("mass = 0.5", 'mass = "half"'), ["[physics]", "mass must be a finite number"]),
        (toml("mass = 0.5", "mass = 0"), ["[physics]", "mass = 0 must be at least 1e-06 kg"]),
        (toml("mass = 0.5", "inertia = [0.01, -0.01, 0.02]"), ["[physics]", "inertia", "at least 1e-09 kg m^2"]),
        (toml("mass = 0.5", "mass = [0.5]"), ["[physics]", "mass must be a finite number"]),
        (toml("mass = 0.5", "inertia = [0.01, 0.02]"), ["[physics]", "inertia must be 3 numbers, not 2"]),
        (toml("mass = 0.5", "rotor_positions = [[0.1, 0.1], [1, 1, 1]]"), ["rotor_positions", "list of places [x, y"]),
        (
            toml("mass = 0.5", "rotor_positions = [[1, 1], [2, 2]]\nrotor_directions = [1, -1, 1]"),
            ["rotor_positions has 2 and rotor_directions has 3 rotors"],
        ),
        (toml("mass = 0.01", 'mass = "little"'), ["[physics.uncertainty]", "mass must be a number from 0"]),
        (toml("mass = 0.01", "mass = -1"), ["[physics.uncertainty]", "mass must be a number from 0"]),
        (toml("gravity = 9.81", "gravty = 9.81"), ["[environment]", "did you mean gravity"]),
        (toml("*.csv", "../*.csv"), ["leaves the folder"]),
        (toml("*.csv", "/etc/*"), ["leaves the folder"]),
        (outside, ["link that leaves the folder"]),
    ],
)
def test_every_mistake_is_one_sentence(folder, breakage, says):
    moved = breakage(folder)
    with pytest.raises(BenchError) as caught:
        check(moved if moved is not None and not isinstance(moved, int) else folder)
    message = str(caught.value)
    assert "\n" not in message
    for part in says:
        assert part in message


def test_a_file_that_may_not_be_read_is_named_once(folder, monkeypatch):
    file = folder / "a.csv"

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied", str(file))

    monkeypatch.setattr("registry.datasets.reading.tables.pd.read_csv", refused)
    with pytest.raises(BenchError) as caught:
        check(folder)
    assert str(caught.value) == f"{file} may not be read: permission denied."


def test_the_beginning_of_every_recording_can_be_left_out(folder):
    table(30).to_csv(folder / "b.csv", index=False)
    whole = check(folder)
    toml("rate_hz = 100", "rate_hz = 100\nskip_s = 0.08")(folder)
    left = check(folder)
    for before, after in zip(whole.recordings, left.recordings, strict=True):
        assert not after.valid[:8].any() and (after.valid[8:] == before.valid[8:]).all()
        assert (after.outputs == before.outputs).all()
    assert [f.count for f in left.findings if "skip_s" in f.detail] == [8, 8]


def test_hubs_without_a_height_lie_in_the_plane(folder):
    toml("mass = 0.5", "rotor_positions = [[0.1, 0.2], [-0.1, 0.3]]")(folder)
    assert Folder(str(folder)).physics["rotor_positions"] == ((0.1, 0.2, 0.0), (-0.1, 0.3, 0.0))
    assert Folder(str(folder)).description.notes == ("rotor_positions were given as [x, y]: z = 0 was taken.",)


@pytest.mark.parametrize(("told", "known"), [(None, "pwm"), ('"pwm"', "pwm"), ('""', "")])
def test_rotor_speeds_are_read_with_what_asked_for_them(folder, told, known):
    assert Folder(str(folder)).description.commands == ""
    line = "" if told is None else f"commands = {told}\n"
    asked = 'pwm = {columns = ["m1", "m2", "m3", "m4"], unit = "pwm"}'
    (folder / "dataset.toml").write_text(TOML.replace("[signals]", f"{line}[signals]\n{asked}"), encoding="utf-8")
    assert Folder(str(folder)).description.commands == known


def test_split_takes_the_last_fifth_and_needs_three(folder):
    names = [f"r{i:02d}" for i in range(10)]
    split = Folder(path=str(folder)).split(names)
    assert (split.train, split.validation, split.test) == (tuple(names[:6]), ("r06", "r07"), ("r08", "r09"))
    assert Folder().split(["a", "b", "c"]).test == ("c",)
    with pytest.raises(BenchError, match="one recording of fewer than 500 samples"):
        Folder().split(["a"])


def test_the_draft_names_many_columns_that_it_does_not_know_in_few_lines(folder):
    (folder / "dataset.toml").unlink()
    data = table()
    unknown = [f"setpoint_{i}" for i in range(30)]
    data[unknown] = 0.0
    data.to_csv(folder / "a.csv", index=False)
    text = draft(folder)
    left = [line for line in text.splitlines() if line.startswith("#   ")]
    assert [json.loads(word) for line in left for word in line[4:].split()] == unknown
    assert len(left) < 6 and max(map(len, left)) <= 100
    assert text.count("# TODO: are any of these columns") == 1 and "what is column" not in text


def test_the_draft_of_a_plain_header_needs_no_change_but_units(folder):
    (folder / "dataset.toml").unlink()
    data = table()
    data["mystery"] = 0.0
    data.to_csv(folder / "a.csv", index=False)
    text = draft(folder)
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    assert 'TODO: what is column "mystery"?' in text
    r = check(folder).recordings[0]
    groups = {c.group for c in r.channels}
    assert groups == {
        "position", "attitude", "velocity", "body_rates", "euler_rates", "rotor_speed", "battery",
    }  # fmt: skip
    with pytest.raises(BenchError, match="no CSV"):
        draft(folder / "nowhere")


def test_a_gap_of_the_log_is_no_matter_of_the_drafted_rate(tmp_path):
    data = table(400)
    data.loc[len(data) // 2 :, "t"] += 0.05 * data["t"].iloc[-1]
    data.to_csv(tmp_path / "a.csv", index=False)
    assert "rate_hz = 100  # as a.csv has it" in draft(tmp_path)


def test_a_helicopter_is_read_too(tmp_path):
    sticks = ["aileron", "elevator", "rudder", "collective"]
    data = table().drop(columns=[n for n in NAMES if n.startswith("rotor")])
    data[sticks] = 0.1
    data.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "dataset.toml").write_text(draft(tmp_path), encoding="utf-8")
    dataset = Folder(path=str(tmp_path))
    assert (dataset.system, dataset.inputs) == ("helicopter", ("pilot",))
    assert [c.axis for c in dataset.load().recordings[0].input_channels] == sticks


@pytest.mark.parametrize(
    ("system", "columns", "signals"),
    [
        ("oscillator", ["time [s]", "x [m]", "u [N]"], {"displacement": "x [m]", "force": "u [N]"}),
        ("mass_on_rail", ["t", "pos", "vel", "u"], {"displacement": "pos", "speed": "vel", "voltage": "u"}),
        ("tanks", ["t", "u", "y1", "y2"], {"upper_level": "y1", "level": "y2", "voltage": "u"}),
        ("pendulum", ["t", "theta", "theta_dot"], {"angle": "theta", "angle_rate": "theta_dot"}),
    ],
)
def test_the_signals_of_a_named_system_are_drafted(tmp_path, system, columns, signals):
    data = pd.DataFrame(np.ones((20, len(columns))), columns=columns)
    data[columns[0]] = np.arange(20) / 100
    data.to_csv(tmp_path / "a.csv", index=False)
    assert "No physics model: networks only." in draft(tmp_path)
    text = draft(tmp_path, system)
    (tmp_path / "dataset.toml").write_text(text.replace("# [physics]", "[physics]"), encoding="utf-8")
    described = Folder(path=str(tmp_path)).description
    assert {name: s.columns for name, s in described.signals.items()} == {n: (c,) for n, c in signals.items()}
    # Uncommented as they are, constants that the system must have are no values; completed, they are read.
    lines = [line.removeprefix("# ") for line in text.split("[physics]")[1].splitlines()[1:]]
    constants = [line for line in lines if " = " in line]
    own = {line.split(" = ")[0] for line in constants if " = …" in line}
    for value in ("…", "0.25"):
        given = "\n".join(["[physics]", *constants]).replace("…", value)
        (tmp_path / "dataset.toml").write_text(text.split("# [physics]")[0] + given, encoding="utf-8")
        if own and value == "…":
            with pytest.raises(BenchError, match="cannot be read"):
                check(tmp_path)
    values = {p.name: p.value for p in PHYSICS.get(system)().parameters()} | dict.fromkeys(own, 0.25)
    assert Folder(path=str(tmp_path)).physics == values
    refuse_unstated(Folder(path=str(tmp_path)), PHYSICS.get(system))


@dataclass(frozen=True)
class Motor(Mechanical):
    """A shaft that a voltage turns."""

    mass: Any = constant(2e-4, "J", "kg m^2", low=1e-9)

    state_channels = (Channel("angle.shaft", "rad"), Channel("angle_rate.shaft", "rad/s"))
    input_signals = ("voltage",)
    equation = "J dω/dt = u"

    def own_force(self, state, inputs):
        return inputs[..., :1]


def test_columns_of_a_motor_are_known_by_name_and_unit(tmp_path):
    """Its supply is no battery of a vehicle, and columns of a class of one's own may end in their unit."""
    names = ["angle_deg", "speed_rpm", "current_A", "voltage_V"]
    data = pd.DataFrame(np.random.default_rng(0).uniform(0, 1, (50, 4)), columns=names)
    data.assign(time_s=np.arange(50) / 100).to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path)
    assert "battery" not in text and 'voltage_V = {columns = ["voltage_V"], unit = "V"}' in text
    assert 'current_A = {columns = ["current_A"], unit = "A"}' in text
    text = draft(tmp_path, own=Motor)
    assert 'angle = {columns = ["angle_deg"], unit = "deg"}' in text
    assert 'angle_rate = {columns = ["speed_rpm"], unit = "rpm"}' in text
    assert 'input = "voltage"' in text and 'voltage = {columns = ["voltage_V"], unit = "V"}' in text
    assert "TODO: angle" not in text and 'what is column "current_A"' in text
    data.set_axis(["q", "w", "i", "u"], axis=1).assign(tout=np.arange(50) / 100).to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path, own=Motor)  # short names, as equations have them
    assert 'input = "voltage"' in text and 'voltage = {columns = ["u"], unit = "V"}' in text and 'time = "tout"' in text
    assert 'angle = {columns = ["q"], unit = "rad"}' in text
    assert 'angle_rate = {columns = ["w"], unit = "rad/s"}' in text
    data.set_axis(["a", "b", "drive", "set_point"], axis=1).to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path, own=Motor)  # one signal drives it, but which column is that?
    assert 'input = "voltage"' in text and "# TODO: voltage = " in text
    data.set_axis(["a", "b", "i", "drive"], axis=1).to_csv(tmp_path / "a.csv", index=False)
    assert 'voltage = {columns = ["drive"], unit = "V"}' in draft(tmp_path, own=Motor)


def test_numbered_motors_may_be_speeds(tmp_path):
    table().rename(columns={f"rotor{i}": f"m{i}" for i in (1, 2, 3, 4)}).to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path)
    assert 'input = "pwm"' in text
    assert '# rotor_speed = {columns = ["m1", "m2", "m3", "m4"], unit = "rad/s"}' in text


def test_names_of_logs_in_north_east_down_are_known(tmp_path):
    """As ArduPilot writes them, and PX4's tools; degrees are seen by their size."""
    data = pd.DataFrame({"TimeMS": 10.0 * np.arange(50)})
    named = [f"{a}{b}" for a, b in (*product("PV", "NED"), *product(("Gyr", "Acc"), "XYZ"), *product("M", "1234"))]
    for i, name in enumerate(["Roll", "Pitch", "Yaw", *named]):
        data[name] = 10 * np.sin(0.1 * np.arange(50) + i)
    data.to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path)
    for said in (
        'position = {columns = ["PN", "PE", "PD"], unit = "m", frame = "ned"}',
        'velocity = {columns = ["VN", "VE", "VD"], unit = "m/s", frame = "ned"}',
        'attitude = {columns = ["Roll", "Pitch", "Yaw"], unit = "deg", convention = "euler_zyx", frame = "ned"}',
        'body_rates = {columns = ["GyrX", "GyrY", "GyrZ"], unit = "rad/s", frame = "frd"}',
        'specific_force = {columns = ["AccX", "AccY", "AccZ"], unit = "m/s^2", frame = "frd"}',
        'time_unit = "ms"',
    ):
        assert said in text
    names = "vx vy vz q0 q1 q2 q3 ang_vel_x ang_vel_y ang_vel_z acc_b_x acc_b_y acc_b_z u0 u1 u2 u3"
    pd.DataFrame(np.full((50, 17), 0.1), columns=names.split()).assign(t=np.arange(50) / 100).to_csv(
        tmp_path / "a.csv", index=False
    )
    text = draft(tmp_path)
    assert "TODO: what is column" not in text and 'input = "pwm"' in text
    assert 'attitude = {columns = ["q0", "q1", "q2", "q3"], unit = "1", convention = "quaternion_wxyz"}' in text


def test_a_draft_says_what_was_not_found(tmp_path):
    table().rename(columns={"q": "rate"}).to_csv(tmp_path / "a.csv", index=False)
    text = draft(tmp_path, "quadrotor")
    assert '# TODO: body_rates = {columns = ["…"], unit = "rad/s"}, a state, if it was measured' in text


W = np.rad2deg(25.0)
"""A span [deg] that is no turn."""


@pytest.mark.parametrize(
    ("true", "filed", "counted"),
    [
        (lambda t: 720 * t - 50 * t * t, lambda deg: (deg + 180) % 360 - 180, True),
        (lambda t: 400 * np.sin(2 * t), lambda deg: deg % 360, True),
        (lambda t: 4000 * np.sin(1.5 * t), lambda deg: (deg + W / 2) % W - W / 2, True),
        (lambda t: 4000 * np.sign(t % 0.5 - 0.251) + 100 * t, lambda deg: deg, False),  # set to and fro
        (lambda t: 28000 * t, lambda deg: deg, False),  # an encoder that counts, by more than half a turn a sample
        (lambda t: 170 * np.sin(5 * t), lambda deg: deg, False),
        (lambda t: 179 * np.sign(np.sin(900 * t)), lambda deg: deg, False),  # what jumps to and fro with every sample
    ],
    ids=["to half a turn", "from zero", "of a protocol", "set", "counts", "within", "jumps"],
)
def test_the_turns_of_an_angle_that_is_filed_within_one_are_counted(tmp_path, true, filed, counted):
    t = np.arange(400) / 100
    pd.DataFrame({"t": t, "q": filed(true(t)), "w": 0 * t}).to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "dataset.toml").write_text(
        'name = "arm"\nsystem = "pendulum"\nrate_hz = 100\nfiles = "*.csv"\ntime = "t"\n[signals]\n'
        'angle = {columns = ["q"], unit = "deg"}\nangle_rate = {columns = ["w"], unit = "rad/s"}\n'
    )
    read = check(tmp_path)
    angle = np.rad2deg(read.recordings[0].pick(["angle"])[0][:, 0])
    assert np.diff(angle) == pytest.approx(np.diff(true(t)), abs=1e-6)
    assert [f.kind for f in read.findings if f.kind == "turns"] == ["turns"] * counted
