"""A servo follows a commanded angle with a controller of its own: its motor has a limit, and its arm weighs."""

import numpy as np
import pytest

from bench.diagnose import diagnose, discover
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.report.sentences import explanation
from registry.contracts import Channel, Recording
from registry.effects.mechanics.force_limit import ForceLimit
from registry.physics.oscillator import Oscillator
from registry.units import Signal
from tests.servos import Servo

STEP, SAMPLES = 0.02, 300
INERTIA, STIFFNESS, DAMPING = 0.004, 1.2, 0.09
"""[kg m²], [N m/rad], [N m s/rad]"""
LIMIT, WEIGHT = 0.4, 0.15
"""Of the motor and of the arm [N m]."""
FULL = 0.2
"""[rad]"""


def subject(limit: float = np.inf, weight: float = 0.0, model: Servo | None = None, full: float = np.inf) -> Subject:
    """Six recordings of commands in steps, by Störmer and Verlet: half a step of the angle, one of its rate, half.

    The controller's output is ``full`` from that error on.
    """
    made, model, parts = [], model or Servo(input_hold="previous"), 20
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-1.5, 1.5, SAMPLES // 15), 15)
        q, w, out = 0.0, 0.0, np.empty((SAMPLES, 2))
        for i in range(SAMPLES):
            out[i] = q, w
            for _ in range(parts):
                q += STEP / parts * w / 2
                torque = np.clip(STIFFNESS * np.clip(u[i] - q, -full, full) - DAMPING * w, -limit, limit)
                w += STEP / parts * (torque - weight * np.sin(q + 0.4)) / INERTIA
                q += STEP / parts * w / 2
        out += rng.normal(size=out.shape) * np.array([1e-3, 2e-2])
        channels, valid = (Channel("command", "rad"),), np.ones(SAMPLES, bool)
        made.append(Recording(f"run_{seed}", 1 / STEP, u[:, None], out, channels, Servo.state_channels, valid))
    logs, names = tuple(log_of(r, model, "command") for r in made), tuple(r.name for r in made)
    return Subject("servo", model, logs, names[:-2], names[-2:], None, {}, {}, ("angle", "angle_rate", "command"))


def test_the_limit_of_the_motor_is_found_and_the_weight_of_the_arm() -> None:
    answer = discover(subject(LIMIT, WEIGHT))
    found = {f.id: [x.value for x in f.estimates] for f in answer.found}
    assert set(found) == {"force_limit", "gravity_torque"}
    # Only ratios of torques and inertia are told.
    scale = answer.model.mass / INERTIA
    assert 1 / found["force_limit"][0] / scale == pytest.approx(LIMIT, rel=0.05)
    a, b = found["gravity_torque"]
    assert np.hypot(a, b) / scale == pytest.approx(WEIGHT, rel=0.03)
    assert np.arctan2(-b, -a) == pytest.approx(0.4, abs=0.03)


def test_a_controller_whose_output_is_full_is_no_limit_of_the_motor() -> None:
    """A servo of a model shop goes at its top speed, K e/D, wherever it is sent."""
    answer = discover(subject(full=FULL))
    (found,) = answer.found
    assert found.id == "controller_saturation" and not found.rivals
    assert 1 / found.estimates[0].value == pytest.approx(FULL, rel=0.03)


def test_nothing_is_missing_of_a_servo_that_does_as_its_model_says() -> None:
    assert discover(subject()).verdict == "nothing"


@pytest.mark.parametrize("stated", [(0.002, 3.0, 0.25), (0.02, 0.9, 0.15), (0.04, 1.2, 0.09), (0.00015, 1.2, 0.09)])
def test_the_last_constant_that_is_stated_holds_the_scale(stated: tuple[float, float, float]) -> None:
    """Of constants that are up to 27 times off the ratios are told; a common factor changes nothing, and stays."""
    mass, stiffness, damping = stated
    model = Servo(mass=mass, stiffness=stiffness, damping=damping, input_hold="previous")
    answer = discover(subject(model=model), catalogue=[])
    assert answer.verdict == "nothing" and not answer.obscured
    found = answer.model
    assert found.stiffness / found.mass == pytest.approx(STIFFNESS / INERTIA, rel=0.03)
    assert found.damping / found.mass == pytest.approx(DAMPING / INERTIA, rel=0.03)
    moved = [abs(np.log(getattr(found, p.name) / p.value)) for p in model.parameters()]
    assert min(moved) < 0.3


def test_how_far_off_a_constant_was_is_told_by_what_was_stated_of_it_though_it_was_let_go() -> None:
    model = Servo(mass=0.00015, stiffness=1.2, damping=0.09, input_hold="previous")
    said, _ = diagnose(subject(model=model), brief=True)
    (mass,) = (c for c in said.evidence.calibration if c.constant == "mass")
    assert mass.calibrated == said.constants["mass"].value  # as the model that is returned has it
    # A common factor changes nothing, and is as it was stated.
    assert said.constants["stiffness"].value / mass.calibrated == pytest.approx(STIFFNESS / INERTIA, rel=0.03)
    assert mass.low < INERTIA < mass.high
    assert said.error.extended["angle"].rmse < 1.1 * said.noise_floor["angle"].rmse
    assert mass.sigma == pytest.approx((mass.calibrated / mass.nominal - 1) / 0.3)
    assert "mass to 2" in explanation(said) and "not to be believed" not in explanation(said)


def test_what_an_effect_saves_is_told_beside_constants_as_recordings_have_them() -> None:
    """An inertia stated 27 times too small left five times as much beside which an arm's weight was hardly anything."""
    answers = [
        discover(
            subject(weight=0.03, model=Servo(mass=mass, stiffness=1.2, damping=0.09, input_hold="previous")),
            ["gravity_torque"],
        )
        for mass in (INERTIA, 0.00015)
    ]
    right, far = ([e.models["calibrated"] for e in answer.equations] for answer in answers)
    assert far == pytest.approx(right, rel=0.1)


def test_a_limit_is_of_what_follows_a_set_point() -> None:
    assert ForceLimit.suits(Servo)
    assert not ForceLimit.suits(type("Pushed", (Servo,), {"signals": {"command": Signal("N m", ("",))}}))
    assert not ForceLimit.suits(type("Still", (Servo,), {"input_signals": ()}))


def test_a_limit_counts_in_the_unit_of_what_turns() -> None:
    assert Servo().effect_unit("1/N") == "1/(N m)" and Servo().effect_unit("1/(N s)") == "1/(N m s)"
    assert Oscillator().effect_unit("1/(N s)") == "1/(N s)"
