"""A joint that a controller holds on its path against torques that nobody measured: what its torque works against."""

from dataclasses import replace

import numpy as np
import pytest
from test_sticking import DAMPING, FINE, INERTIA, LIMIT, NOISE, RATE, Joint

from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import Subject, log_of
from bench.diagnose.report.sentences import verdict_line
from bench.diagnose.select.closed_loop.inverse_dynamics import inverse_dynamics, with_inverse_dynamics
from bench.diagnose.select.discovery import Discovery, Found
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search
from bench.diagnose.select.simulated.dry_friction import friction_that_saves
from registry.contracts import Channel, Recording
from registry.effects.mechanics.friction import CoulombFriction
from registry.effects.mechanics.stiffness import LinearStiffness
from registry.effects.process import DeadZone

SAMPLES, UNMEASURED = 3000, 0.15
"""Length of a recording, and the torque [N m] of what wanders over a fifth of a second."""


def recording(seed: int, limit: float, shaken: float) -> Recording:
    """A path of slow sines, held so stiffly that next to nothing disturbs it."""
    rng = np.random.default_rng(seed)
    frequency, size, phase = rng.uniform(0.3, 1.2, 3), rng.uniform(0.1, 0.4, 3), rng.uniform(0, 6.28, 3)
    out, dt, disturbance = np.empty((SAMPLES, 3)), 1 / (RATE * FINE), 0.0
    q, w, held = float((size * np.sin(phase)).sum()), float((size * frequency * np.cos(phase)).sum()), 0.0
    for i in range(SAMPLES):
        disturbance += 0.05 * -disturbance + shaken * 0.1**0.5 * rng.normal()
        angle = frequency * i / RATE + phase
        off = np.array([(size * np.sin(angle)).sum() - q, (size * frequency * np.cos(angle)).sum() - w])
        held += 300 * off[0] / RATE
        u = float(np.array([60.0, 2.0]) @ off) + held
        out[i] = q, w, u
        for _ in range(FINE):
            pushed = u + disturbance - DAMPING * w
            if w == 0.0 and abs(pushed) <= limit:
                break
            after = w + dt / INERTIA * (pushed - limit * np.sign(w or pushed))
            w = 0.0 if after * w < 0 and limit else after
            q += dt * w
    states = out[:, :2] + rng.normal(size=(SAMPLES, 2)) * NOISE * 0.1
    model, valid = Joint(), np.ones(SAMPLES, bool)
    return Recording(f"run_{seed}", RATE, out[:, 2:], states, (Channel("torque", "N m"),), model.state_channels, valid)


def subject(limit: float, shaken: float = UNMEASURED) -> Subject:
    made, model = [recording(seed, limit, shaken) for seed in range(6)], Joint(input_hold="previous")
    logs, names = tuple(log_of(r, model, "torque") for r in made), tuple(r.name for r in made)
    return Subject("joint", model, logs, names[:-2], names[-2:], None, {}, {}, ("angle", "angle_rate", "torque"))


def test_a_torque_works_against_friction_where_forwards_it_seems_to_do_nothing() -> None:
    """Beside a mass 22 times too large nothing is missing, and the torque is all but idle."""
    of = subject(LIMIT)
    lost = replace(of.model, mass=0.74, damping=1.26)
    idle = Discovery(lost, lost, (), (), (), (), let_go={"mass": "angle rate"})
    told = with_inverse_dynamics(idle, of, noise_of(of)).inverse
    assert told is not None and (told.effect, told.drive, told.unit) == ("coulomb_friction", "torque", "N m")
    value, low, high = told.friction
    assert low < LIMIT < high and value == pytest.approx(LIMIT, rel=0.08)
    assert told.saves > 0.5
    said = verdict_line("nothing", [], [], [], [], told)
    assert said == "The torque works against Coulomb friction; forecasts by it gain nothing."
    # What was found beside is a tie where it swallows the torque, and fits the path otherwise.
    zone, spring = (Found(n, e, (), 1.0, ()) for n, e in (("dead_zone", DeadZone(0.7)), ("spring", LinearStiffness())))
    (tied,) = with_inverse_dynamics(replace(idle, found=(zone,)), of, noise_of(of)).found
    assert (tied.id, tied.rivals) == ("dead_zone", ("coulomb_friction",))
    beside = with_inverse_dynamics(replace(idle, found=(zone, spring)), of, noise_of(of))
    assert beside.found == () and beside.inverse == told and "spring would fit the path" in beside.remarks[-1]
    # Where every constant is about as stated there is no need of it, and it may be none of those to choose from.
    assert with_inverse_dynamics(idle, of, noise_of(of), ["viscous_friction"]).inverse is None
    assert with_inverse_dynamics(replace(idle, let_go={}), of, noise_of(of)).inverse is None


def test_no_friction_is_told_by_inverse_dynamics_where_there_is_none() -> None:
    of = subject(0.0)
    assert inverse_dynamics(of, noise_of(of), CoulombFriction()) is None


def test_inverse_dynamics_say_nothing_of_what_does_not_move() -> None:
    of = subject(LIMIT)
    still = replace(of, logs=tuple(replace(log, states=0 * log.states) for log in of.logs))
    assert inverse_dynamics(still, noise_of(of), CoulombFriction()) is None


def test_inverse_dynamics_tell_the_mass_where_nothing_disturbs_the_joint() -> None:
    of = subject(LIMIT, shaken=0.0)
    told = inverse_dynamics(of, noise_of(of), CoulombFriction())
    assert told is not None
    assert told.friction[0] == pytest.approx(LIMIT, rel=2e-3) and told.saves > 0.999
    assert told.mass[0] * of.model.mass == pytest.approx(INERTIA, rel=2e-2)


def test_friction_of_a_joint_that_turns_round_within_a_sample_is_no_dead_zone_of_its_drive() -> None:
    """Rows of such intervals bend the mass by half; free runs from the constants beside the dead zone do not."""
    of = subject(LIMIT, shaken=0.0)
    model = replace(of.model, mass=0.0296, damping=0.277, effects=(DeadZone(0.333),))
    search = Search(of, ["coulomb_friction", "dead_zone"], lambda what: None)
    (view, *_) = search.views(search.look(model))
    told = friction_that_saves(search, view, Weighing(of, noise_of(of), model), model)
    assert told is not None
    (friction,) = told.effects
    assert isinstance(friction, CoulombFriction) and friction.f_c == pytest.approx(LIMIT, rel=2e-3)
    assert told.mass == pytest.approx(INERTIA, rel=0.03)
