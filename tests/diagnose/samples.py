"""One made-up diagnosis of every verdict. The numbers are invented; nothing was flown or simulated."""

import dataclasses
import math
from dataclasses import replace
from typing import Any

import numpy as np

from bench.diagnose.by_equation import ConstantEstimate, EffectSaving, EquationResult
from bench.diagnose.evidence import (
    AFTER,
    LINES,
    RUNS,
    Calibration,
    Candidate,
    Curves,
    Evidence,
    Flight,
    Line,
    Path,
    ResidualMap,
    Signal,
    Stage,
    Trace,
    Window,
)
from bench.diagnose.result import (
    VERDICTS,
    ByGroup,
    DataProblem,
    Diagnosis,
    Errors,
    GroupError,
    NamedEffect,
    ParameterEstimate,
    Region,
    Unexplained,
)

UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "body_rates": "rad/s"}
NOMINAL = {"position": 0.081, "velocity": 0.33, "attitude": 0.042, "body_rates": 0.31}
CALIBRATED = {"position": 0.074, "velocity": 0.31, "attitude": 0.039, "body_rates": 0.29}
FIRST = {"position": 0.024, "velocity": 0.098, "attitude": 0.021, "body_rates": 0.14}
EXTENDED = {"position": 0.0094, "velocity": 0.035, "attitude": 0.0088, "body_rates": 0.061}
FLOOR = {"position": 0.0081, "velocity": 0.031, "attitude": 0.0079, "body_rates": 0.055}
HELD_OUT = ("flight_05", "flight_11")


def errors(values: dict[str, float]) -> ByGroup:
    return {g: GroupError(0.5, v, UNITS[g]) for g, v in values.items()}


def _curves(
    extended: dict[str, float], lines: tuple[str, ...], calibrated: dict[str, float] = CALIBRATED
) -> dict[str, Curves]:
    rng, horizon, out = np.random.default_rng(1), np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5]), {}
    ends = {"nominal": NOMINAL, "calibrated": calibrated, "extended": extended, "floor": FLOOR}
    for group, unit in UNITS.items():
        made = {}
        for name in lines:
            mean = ends[name][group] * (0.06 + 0.94 * (horizon / 0.5) ** 1.6)
            spread = 0.12 * mean
            own = {r: tuple(mean * (1 + 0.1 * rng.normal())) for r in HELD_OUT}
            made[name] = Line(tuple(mean), tuple(mean - spread), tuple(mean + spread), own)
        out[group] = Curves(unit, tuple(horizon), made)
    return out


def _residual(signal: str, unit: str, quantity: str, slope: float, left: float, region: str) -> ResidualMap:
    rng = np.random.default_rng(2)
    x = rng.normal(0, 1.8, 3000)
    y = slope * x + rng.normal(0, 0.25, 3000)
    centres = np.linspace(-4, 4, 9)
    return ResidualMap(
        signal,
        unit,
        quantity,
        "m/s^2",
        tuple(x),
        tuple(y),
        tuple(centres),
        tuple(slope * centres),
        tuple(left * centres + 0.02 * rng.normal(size=9)),
        region,
    )


def _window(recording: str, start: float, group: str, channels: str, extended: float) -> Window:
    t, rng = np.linspace(0, 1, 101), np.random.default_rng(3)
    scale = NOMINAL[group] * 12
    noise = 0.01 * scale * rng.normal(size=(3, 101))
    measured = [scale * np.sin(2 * np.pi * (t * (0.7 + 0.2 * i)) + i) + noise[i] for i in (0, 1, 2)]
    drift = [scale * (0.5 - 0.3 * i) * t**2 for i in (0, 1, 2)]
    return Window(
        recording,
        start,
        group,
        UNITS[group],
        tuple(f"{group}.{a}" for a in channels),
        tuple(t),
        tuple(map(tuple, measured)),
        tuple(tuple(m + d) for m, d in zip(measured, drift, strict=True)),
        tuple(tuple(m + extended * d) for m, d in zip(measured, drift, strict=True)) if math.isfinite(extended) else (),
    )


