"""What swings at one frequency and follows no signal: found, told, added; and not found where there is none."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import swinging
import torch
from scipy.stats import kstest

from bench.diagnose import diagnose
from bench.diagnose.fit import fit_parameters
from bench.diagnose.learn.axis_series import AxisSeries, Stretch
from bench.diagnose.learn.request import parsed
from bench.diagnose.learn.spectral_line import Line, line_at, lines
from bench.diagnose.learn.thomson import scan
from bench.diagnose.learn.waves import waves
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.recall import wave
from bench.diagnose.report import model_file, page, sentences
from bench.diagnose.result import Diagnosis, schema
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.simulate.free_run import free_run
from bench.score.chains import measured
from bench.score.unknown.suite import DEVELOPMENT, cases
from registry.effects.waves.periodic_term import PeriodicTerm
from registry.errors import BenchError
from registry.physics.oscillator import Oscillator
from registry.physics.quadrotor import Quadrotor


def found(of: Subject) -> tuple[Line, ...]:
    """The waves in what the calibrated model leaves."""
    of, noise = prepared(of)
    calibrated, _ = fit_parameters(of, of.model, noise, through_simulator=False)
    return waves(of, calibrated, noise)


def coloured(seed: int, count: int = 400) -> np.ndarray:
    """Noise that remembers five samples."""
    x = np.random.default_rng(seed).normal(size=count)
    for k in range(1, count):
        x[k] += 0.8 * x[k - 1]
    return x


def test_of_noise_of_any_colour_the_probability_of_a_line_is_what_it_says() -> None:
    told = []
    for seed in range(300):
        looked = scan([coloured(2 * seed), 5 * coloured(2 * seed + 1, 300)], 0.1)
        at = int(np.argmin(np.abs(looked.frequencies - 1.3)))
        told.append(float(np.exp(-looked.evidence[at])))
    assert kstest(told, "uniform").pvalue > 0.01
    assert np.mean(np.array(told) < 0.05) < 0.1


def test_a_line_in_coloured_noise_stands_out_at_its_frequency_only() -> None:
    t = 0.1 * np.arange(400)
    looked = scan([coloured(s) + 1.5 * np.cos(2 * np.pi * 1.3 * t + s) for s in range(4)], 0.1)
    assert looked.frequencies[np.argmax(looked.evidence)] == pytest.approx(1.3, abs=0.01)
    beyond = np.abs(looked.frequencies - 1.3) > 2 * 3 / 40
    assert looked.evidence.max() > 40 > 15 > looked.evidence[beyond].max()


def test_amplitude_and_phase_come_from_what_was_before() -> None:
    dt, f, count = 0.02, 1.1, 600
    rng = np.random.default_rng(4)
    t = (np.arange(count) + 0.5) * dt
    left = torch.from_numpy(0.7 * np.cos(2 * np.pi * f * t + 0.4) + 0.3 + 0.1 * rng.normal(size=count))[None]
    good = torch.ones(1, count, dtype=torch.bool)
    good[0, 100:150] = False
    left[0, 100:150] = 1e3
    told = wave(left, good, f, dt, so_far=True)[0].numpy()
    now = 400
    before = np.flatnonzero(good[0, :now].numpy())
    design = np.stack([np.cos(2 * np.pi * f * t[before]), np.sin(2 * np.pi * f * t[before]), np.ones(len(before))], 1)
    a, b, _ = np.linalg.lstsq(design, left[0].numpy()[before], rcond=None)[0]
    angle = 2 * np.pi * f * now * dt
    np.testing.assert_allclose(told[now, 0], a * np.cos(angle) + b * np.sin(angle), rtol=0.08, atol=0.02)
    left[0, now:] = -5.0  # what comes later is not known
    np.testing.assert_allclose(wave(left, good, f, dt, so_far=True)[0, : now + 1], told[: now + 1], atol=1e-12)
    assert not told[: round(0.9 / f / dt)].any()


def test_a_wave_is_found_with_frequency_amplitude_and_phase() -> None:
    of = swinging.subject("wave", 1)
    (line,) = found(of)
    assert line.axis == "speed.q" and line.unit == "m/s^2"
    assert line.low < swinging.FREQUENCY < line.high and line.high - line.low < 0.01
    assert set(line.swings) == {log.name for log in of.logs}
    inside = 0
    for i, swing in enumerate(line.swings.values()):
        assert swing.amplitude == pytest.approx(swinging.AMPLITUDE, rel=0.1)
        off = np.angle(np.exp(1j * (swing.phase - swinging.phase_of(1000 + i))))
        assert abs(off) < 0.15
        inside += swing.low < swinging.AMPLITUDE < swing.high and abs(off) < swing.turn
    assert inside >= 4


@pytest.mark.parametrize("kind", ["sine", "sines"])
def test_a_drive_with_many_lines_or_one_as_frequent_hides_no_wave(kind: str) -> None:
    """What functions of it show, and it itself, are not in step with the wave."""
    (line,) = found(swinging.subject(kind, 4))
    assert line.frequency == pytest.approx(swinging.FREQUENCY, rel=0.005)


def answered(seed: int) -> Stretch:
    """A wave of 0.8 Hz, and a signal that answers it and moves by itself besides."""
    rng, count = np.random.default_rng(seed), 500
    t = 0.02 * np.arange(count)
    wave = np.cos(2 * np.pi * 0.8 * t + rng.uniform(-np.pi, np.pi))
    answer = (wave + 0.22 * rng.normal(size=count))[:, None]
    return Stretch(f"run_{seed}", t, wave + 0.4 * rng.normal(size=count), answer, np.zeros(count), answer)


def test_what_answers_a_wave_does_not_hide_it() -> None:
    """Fitted by itself it explains most of the wave, and leaves of it less than is believed."""
    series = AxisSeries("speed.q", "m/s^2", tuple(map(answered, range(6))), 0.02, np.ones(1), 1, 0.02)
    (line,) = lines(series, [f"run_{i}" for i in range(4)])
    assert line.frequency == pytest.approx(0.8, rel=0.003)
    assert [w.amplitude for w in line.swings.values()] == pytest.approx([1.0] * 6, rel=0.1)


def test_of_two_waves_that_are_one_to_these_recordings_neither_has_a_size() -> None:
    series = AxisSeries("speed.q", "m/s^2", tuple(map(answered, range(6))), 0.02, np.ones(1), 1, 0.02)
    told = line_at([0.8, 0.8 + 1e-9], series, [f"run_{i}" for i in range(4)])
    assert told is not None
    assert all(w.low == 0 and w.turn == np.pi for w in told.swings.values())


@pytest.mark.parametrize(
    ("kind", "number"), [("clean", 2), ("gust", 2), ("sampled", 2), ("resonance", 2), ("rubbing", 101)]
)
def test_what_does_not_swing_is_no_wave(kind: str, number: int) -> None:
    assert found(swinging.subject(kind, number)) == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        *("clean", "gust", "sampled", "resonance"),
        pytest.param("rubbing", marks=pytest.mark.xfail(strict=True, reason="two sets: harmonics of dry friction")),
    ],
)
def test_one_false_alarm_in_a_hundred_at_most(kind: str) -> None:
    """Of 50 sets none: more than 1 in 100 would show one with a probability of 40 %; of all 250 with 92 %."""
    assert sum(bool(found(swinging.subject(kind, 100 + i))) for i in range(50)) == 0


@pytest.fixture(scope="module")
def said() -> tuple[Subject, Diagnosis, Oscillator]:
    of = swinging.subject("wave", 3)
    diagnosis, model = diagnose(of, catalogue=["coulomb_friction", "cubic_stiffness"])
    assert isinstance(model, Oscillator)
    return of, diagnosis, model


def test_it_is_said_and_the_error_falls(said: tuple[Subject, Diagnosis, Oscillator], tmp_path: Path) -> None:
    of, diagnosis, model = said
    assert diagnosis.verdict == "unknown_effect" and diagnosis.unexplained.follows == ()
    (effect,) = diagnosis.effects
    assert effect.learned and effect.term is not None and effect.term.shape == "wave" and effect.id == "periodic_term"
    assert effect.parameters["frequency"].value == pytest.approx(swinging.FREQUENCY, rel=0.01)
    # Only the first cycle of every recording cannot be told from what was before.
    assert effect.share_explained > 0.85
    assert set(effect.by_recording) == {log.name for log in of.logs}
    assert "periodic rate of change of speed q of 0.80" in sentences.headline(diagnosis)
    assert "follows no measured signal" in sentences.headline(diagnosis)
    jsonschema.validate(diagnosis.to_json(), schema())
    text = page.render(diagnosis)
    assert "recording by recording" in text and "time in a period" in text and "run_5" in text
    model_file.write(tmp_path / "model.toml", model, diagnosis.effects)
    assert model_file.read(tmp_path / "model.toml").effects == model.effects
    assert json.loads(json.dumps(diagnosis.to_json()))["effects"][0]["by_recording"]["run_0"]["phase"]["unit"] == "rad"


def test_a_wave_is_sought_where_free_runs_err_little_more_than_noise_too() -> None:
    """Nobody would say of these free runs that something is missing: their squared error is 1.6 times the floor's."""
    rng, runs = np.random.default_rng(8), [swinging.recording("wave", 3000 + i, 20.0) for i in range(6)]
    noisy = [(u, x + 0.06 * x.std(0) * rng.normal(size=x.shape)) for u, x in runs]
    diagnosis, _ = diagnose(swinging.recorded("noisy", Oscillator(), noisy), catalogue=["coulomb_friction"], brief=True)
    (effect,) = diagnosis.effects
    assert effect.id == "periodic_term" and diagnosis.verdict == "unknown_effect"
    assert effect.parameters["frequency"].value == pytest.approx(swinging.FREQUENCY, rel=0.01)


