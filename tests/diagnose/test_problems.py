"""Faults put into flights whose motion, attitude and rotor speeds follow from a path by flatness, not from a model."""

import re
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim, savgol_filter
from scipy.spatial.transform import Rotation

from bench.diagnose.checks.problems import Checked, problems
from bench.diagnose.checks.shifts import Lag, _told, lag_of, shifts
from bench.diagnose.logs.load import load
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.result import DataProblem
from bench.diagnose.settings import SHIFTING
from bench.score.logs import subject
from bench.score.multirotor.corrupt import KINDS, Columns, time_shift
from registry.datasets.reading.cleaning import agreements
from registry.datasets.signals import recording
from registry.effects.actuation import MotorLag
from registry.physics.oscillator import Oscillator

DT = 0.01
MASS, INERTIA, K_F, K_M, ARM = 0.5, np.array([3.65e-3, 3.68e-3, 7.03e-3]), 5.57e-6, 1.36e-7, 0.12
HUBS = np.array([[ARM, ARM, 0], [ARM, -ARM, 0], [-ARM, -ARM, 0], [-ARM, ARM, 0]])
SPINS = np.array([1.0, -1.0, 1.0, -1.0])
NOMINAL = {
    "mass": MASS,
    "inertia": INERTIA.tolist(),
    "thrust_coefficient": K_F,
    "torque_coefficient": K_M,
    "rotor_positions": HUBS.tolist(),
    "rotor_directions": SPINS.tolist(),
    "rotor_radius": 0.1,
}
SIGNAL = {"t": "time"}
KIND = {"swapped_sign": "swapped sign", "clock_jump": "clock jump", "clock_rate": "clock rate"}