def _flight(recording: str) -> Flight:
    """Two seconds at 100 Hz: a velocity that both models follow for half a second, and what an accelerometer shows."""
    at, signals = np.arange(201), []
    for name, unit, sensed, rms in (
        ("velocity", "m/s", False, (0.32, 0.034)),
        ("specific_force", "m/s^2", True, (0.7, 0.1)),
    ):
        traces = []
        for i, axis in enumerate("xyz"):
            y = np.sin(0.03 * at + i)
            pieces = [np.arange(k, k + 51) for k in range(0, 200, 50)]
            off = {
                n: tuple((p, y[p] + e * (p - p[0]) / 50) for p in pieces)
                for n, e in zip(("nominal", AFTER), rms, strict=True)
            }
            traces.append(Trace(f"{name}.{axis}", {"measured": ((at, y),), **off}, dict(zip(off, rms, strict=True))))
        signals.append(Signal(name, unit, tuple(traces), sensed))
    around = np.linspace(0, 2 * np.pi, 41)
    circle = np.stack([3 * np.cos(around), 2 * np.sin(around)], axis=1)
    errors = {"nominal": np.array([0.1, 0.4, 0.2, 0.6]), AFTER: np.array([0.02, 0.04, 0.03, 0.05])}
    path = Path(tuple(circle[k : k + 11] for k in range(0, 40, 10)), "velocity", "m/s", errors)
    return Flight(recording, True, 0.01, 201, 201, 0.5, tuple(signals), path)


def _calibration() -> tuple[Calibration, ...]:
    return (
        Calibration("mass", 0.5, 0.5062, "kg", 1.2, 0.4995, 0.5129),
        Calibration("thrust_coefficient", 5.57e-6, 5.61e-6, "N s^2", 0.4),
        Calibration("torque_coefficient", 1.36e-7, 1.34e-7, "N m s^2", -0.7),
    )


DRAG = NamedEffect(
    "rotor_drag",
    {"k_d": ParameterEstimate(1.187e-4, 1.152e-4, 1.224e-4, "kg/rad")},
    0.87,
    errors(CALIBRATED),
    errors(FIRST),
    acts_on="forces",
    saves=(
        EffectSaving("forces", "", 0.5, 0.93, 0.89, 0.97, worth=True),
        EffectSaving("torques", "", 0.5, 0.013, -0.02, 0.05),
    ),
)
REACTION = NamedEffect(
    "rotor_reaction_torque",
    {"rotor_inertia": ParameterEstimate(3.92e-5, 3.71e-5, 4.11e-5, "kg m^2")},
    0.09,
    errors(FIRST),
    errors(EXTENDED),
    acts_on="torques",
    saves=(
        EffectSaving("forces", "", 0.5, 0.0, 0.0, 0.0, matters=False),
        EffectSaving("torques", "", 0.5, 0.84, 0.71, 0.96, worth=True),
        EffectSaving("torques", "torque z", 0.5, 0.97, 0.91, 1.0, worth=True),
    ),
)
EQUATIONS = {
    "forces": EquationResult("velocity", 0.5, "m/s", 0.32, 0.30, 0.034, 0.033, 0.0012),
    "torques": EquationResult("body_rates", 0.5, "rad/s", 0.28, 0.26, 0.052, 0.047, 0.011),
}
CONSTANTS = {
    "mass": ConstantEstimate(0.5, 0.5062, 0.4995, 0.5129, "kg", False),
    "thrust_coefficient": ConstantEstimate(5.57e-6, 5.61e-6, 5.59e-6, 5.63e-6, "N s^2", True),
    "torque_coefficient": ConstantEstimate(1.36e-7, 1.34e-7, math.nan, math.nan, "N m s^2", False),
}
WHERE = (
    Region("speed > 2.8 m/s", 0.61, 0.14, ("flight_01", "flight_02", "flight_03", "flight_05")),
    Region("rotor speed changes faster than 2400 rad/s²", 0.22, 0.06, ("flight_02", "flight_03")),
    Region("height < 3 rotor radii", 0.05, 0.04, ("flight_01", "flight_11")),
)
NOTES = (
    "Smoothing was estimated: a Savitzky–Golay filter of 9 samples and order 3 fits the spectrum of the noise best.",
    "Noise before smoothing was estimated at 0.4 mm in position and 0.03° in attitude.",
    "These recordings hold no descent faster than 1 m/s, so a vortex ring state could not have been seen.",
)