def test_a_forecast_swings_on_as_the_past_did() -> None:
    of = swinging.subject("wave", 5, recordings=3)
    log, model = of.logs[0], Oscillator(effects=(PeriodicTerm("speed.q", swinging.FREQUENCY),))
    begin, steps = 1500, 50
    ahead = free_run(model, [log], [np.array([begin])], steps)[0, -1].numpy()
    without = free_run(replace(model, effects=()), [log], [np.array([begin])], steps)[0, -1].numpy()
    true = log.states[begin + steps].numpy()
    assert np.abs(ahead - true).max() < 0.3 * np.abs(without - true).max()
    changed = log.states.clone()
    changed[begin + 1 :] += 1.0  # what comes after the beginning is not looked at
    other = free_run(model, [replace(log, states=changed)], [np.array([begin])], steps)[0, -1].numpy()
    np.testing.assert_allclose(other, ahead, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('axis = "speed.q"', "frequency must be a positive number"),
        ('axis = "speed.q"\nfrequency = -1.0', "frequency must be a positive number"),
        ("frequency = 1.0", "axis must be a text"),
        ('axis = "speed.q"\nfrequency = 1.0\nphase = 2.0', "unknown key 'phase'"),
        ('axis = "sped.q"\nfrequency = 1.0', "speed.q"),
    ],
)
def test_a_file_that_says_something_else_is_refused(text: str, match: str, tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text(f'system = "oscillator"\n[[effects]]\nid = "periodic_term"\n{text}\n')
    with pytest.raises(BenchError, match=match):
        model_file.read(path)


def test_a_force_along_the_world_stays_there_while_the_vehicle_turns() -> None:
    model = Quadrotor(effects=(PeriodicTerm("world_force_z", 2.0), PeriodicTerm("torque_y", 1.0)))
    state = torch.zeros(1, 17, dtype=torch.float64)
    state[:, 6:10] = torch.tensor([0.5, 0.5, 0.5, 0.5])  # xyzw
    state[:, 13], state[:, 16] = 0.3, 0.2
    rates = model.derivative(state, torch.zeros(1, 4, dtype=torch.float64))[0]
    plain = Quadrotor().derivative(state[:, :13], torch.zeros(1, 4, dtype=torch.float64))[0]
    np.testing.assert_allclose(rates[3:6] - plain[3:6], [0, 0, 0.3 / model.mass], atol=1e-12)
    np.testing.assert_allclose(rates[10:13] - plain[10:13], 0.0, atol=1e-12)
    np.testing.assert_allclose(rates[13:], [0.0, -4 * np.pi * 0.3, 2 * np.pi * 0.2, 0.0], atol=1e-12)


def test_a_wave_is_asked_for_by_its_axis() -> None:
    pair = parsed("speed ~ wave", Oscillator())
    assert pair is not None and (pair.axis, pair.signals) == ("speed.q", ("wave",))


def test_a_force_that_shows_in_both_frames_is_told_along_that_which_it_keeps_to(tmp_path: Path) -> None:
    """Flights that tilt far: along the body's axes the force has another size in each of them.

    The likelihood that a line gains along its own axis is larger there.
    """
    (case,) = (c for c in cases(DEVELOPMENT) if c.id == "201-periodic-24-crazyflie-low")
    subject, _ = measured(replace(case, recordings=6, seconds=30.0), tmp_path)
    line, *_ = found(subject)
    assert line.axis == case.wave_axis == "world_force_x"
    assert line.low < case.frequencies[0] < line.high