def flight(
    seed: int,
    vigour: float = 1.0,
    noise: float = 1.0,
    seconds: float = 16.0,
    damping: float = 0.0,
    drag: float = 0.0,
    wind: tuple[float, float] = (0.0, 0.0),
    munk: float = 0.0,
) -> Columns:
    """A log of a flight along sums of sines: inverse dynamics, then noise and a Savitzky–Golay filter.

    The air brakes every rotation by ``damping`` [1/s] times its rate. It pulls with ``drag`` [kg/m] times the square of
    the velocity through it, in a ``wind`` [m/s], and turns the body broadside with Munk's moment (``munk`` [kg]).
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / DT)) * DT
    fine = np.arange(-200, 10 * len(t) + 200) * DT / 10
    h = fine[1] - fine[0]
    path = np.zeros((len(fine), 3))
    for low, high, speed in ((0.5, 1.5, 1.2), (1.5, 3.0, 0.8), (4.0, 7.0, 0.25)):
        w = rng.uniform(low, high, 3)
        path += vigour * speed / w * np.sin(fine[:, None] * w + rng.uniform(0, 6.3, 3))
    yaw = vigour * 0.5 * np.sin(1.3 * fine + rng.uniform(0, 6.3))
    velocity = np.gradient(path, h, axis=0)
    through_air = velocity - np.array([*wind, 0.0])
    own = drag / MASS * np.linalg.norm(through_air, axis=1, keepdims=True) * through_air
    pull = np.gradient(velocity, h, axis=0) + np.array([0, 0, 9.81]) + own
    up = pull / np.linalg.norm(pull, axis=1, keepdims=True)
    side = np.cross(up, np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    attitude = Rotation.from_matrix(np.stack([np.cross(side, up), side, up], axis=2))
    turning = (attitude[:-2].inv() * attitude[2:]).as_rotvec() / (2 * h)
    rates = np.concatenate([turning[:1], turning, turning[-1:]])
    torque = INERTIA * (np.gradient(rates, h, axis=0) + damping * rates) + np.cross(rates, INERTIA * rates)
    x, y, z = attitude.inv().apply(through_air).T
    torque -= munk * np.stack([-y * z, x * z, 0 * z], axis=1)
    wrench = np.column_stack([MASS * np.linalg.norm(pull, axis=1), torque])
    mixer = np.stack([np.ones(4), HUBS[:, 1], -HUBS[:, 0], SPINS * K_M / K_F])
    speed = np.sqrt(np.maximum(np.linalg.solve(mixer, wrench.T).T / K_F, 0))
    at = slice(200, -200, 10)
    position = path[at] + rng.normal(0, 4e-4 * noise, (len(t), 3))
    wobble = Rotation.from_rotvec(rng.normal(0, 5e-4 * noise, (len(t), 3)))
    quaternion = (attitude[at] * wobble).as_quat()
    flips = np.cumprod(np.where((quaternion[1:] * quaternion[:-1]).sum(1) < 0, -1.0, 1.0))
    quaternion[1:] *= flips[:, None]
    smooth, slope = (savgol_filter(quaternion, 9, 3, deriv=d, delta=DT, axis=0) for d in (0, 1))
    length = np.linalg.norm(smooth, axis=1, keepdims=True)
    v, w, dv, dw = smooth[:, :3], smooth[:, 3:], slope[:, :3], slope[:, 3:]
    return {
        "t": t,
        "position": savgol_filter(position, 9, 3, axis=0),
        "attitude": smooth / length,
        "velocity": savgol_filter(position, 9, 3, deriv=1, delta=DT, axis=0),
        "body_rates": 2 * (w * dv - dw * v - np.cross(v, dv)) / length**2,
        "rotor_speed": speed[at] * (1 + rng.normal(0, 0.001 * noise, (len(t), 4))),
        "rotor_command": speed[at],
    }


def made(logs: list[Columns], **constants: object) -> Subject:
    return subject("flights", logs, NOMINAL | constants, {}, {})


def flights(seed: int, count: int = 4, **how: float) -> list[Columns]:
    return [flight(100 * seed + i, **how) for i in range(count)]


def right(p: DataProblem, recording_number: int, signal: str, rows: tuple[int, int], kind: str) -> bool:
    """Whether a problem names the fault, rows to within two samples at either end."""
    assert p.rows is not None
    near = abs(p.rows[0] - rows[0]) <= 2 and abs(p.rows[1] - (rows[1] - 1)) <= 2
    return (p.recording, p.signal, p.kind, near) == (f"flight_{recording_number + 1}", signal, kind, True)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_found_where_it_is_and_nothing_else(kind: str) -> None:
    for seed in range(6):
        rng, logs = np.random.default_rng(seed), flights(seed % 2, noise=(0.3, 1.0, 2.0)[seed % 3])
        which = int(rng.integers(len(logs)))
        logs[which], fault = KINDS[kind](rng, logs[which], which)
        found = problems(made(logs, mass=MASS * (1.1 if seed % 2 else 1.0))).problems
        expected = (which, SIGNAL.get(fault.signal, fault.signal), fault.rows, KIND.get(kind, kind))
        assert len(found) == 1, (seed, fault, found)
        assert right(found[0], *expected), (seed, fault, found)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"mass": 1.3 * MASS},
        {"thrust_coefficient": 0.8 * K_F},
        {"inertia": (0.6 * INERTIA).tolist()},
        {"torque_coefficient": 5 * K_M},
    ],
)
def test_a_wrong_model_is_no_fault_of_the_data(wrong: dict[str, object]) -> None:
    for seed, (vigour, noise) in enumerate(((1.0, 0.3), (0.05, 2.0), (1.4, 2.0), (0.0, 1.0))):
        assert problems(made(flights(seed, vigour=vigour, noise=noise), **wrong)) == Checked((), ()), (vigour, noise)


def _swap(log: Columns) -> None:
    log["velocity"][:, [0, 1]] = log["velocity"][:, [1, 0]]


def _interchange(log: Columns) -> None:
    log["position"], log["velocity"] = log["velocity"], log["position"]


def _other(log: Columns) -> None:
    log["velocity"] = flights(9)[0]["velocity"]


def _clip(log: Columns) -> None:
    log["body_rates"][:, 1] = np.clip(log["body_rates"][:, 1], -0.8, 0.8)


def _stretch(log: Columns) -> None:
    log["attitude"][300:320] *= 1.1


def _degrees(log: Columns) -> None:
    log["body_rates"] *= 180 / np.pi


def _absent(log: Columns) -> None:
    log["position"][70, 2] = np.nan


def _against_thrust(log: Columns) -> None:
    for signal in ("position", "velocity"):
        log[signal][:, 0] *= -1


@pytest.mark.parametrize(
    ("spoil", "signal", "kind", "says"),
    [
        (_swap, "velocity", "swapped axes", "position.x changes as velocity says of axis y"),
        (_interchange, "velocity", "swapped signals", "velocity changes as position says"),
        (_other, "velocity", "unrelated", "is no rate of position."),
        (_clip, "body_rates", "clipped", "body_rates.q stands at"),
        (_stretch, "attitude", "quaternion", "one has length 1.1"),
        (_degrees, "body_rates", "unit", "degrees for radians"),
        (_absent, "position", "not finite", "1 samples"),
        (_against_thrust, "velocity", "swapped sign", "velocity.x changes against what the model says"),
    ],
)
def test_other_faults_are_named(spoil: Callable[[Columns], None], signal: str, kind: str, says: str) -> None:
    logs = flights(3)
    spoil(logs[1])
    found = problems(made(logs)).problems
    assert {(p.recording, p.signal, p.kind) for p in found} == {("flight_2", signal, kind)}
    assert says in found[0].detail


def test_a_rate_whose_filter_starts_up_is_told_and_stops_nothing() -> None:
    logs = flights(3)
    assert problems(made(logs)) == ((), ())
    size = len(logs[1]["velocity"])
    reach = np.ptp(logs[1]["position"], axis=0).max()
    logs[1]["velocity"][:, 2] -= 20 * reach * np.exp(-np.arange(size) / 15)
    found = problems(made(logs))
    assert not found.problems
    (one,) = found.suspicions
    assert (one.recording, one.signal, one.kind) == ("flight_2", "velocity", "disagreement")
    assert one.rows is not None and one.rows[0] == 0 and 20 < one.rows[1] < 200
    assert "Velocity and the change of position contradict each other in flight_2 at samples 0 to" in one.detail


def test_a_shift_of_all_recordings_is_a_suspicion_or_a_fault_by_its_sign_and_of_one_a_fault() -> None:
    logs = flights(4, count=5, noise=0.1)
    early = [time_shift(log, i, -0.01)[0] for i, log in enumerate(logs)]
    late = [time_shift(log, i, 0.01)[0] for i, log in enumerate(logs)]
    answers = [problems(made(early)), problems(made(late))]
    # A vehicle may answer late, which a log with early inputs looks like; it cannot answer before its inputs.
    ((stopping, suspected),) = [a for a in answers if a.suspicions]
    assert not stopping and suspected[0].kind == "time shift" and "input_delay" in suspected[0].detail
    (faults,) = [a.problems for a in answers if a.problems]
    assert {f.kind for f in faults} == {"time shift"} and len(faults) == 5
    logs[2], _ = time_shift(logs[2], 2, 0.02)
    (fault,) = problems(made(logs)).problems
    assert (fault.recording, fault.signal, fault.kind) == ("flight_3", "rotor_speed", "time shift")
    assert "-2.0 samples" in fault.detail or "-1.9 samples" in fault.detail


@pytest.mark.parametrize(
    ("odd", "told", "usual", "shifted"),
    [(-0.3, 0.2, 6.5, False), (6.5, 0.2, 0.1, True), (-6.5, 0.2, 0.1, True), (1.9, 1.6, 0.1, False)],
    ids=["in time", "late", "early", "hardly told"],
)
def test_a_recording_in_time_is_not_the_one_that_was_shifted(
    monkeypatch: pytest.MonkeyPatch, odd: float, told: float, usual: float, shifted: bool
) -> None:
    """Drag that grows with the square of the rates delays brisk flights by 6 to 7 samples, and a calm one by none."""
    of = made(flights(5, count=5))
    lags = iter([odd, *(usual + 0.05 * i for i in range(4))])
    monkeypatch.setattr(
        "bench.diagnose.checks.shifts.lag_of", lambda *rest: Lag(by := next(lags), 0.95, by - told, by + told)
    )
    stopping, _ = shifts(of, {})
    assert [p.recording for p in stopping] == ([of.logs[0].name] if shifted else [])


@pytest.mark.parametrize(("noise", "apart"), [(0.3, True), (3.0, False)])
def test_a_lag_lies_within_its_interval_which_noise_widens(noise: float, apart: bool) -> None:
    """Two samples late; little noise tells that from no lag at all in every recording, much in not even half."""
    sure = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x = rng.normal(size=(1502, 2))
        late = x[:-2] + noise * rng.normal(size=(1500, 2))
        cause, effect = (savgol_filter(a, SHIFTING.smoothing, 2, axis=0) for a in (x[2:], late))
        low, high = _told(agreements(cause, effect), cause.size / SHIFTING.smoothing)
        assert low <= 2.05 and high >= 1.95
        sure += low > SHIFTING.suspect
    assert sure == 40 if apart else sure < 20


def test_damping_that_the_model_lacks_is_no_time_shift_and_hides_none() -> None:
    """Damped motion leads what drives it, as if the inputs had been filed too late."""
    for damping in (4.0, 8.0):
        logs = flights(7, noise=0.3, damping=damping)
        assert problems(made(logs)) == Checked((), ()), damping
        late, early = ([time_shift(log, i, s)[0] for i, log in enumerate(logs)] for s in (0.01, -0.01))
        faults = problems(made(late)).problems
        assert len(faults) == len(logs) and all("input_delay explains" in f.detail for f in faults), damping
        stopping, (suspected,) = problems(made(early))
        assert not stopping and re.search(r"(0\.9|1\.0) samples .* after", suspected.detail), damping


def test_what_a_sensor_does_all_the_time_does_not_stop_the_analysis() -> None:
    """Blemishes of all sizes are the sensor's nature; one that is far larger than all of them is a fault."""
    logs, rng = flights(5), np.random.default_rng(0)
    for log in logs:
        log["position"] += 4e-4 * rng.standard_t(1.5, size=log["position"].shape)
    stopping, minor = problems(made(logs))
    assert not stopping
    assert [(p.signal, p.kind) for p in minor] == [("position", "spike")]
    assert re.match(
        r"Single samples of position stand out \d+ times in \d recordings, the largest in flight_", minor[0].detail
    )
    logs[0]["position"][800, 0] += 5.0
    assert [p.rows for p in problems(made(logs)).problems] == [(800, 800)]