def named() -> Diagnosis:
    lost = "After rotor drag has been added it explains no more than simulated flights without it would let it."
    ranking = (
        (
            Candidate("rotor_drag", 0.87, 0.83, 0.90, "k_d = 1.19×10⁻⁴ kg/rad"),
            Candidate(
                "linear_drag",
                0.71,
                0.64,
                0.77,
                "d_x = 0.21, d_y = 0.20, d_z = 0.02 kg/s",
                "It ignores the rotor speed, which the residual follows: worse in 4 of 4 recordings.",
            ),
            Candidate(
                "wind",
                0.18,
                0.02,
                0.31,
                "w_x = 1.1, w_y = −0.3 m/s",
                "Its direction turns with the heading, so it differs from flight to flight.",
            ),
            Candidate(
                "input_delay",
                0.04,
                -0.02,
                0.09,
                "delay = 3.1 ms",
                "It gains less than it gains on simulated flights without a delay.",
            ),
        ),
        (
            Candidate("rotor_reaction_torque", 0.09, 0.07, 0.11, "rotor_inertia = 3.92×10⁻⁵ kg m²"),
            Candidate(
                "motor_lag",
                0.03,
                0.01,
                0.05,
                "tau_up = 4 ms, tau_down = 6 ms",
                "It slows the thrust as well, which the vertical axis does not show.",
            ),
        ),
        (Candidate("linear_drag", 0.002, -0.003, 0.006, "d_x = 0.004 kg/s", lost),),
    )
    return Diagnosis(
        "hummingbird",
        "quadrotor",
        "named",
        errors(FLOOR),
        Errors(errors(NOMINAL), errors(CALIBRATED), errors(EXTENDED)),
        (DRAG, REACTION),
        Unexplained(0.004),
        WHERE,
        (
            DataProblem(
                "flight_04", "position.z", "spike", (1204, 1206), "3 samples jump by 0.41 m; they were left out."
            ),
        ),
        Evidence(
            source="flights/hummingbird",
            recordings=6,
            seconds=182.4,
            held_out=HELD_OUT,
            curves=_curves(EXTENDED, ("nominal", "calibrated", "extended", "floor")),
            waterfall=(
                Stage("nominal", NOMINAL),
                Stage("calibrated", CALIBRATED),
                Stage("rotor_drag", FIRST),
                Stage("rotor_reaction_torque", EXTENDED),
                Stage("floor", FLOOR),
            ),
            ranking=ranking,
            calibration=_calibration(),
            residuals=(
                _residual("velocity.x", "m/s", "acceleration.x", -0.31, -0.01, "speed > 2.8 m/s"),
                _residual("velocity.y", "m/s", "acceleration.y", -0.29, 0.0, "speed > 2.8 m/s"),
            ),
            windows=(
                _window("flight_05", 12.31, "velocity", "xyz", 0.06),
                _window("flight_11", 4.07, "body_rates", "pqr", 0.1),
            ),
            notes=NOTES,
            flights=tuple(map(_flight, HELD_OUT)),
        ),
        EQUATIONS,
        CONSTANTS,
    )


def tie() -> Diagnosis:
    separate = (
        "Fly at the same speed with a heavier payload, so that the rotor speed changes while the velocity does not."
    )
    a = replace(DRAG, share_explained=0.92, indistinguishable_from=("linear_drag",), separate_by=separate)
    d = named()
    evidence = replace(
        d.evidence,
        waterfall=(*d.evidence.waterfall[:3], Stage("floor", FLOOR)),
        ranking=(
            (
                d.evidence.ranking[0][0],
                replace(
                    d.evidence.ranking[0][1],
                    gain=0.85,
                    low=0.80,
                    high=0.89,
                    why="It does as well as rotor drag: a tie.",
                ),
            ),
        ),
        curves=_curves(FIRST, ("nominal", "calibrated", "extended", "floor")),
    )
    return replace(
        d,
        dataset="hover_only",
        verdict="tie",
        effects=(a,),
        error=replace(d.error, extended=errors(FIRST)),
        data_problems=(),
        evidence=evidence,
    )


