"""What swings or relaxes out of sight: found, told, added; and not found where nothing does."""

import dataclasses
from pathlib import Path

import hanging
import jsonschema
import numpy as np
import pytest
import swinging
import torch
from scipy.linalg import expm
from scipy.signal import StateSpace, lsim

from bench.diagnose import diagnose, extend
from bench.diagnose.checks.shifts import lag_of
from bench.diagnose.compare import above_floor
from bench.diagnose.extend import _named
from bench.diagnose.fit import fit_parameters
from bench.diagnose.learn import all_terms
from bench.diagnose.learn.modes.filters import Pole
from bench.diagnose.learn.modes.modes import modes
from bench.diagnose.learn.request import parsed
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import LogBatch, Subject, log_of
from bench.diagnose.regression.parameters import effect_entries
from bench.diagnose.regression.recall import begun, driven, turned
from bench.diagnose.regression.weak import own_states
from bench.diagnose.report import model_file, page, sentences
from bench.diagnose.result import Diagnosis, schema
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.select.verify import Estimate
from bench.diagnose.simulate.beginning import without_beginning
from bench.diagnose.simulate.equation_error import EquationError
from registry.contracts import Channel, Recording
from registry.effects.waves.hidden_mode import HiddenMode
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor

FREQUENCY, DAMPING, GAINS = 1.3, 0.07, (0.4, -0.25)
IMITATORS = ("coulomb_friction", "cubic_stiffness", "joint_elasticity", "quadratic_drag", "viscous_friction")
"""Effects that might be named in place of what swings: one swings itself. Others cost half a minute each to try."""


def matrices(order: int) -> tuple[np.ndarray, np.ndarray]:
    """A and b of z and ż/ω."""
    w = 2 * np.pi * FREQUENCY
    if order == 1:
        return np.array([[-w]]), np.array([[w]])
    return np.array([[0.0, w], [-w, -2 * DAMPING * w]]), np.array([[0.0], [w]])