def swinging(displacement: np.ndarray, speed: np.ndarray, force: np.ndarray, rate: float) -> list[DataProblem]:
    """What is found wrong in a recording (N,) of an oscillator."""
    signals, model = {"displacement": displacement[:, None], "speed": speed[:, None]}, Oscillator()
    made = recording("swing", rate, {"force": force[:, None]}, signals, np.ones(len(force), dtype=bool))
    one = Subject("swing", model, (log_of(made, model, "force"),), ("swing",), ("swing",))
    return problems(one).problems


@pytest.mark.parametrize(("seconds", "found"), [(2.0, []), (20.0, ["swapped sign"])])
def test_the_sign_of_a_slow_drift_is_judged_where_it_lasts(seconds: float, found: list[str]) -> None:
    """A vehicle at rest: what its estimator corrects for a moment goes against the speed that it states."""
    t = np.arange(0, seconds, 0.02)
    speed = 0.01 - 0.002 * t / seconds
    assert [p.kind for p in swinging(0.02 - 0.008 * t, speed, 100 * (0.02 - 0.008 * t), 50.0)] == found


def test_any_system_whose_state_holds_its_own_rate_is_checked() -> None:
    rng, t = np.random.default_rng(0), np.arange(3000) * 1e-3
    x = 0.1 * np.sin(9 * t) + 0.02 * np.sin(40 * t)
    v = 0.9 * np.cos(9 * t) + 0.8 * np.cos(40 * t)
    a = -8.1 * np.sin(9 * t) - 32 * np.sin(40 * t)
    force = a + 0.5 * v + 100 * x

    def checked(displacement: np.ndarray, speed: np.ndarray) -> list[tuple[str, str, object]]:
        return [(p.signal, p.kind, p.rows) for p in swinging(displacement, speed, force, 1000.0)]

    noisy = x + rng.normal(0, 1e-6, len(t)), v + rng.normal(0, 1e-3, len(t))
    assert checked(*noisy) == []
    assert checked(noisy[0], -noisy[1]) == [("speed", "swapped sign", (0, 2999))]
    noisy[1][1500] += 0.5
    assert checked(*noisy) == [("speed", "spike", (1500, 1500))]