def nothing() -> Diagnosis:
    d = named()
    small = {g: 1.04 * v for g, v in FLOOR.items()}
    candidates = tuple(
        Candidate(i, g, g - 0.03, g + 0.03, why="It gains less than it gains on simulated flights without it.")
        for i, g in (("linear_drag", 0.03), ("ground_effect", 0.02), ("input_delay", 0.01))
    )
    evidence = Evidence(
        source="DATA",
        recordings=6,
        seconds=180.0,
        held_out=HELD_OUT,
        curves=_curves(FLOOR, ("calibrated", "floor"), {g: 1.06 * v for g, v in FLOOR.items()}),
        ranking=(candidates,),
        calibration=(Calibration("mass", 0.5, 0.5621, "kg", 12.4, 0.5596, 0.5646),),
        notes=("The recordings are gentle: speeds stay below 0.8 m/s, where drag can hardly be seen.",),
    )
    return replace(
        d,
        dataset="indoor_hover",
        verdict="nothing",
        error=Errors(errors(small), errors(FLOOR), errors(FLOOR)),
        effects=(),
        unexplained=Unexplained(math.nan),
        where=(),
        data_problems=(),
        evidence=evidence,
    )


def unknown_effect() -> Diagnosis:
    d = named()
    evidence = replace(
        d.evidence,
        waterfall=(),
        ranking=(
            tuple(
                replace(c, gain=0.12, low=0.02, high=0.2, why=c.why or "It lowers the error in 2 of 6 recordings only.")
                for c in d.evidence.ranking[0]
            ),
        ),
        curves=_curves(FIRST, ("nominal", "calibrated", "floor")),
        residuals=(replace(_residual("position.x", "m", "acceleration.z", 0.22, 0.0, "x > 1.2 m"), after=()),),
        windows=(_window("flight_05", 7.5, "velocity", "xyz", math.nan),),
        hypothesis="m dv_z/dt = … + 0.11 x",
    )
    return replace(
        d,
        dataset="near_the_fan",
        verdict="unknown_effect",
        effects=(),
        error=replace(d.error, extended=errors(CALIBRATED)),
        unexplained=Unexplained(0.93, ("velocity.z", "position.z"), ("position.x",)),
        where=(Region("x > 1.2 m", 0.72, 0.19, HELD_OUT), Region("x < −1.2 m", 0.2, 0.17, HELD_OUT)),
        data_problems=(),
        evidence=evidence,
    )


def data_problem() -> Diagnosis:
    none: ByGroup = {}
    return Diagnosis(
        "tuesday",
        "quadrotor",
        "data_problem",
        none,
        Errors(none, none, none),
        (),
        Unexplained(math.nan),
        (),
        (
            DataProblem(
                "flight_03",
                "body_rates.r",
                "frozen",
                (1202, 1466),
                "The value −0.0132 rad/s repeats for 2.65 s while the yaw turns by 41°.",
            ),
            DataProblem(
                "flight_05",
                "velocity.x",
                "swapped sign",
                None,
                "It is the negative derivative of position.x (correlation −0.998).",
            ),
        ),
        Evidence(source="flights/tuesday 3", recordings=6, seconds=180.0),
    )


def diverged() -> Diagnosis:
    """A named effect whose nominal model ran away, and whose interval does not exist."""
    d = named()
    away = {**errors(NOMINAL), "position": GroupError(0.5, math.inf, "m")}
    effect = replace(DRAG, parameters={"k_d": ParameterEstimate(1.187e-4, math.nan, math.nan, "kg/rad")})
    return replace(d, error=replace(d.error, nominal=away), effects=(effect,))


ALL = {f.__name__: f for f in (named, tie, nothing, unknown_effect, data_problem)}


def hostile(value: Any, evil: str) -> Any:
    """The same with every text (and key) ending in markup; verdicts and the four models stay."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {f.name: hostile(getattr(value, f.name), evil) for f in dataclasses.fields(value)}
        return dataclasses.replace(value, **changed)
    if isinstance(value, dict):
        return {hostile(k, evil): hostile(v, evil) for k, v in value.items()}
    if isinstance(value, tuple):
        return tuple(hostile(v, evil) for v in value)
    return value + evil if isinstance(value, str) and value not in (*LINES, *RUNS, *VERDICTS) else value