@pytest.mark.parametrize("order", [1, 2])
def test_filters_are_those_of_an_independent_simulation(order: int) -> None:
    step, d = 0.02, np.cumsum(np.random.default_rng(0).normal(size=(200, 2)), axis=0)
    found = Pole(FREQUENCY, DAMPING, order).response(d, step)
    a, b = matrices(order)
    for j in range(2):
        driver = d[:, j] - d[0, j]
        seen = lsim(StateSpace(a, b, np.eye(order), 0 * b), driver, np.arange(200) * step)[2].reshape(200, order)
        np.testing.assert_allclose(found[0][:, j], seen[:, 0] - driver, atol=1e-9)
        np.testing.assert_allclose(found[-1][:, j], seen[:, -1] - (driver if order == 1 else 0.0), atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_own_states_are_those_of_the_matrix_exponential(order: int) -> None:
    mode = HiddenMode(("speed.q",), ("speed.q",), order, FREQUENCY, DAMPING, GAINS[:order])
    a, _ = matrices(order)
    for t in (0.0, 0.3, 2.0):
        now = turned(mode, torch.tensor([[t]], dtype=torch.float64))[0, 0].numpy()
        np.testing.assert_allclose(now, expm(a * t), atol=1e-9)
        np.testing.assert_allclose(Pole(FREQUENCY, DAMPING, order).turned(np.array([t]))[0], expm(a * t), atol=1e-9)
    d = np.cumsum(np.random.default_rng(1).normal(size=50))
    path = driven(mode, torch.from_numpy(d)[None], 0.01)[0].numpy()
    x = np.zeros(order)
    x[0] = d[0]
    for k in range(50):
        np.testing.assert_allclose(path[k], x, atol=1e-9)
        rest = np.zeros(order)
        rest[0] = d[k]
        x = rest + expm(a * 0.01) @ (x - rest)


def test_how_a_mode_began_comes_from_what_was_before() -> None:
    dt, count, now = 0.01, 600, 400
    rng = np.random.default_rng(2)
    mode = HiddenMode(("speed.q",), ("speed.q",), 2, FREQUENCY, DAMPING, GAINS)
    d = torch.from_numpy(np.cumsum(rng.normal(size=count)) * 0.02)[None]
    start = np.array([0.6, -0.4])
    free = turned(mode, (dt * torch.arange(count + 1, dtype=torch.float64))[None])[0].numpy() @ start
    path = driven(mode, d, dt)[0].numpy() + free
    middle = (path[:-1] + path[1:]) / 2
    w = 2 * np.pi * FREQUENCY
    left = w * (GAINS[0] * (middle[:, 0] - d[0].numpy()) + GAINS[1] * middle[:, 1]) + 0.2
    swing = w * ((free[:-1] + free[1:]) / 2 @ np.array(GAINS))
    seen = torch.from_numpy(left + 0.05 * rng.normal(size=count))[None]
    good = torch.ones(1, count, dtype=torch.bool)
    told = begun(mode, 0, seen, d, good, dt=dt, so_far=True)[0].numpy()
    np.testing.assert_allclose(told[now:], path[now:], atol=0.05)
    assert np.abs(told[now:] - (path - free)[now:]).max() < np.abs(free).max()
    changed = seen.clone()
    changed[0, now:] += torch.from_numpy(2 * swing[: count - now])  # what comes later is not known
    again = begun(mode, 0, changed, d, good, dt=dt, so_far=True)[0].numpy()
    np.testing.assert_allclose(again[now // 4 : now + 1], told[now // 4 : now + 1], atol=0.01)
    whole = begun(mode, 0, changed, d, good, dt=dt, so_far=False)[0].numpy()
    assert np.abs(whole - told)[now // 4 : now + 1].max() > 0.05


def test_a_swing_is_known_although_what_drives_it_rested() -> None:
    dt, rng = 0.01, np.random.default_rng(4)
    mode = HiddenMode(("speed.q",), ("speed.q",), 2, FREQUENCY, DAMPING, GAINS)
    d = torch.cat([torch.zeros(300), torch.from_numpy(np.cumsum(rng.normal(size=300)) * 0.02)])[None]
    free = turned(mode, (dt * torch.arange(601, dtype=torch.float64))[None])[0].numpy() @ np.array([0.6, -0.4])
    forced = driven(mode, d, dt)[0].numpy()
    gains = 2 * np.pi * FREQUENCY * np.array(GAINS)
    own = (forced + free)[:-1] / 2 + (forced + free)[1:] / 2
    left = torch.from_numpy(own @ gains - gains[0] * d[0].numpy() + 0.02 * rng.normal(size=600))[None]
    good = torch.ones(1, 600, dtype=torch.bool)
    told = begun(mode, 0, left, d, good, dt=dt, so_far=True)[0].numpy()
    np.testing.assert_allclose(told[150:300], free[150:300], atol=0.05)


def found(of: Subject) -> tuple[HiddenMode, ...]:
    """The modes in what the calibrated model leaves."""
    of, noise = prepared(of)
    calibrated, _ = fit_parameters(of, of.model, noise, through_simulator=False)
    return modes(of, calibrated, noise)


@pytest.mark.parametrize("kind", ["clean", "gust", "cubic", "sampled"])
def test_what_does_not_swing_is_no_mode(kind: str) -> None:
    assert found(hanging.subject(kind, 2)) == ()


def test_a_faster_mode_is_told_from_an_input_which_has_no_noise() -> None:
    (mode,) = found(hanging.subject("shaft", 5))
    assert mode.drivers == ("force",)
    assert mode.frequency == pytest.approx(hanging.frequency_of("shaft"), rel=0.03)


def test_models_on_recordings_begun_at_other_times_are_judged_by_the_same_free_runs() -> None:
    whole = hanging.subject("clean", 6)
    late = dataclasses.replace(whole, logs=tuple(without_beginning(log, 300) for log in whole.logs))
    both, noise = [(whole, whole.model), (late, late.model)], noise_of(whole)
    same = above_floor([(late, late.model)] * 2, noise)
    for told, wanted in zip(above_floor(both, noise), same, strict=True):
        np.testing.assert_allclose(told, wanted, rtol=1e-9)


@pytest.fixture(scope="module")
def said() -> tuple[Diagnosis, Oscillator]:
    diagnosis, model = diagnose(hanging.subject("pendulum", 3), catalogue=IMITATORS, brief=False)
    assert isinstance(model, Oscillator)
    return diagnosis, model


def test_a_pendulum_is_said_and_the_error_falls(said: tuple[Diagnosis, Oscillator], tmp_path: Path) -> None:
    diagnosis, model = said
    assert diagnosis.verdict == "unknown_effect"
    (effect,) = diagnosis.effects
    assert effect.id == "hidden_mode" and effect.learned and effect.term is not None
    assert effect.term.shape == "swing" and effect.term.axis == "speed.q" and effect.term.signals == ("speed.q",)
    assert effect.parameters["frequency"].value == pytest.approx(hanging.frequency_of("pendulum"), rel=0.03)
    assert effect.parameters["q"].value == pytest.approx(-hanging.HUNG / hanging.MASS, rel=0.1)
    assert effect.share_explained > 0.9
    text = sentences.headline(diagnosis)
    assert "something swings at 0.8" in text and "driven by the rate of change of speed q" in text
    jsonschema.validate(diagnosis.to_json(), schema())
    assert "what the hidden mode tells" in page.render(diagnosis)
    model_file.write(tmp_path / "model.toml", model, diagnosis.effects)
    read = model_file.read(tmp_path / "model.toml").effects
    assert [dataclasses.astuple(e)[:3] for e in read] == [dataclasses.astuple(e)[:3] for e in model.effects]


def test_learned_terms_that_are_asked_for_hold_a_hidden_mode() -> None:
    of = hanging.subject("pendulum", 3)
    (effect,) = extend(of, of.model, "learned").effects
    assert effect.id == "hidden_mode"
    assert effect.parameters["frequency"].value == pytest.approx(hanging.frequency_of("pendulum"), rel=0.03)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "axes must be one to 3 names"),
        ('axes = ["speed.q"]\ndrivers = ["speed.q", "force"]', "as many as axes"),
        ('axes = ["speed.q"]\ndrivers = ["speed.q"]\nfrequency = 0.0', "frequency must be a positive number"),
        (
            'axes = ["speed.q"]\ndrivers = ["speed.q"]\nfrequency = 1.0\ndamping = 2.0',
            "damping must be a number from 0",
        ),
        ('axes = ["speed.q"]\ndrivers = ["speed.q"]\nfrequency = 1.0\ngains = [1.0]', "a list of 2 finite numbers"),
        ('axes = ["speed.q"]\ndrivers = ["sped.q"]\nfrequency = 1.0\ngains = [1.0, 0.0]', "speed.q"),
        ('axes = ["speed.q"]\ndrivers = ["speed.q"]\norder = 3', "order must be 2"),
        ('axes = ["speed.q"]\ndrivers = ["speed.q"]\nmass = 3.0', "unknown key 'mass'"),
    ],
)
def test_a_file_that_says_something_else_is_refused(text: str, match: str, tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(f'system = "oscillator"\n[[effects]]\nid = "hidden_mode"\n{text}\n')
    with pytest.raises(BenchError, match=match):
        model_file.read(path)


def test_a_mass_on_a_spring_under_a_vehicle_pulls_it_back() -> None:
    mode = HiddenMode(("world_force_x", "world_force_y"), ("velocity.x", "velocity.y"), 2, 0.7, 0.0, (0.0, -0.1) * 2)
    model = Quadrotor(effects=(mode,))
    state = torch.zeros(1, 17, dtype=torch.float64)
    state[:, 6:10] = torch.tensor([0.5, 0.5, 0.5, 0.5])  # xyzw
    state[:, 3], state[:, 14] = 2.0, 0.3  # it flies along x; along x the load has swung
    rates = model.derivative(state, torch.zeros(1, 4, dtype=torch.float64))[0]
    plain = Quadrotor().derivative(state[:, :13], torch.zeros(1, 4, dtype=torch.float64))[0]
    w = 2 * np.pi * 0.7
    np.testing.assert_allclose(rates[3:6] - plain[3:6], [-0.1 * w * 0.3 / model.mass, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rates[13:], [w * 0.3, w * 2.0, 0.0, 0.0], atol=1e-12)


def test_a_mode_of_which_hardly_a_number_was_estimated_is_told_with_all() -> None:
    mode = HiddenMode(("speed.q",), ("displacement.q",), 2, 0.07, 1.0, (-0.05, 0.38))
    model = Oscillator(effects=(mode,))
    often = next(e for e in effect_entries(mode, owner=0) if e.label == "frequency")
    told = _named(mode, model, [Estimate(often, 0.07, 0.0, 0.19)], 0.0, {}, {}, {}, None)
    assert list(told.parameters) == ["frequency", "damping", "p", "q"]
    assert (told.parameters["frequency"].high, told.parameters["damping"].high) == (0.19, 1.0)


def test_a_mode_that_never_relaxes_has_no_end_of_its_time_constant() -> None:
    mode = HiddenMode(("speed.q",), ("displacement.q",), 1, 0.0, 1.0, (0.1,))
    often = next(e for e in effect_entries(mode, owner=0) if e.label == "frequency")
    told = _named(mode, Oscillator(effects=(mode,)), [Estimate(often, 0.0, 0.0, 0.2)], 0.0, {}, {}, {}, None)
    constant = told.parameters["time constant"]
    assert constant.value == np.inf and constant.low == pytest.approx(1 / (2 * np.pi * 0.2))


def test_a_mode_is_asked_for_by_its_axis() -> None:
    pair = parsed("speed ~ swing", Oscillator())
    assert pair is not None and (pair.axis, pair.signals) == ("speed.q", ("swing",))


def test_what_swings_out_of_sight_moves_what_is_seen_at_times_of_its_own() -> None:
    """A second mass on a spring, 30 % of the first: its push is no motion that comes before or after the drive."""
    rng, turn, ratio, zeta, step = np.random.default_rng(3), 2 * np.pi * 2.0, 0.3, 0.03, 0.01
    a, b = np.zeros((4, 4)), np.array([[0.0], [1.0], [0.0], [1.0]])
    pull = np.array([turn**2, 2 * zeta * turn])  # of the stretch and its rate
    a[0, 1] = a[2, 3] = 1.0
    a[1], a[3] = [-100, -0.5, *(-ratio * pull)], [-100, -0.5, *(-(1 + ratio) * pull)]
    drive = lsim(([1.0], [0.02, 1.0]), rng.normal(size=2000) * 30, np.arange(2000) * step)[1]
    seen = lsim(StateSpace(a, b, np.eye(4), 0 * b), drive, np.arange(2000) * step, [0.0, 0.0, 0.5, 0.0])[2][:, :2]
    mode = HiddenMode(("speed.q",), ("speed.q",), 2, turn / 2 / np.pi, zeta, (0.0, -ratio))
    model = dataclasses.replace(Oscillator(), effects=(mode,))
    valid = np.ones(len(seen), dtype=bool)
    made = Recording("run", 100.0, drive[:, None], seen, (Channel("force", "N"),), model.state_channels, valid)
    log = log_of(made, model, "force")
    with torch.no_grad():
        own = own_states(model, LogBatch.of([log]))[0]
    assert abs(lag_of(model, log, own)[0]) < 0.1 and lag_of(model, log, own)[1] > 0.99
    assert lag_of(model, log)[1] < 0.97


def test_an_equation_in_which_a_mode_does_nothing_does_not_refute_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """One equation that it saves, and one a little above its noise that it does not move."""
    saved = EquationError("upper level", 60.0, "V", {"calibrated": 0.040, "extended": 0.0055}, 0.0050, 0.0050)
    other = EquationError("level", 60.0, "V", {"calibrated": 0.0051, "extended": 0.0051}, 0.0043, 0.0043)

    class Weighed:
        def __init__(self, *_: object) -> None: ...

        def errors(self, _: object) -> tuple[EquationError, ...]:
            return saved, other

    monkeypatch.setattr(all_terms, "Weighing", Weighed)
    subject = swinging.subject("clean", 1, recordings=3, seconds=2.0)
    left = all_terms.left_by(subject, Oscillator(), noise_of(subject), (), lambda what: None)
    assert left.most == 1.0 and left.whole < 0.02