def test_a_turn_too_sharp_for_the_sampling_is_no_missing_sample() -> None:
    """Kicks of 50 ms, one of them harder, sampled every 20 ms: speed and force do not say what happens in between."""
    fine = np.arange(0, 40, 1e-4)
    force = 3 * np.sin(2 * fine) + 2 * np.sin(5.3 * fine)
    for i, at in enumerate(np.arange(3.013, 38, 3.7)):
        force += (60 if i == 5 else 18) * np.exp(-(((fine - at) / 0.03) ** 2))
    x = lsim(([1], [1, 0.5, 100]), force, fine)[1]
    sampled, rng = np.stack([x, np.gradient(x, 1e-4), force])[:, ::200], np.random.default_rng(0)
    noise = np.array([2e-5, 1e-3, 0])[:, None] * rng.normal(size=sampled.shape)
    assert swinging(*(sampled + noise), 50.0) == ()
    found = swinging(*np.delete(sampled + noise, 1200, axis=1), 50.0)
    assert [(p.kind, p.rows) for p in found] == [("clock jump", (1199, 1200))]


def test_a_turn_that_begins_between_two_samples_is_judged_by_the_attitude_and_not_by_a_noisy_position() -> None:
    """From a tenth of a sample after one on, the body turns about z at 6 rad/s, and less and less for 2 s."""
    logs, rng = [flight(seed, noise=0.05) for seed in range(100, 104)], np.random.default_rng(0)
    since = np.maximum(logs[0]["t"] - 800.1 * DT, 0)[:, None] * [0, 0, 1]
    turned = Rotation.from_rotvec(12 * (1 - np.exp(-since / 2)))
    quaternion = (Rotation.from_quat(logs[0]["attitude"]) * turned).as_quat()
    quaternion[1:] *= np.cumprod(np.where((quaternion[1:] * quaternion[:-1]).sum(1) < 0, -1.0, 1.0))[:, None]
    rates = turned.inv().apply(logs[0]["body_rates"]) + 6 * np.exp(-since / 2) * (since > 0)
    logs[0].update(attitude=quaternion, body_rates=rates)
    for log in logs:
        log["position"] = log["position"] + rng.normal(0, 3e-3, log["position"].shape)
    assert problems(made(logs)).problems == ()


def test_a_rate_whose_zero_is_off_does_not_make_rest_a_frozen_sensor() -> None:
    """A joint with a coarse encoder rests for 8 s in friction; the zero of the rate is off by a sixth of its noise."""
    rng, t = np.random.default_rng(0), np.arange(0, 30, 0.005)
    resting = (t > 15) & (t < 23)
    speed = np.where(resting, 0.0, np.sin(1.3 * t) * (1 + 0.5 * np.sin(0.4 * t)))
    angle = np.cumsum(speed) * 0.005
    read = 0.004 * np.round((speed + rng.normal(0, 0.07, len(t))) / 0.004) - 0.011
    encoder = 0.003 * np.round(angle / 0.003)
    force = np.gradient(speed, 0.005) + 0.5 * speed + 100 * angle
    assert not swinging(encoder, read, force, 200.0)
    missed = encoder.copy()
    missed[1000:1600] = missed[1000]
    assert [(p.signal, p.kind, p.rows) for p in swinging(missed, read, force, 200.0)] == [
        ("displacement", "frozen", (1001, 1599))
    ]


def test_six_flights_of_25_seconds_take_less_than_a_second() -> None:
    subject = made(flights(6, count=6, seconds=25.0))
    problems(subject)
    start = time.process_time()
    problems(subject)
    assert time.process_time() - start < 1.0


@pytest.mark.data
@pytest.mark.parametrize("name", ["emps", "silverbox", "cascaded_tanks", "nanodrone", "nanobench", "crazypad"])
def test_cleaned_recordings_raise_no_alarm(name: str, bench_data: None) -> None:
    assert problems(load(name)).problems == ()


def test_a_lag_that_was_found_is_no_time_shift_any_more() -> None:
    """By how much a lag delays motion differs from one manoeuvre to the next; read as it acts, nothing is late."""
    lag = MotorLag(tau_up=0.06, tau_down=0.06)
    logs = [flight(40 + i, vigour=v, noise=0.05) for i, v in enumerate((1.0, 1.0, 0.3, 1.5))]
    for log in logs:
        log["rotor_speed"] = log["rotor_speed"] + 0.06 * np.gradient(log["rotor_speed"], DT, axis=0)
    plain = made(logs)
    lagging = replace(plain, model=replace(plain.model, effects=(lag,)))
    late = [lag_of(plain.model, log)[0] for log in plain.logs]
    left = [lag_of(lagging.model, log)[:2] for log in plain.logs]
    assert min(late) > 2 and all(abs(by) < 0.5 and how > 0.8 for by, how in left), (late, left)
    assert problems(lagging) == Checked((), ())
