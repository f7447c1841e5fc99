import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from registry.datasets.reading import cleaning, rotations

RNG = np.random.default_rng(7)


def wander(samples, channels=1, cutoff=6.0):
    """A smooth random signal at 100 Hz and a function that samples it anywhere."""
    f, a, phase = RNG.uniform(0.3, cutoff, (20, channels)), RNG.normal(size=(20, channels)), RNG.uniform(0, 6, (20, 1))
    return lambda t: (a * np.sin(2 * np.pi * f * np.asarray(t)[:, None, None] + phase)).sum(axis=1)


def test_spikes_are_found_exactly_and_steps_are_not():
    x = wander(400, 2)(np.arange(400) / 100)
    x[200:] += 3  # a step stays
    at = np.array([50, 51, 123, 399])
    x[at, 0] += 40
    found = np.flatnonzero(cleaning.spikes(x, 12.0))
    assert found.tolist() == at.tolist()


def test_held_needs_every_channel_to_repeat():
    x = np.array([[1.0, 5.0], [1.0, 5.0], [1.0, 6.0], [2.0, 6.0], [2.0, 6.0]])
    assert cleaning.held(x).tolist() == [False, True, False, False, True]


def test_lost_packets_are_bridged_where_short_and_masked_where_long():
    signal, grid = wander(1000, 2, 1.0), np.arange(1000) / 100
    lost = np.zeros(1000, dtype=bool)
    lost[[100, 300, 301]] = lost[500:590] = True
    x, valid = cleaning.resample(grid[~lost], signal(grid[~lost]), grid, 0.06)
    assert cleaning.runs(~valid) == [(500, 590)]
    assert np.abs(x - signal(grid))[valid].max() < 0.02 * np.abs(signal(grid)).max()
    assert cleaning.runs(~cleaning.resample(grid, signal(grid), grid + 0.5, 0.06)[1]) == [(950, 1000)]


@pytest.mark.parametrize("lag", [-2.7, 0.0, 0.4, 3.0])
def test_a_delay_is_recovered_to_a_tenth_of_a_sample(lag):
    signal, t = wander(3000, 2), np.arange(3000) / 100
    noise = RNG.normal(0, 0.3, (2, 3000, 2))
    found, agreement = cleaning.delay(signal(t) + noise[0], signal(t - lag / 100) + noise[1])
    assert found == pytest.approx(lag, abs=0.1)
    assert agreement > 0.9


def test_flight_excludes_the_ground_between_and_a_margin():
    height = np.concatenate([np.zeros(50), np.ones(100), np.zeros(20), np.ones(100), np.zeros(5)])
    mask = cleaning.airborne(height, 0.5, 10)
    assert cleaning.runs(mask) == [(60, 140), (180, 260)]
    assert cleaning.extent(mask) == slice(60, 260)
    assert cleaning.runs(cleaning.airborne(np.ones(50), 0.5, 10)) == [(10, 40)]
    assert cleaning.extent(cleaning.airborne(np.zeros(50), 0.5, 10)) == slice(0, 0)


def attitudes(n=200):
    return np.column_stack([RNG.uniform(-3, 3, n), RNG.uniform(-1.5, 1.5, n), RNG.uniform(-3, 3, n)])


def test_attitude_conversions_agree_with_scipy():
    euler, v = attitudes(), RNG.normal(size=(200, 3))
    reference = Rotation.from_euler("ZYX", euler[:, ::-1])
    q = rotations.quaternion_from_euler(euler)
    assert np.abs((q * reference.as_quat()).sum(axis=1)) == pytest.approx(1)
    assert rotations.euler_from_quaternion(q) == pytest.approx(euler)
    assert rotations.rotate(q, v) == pytest.approx(reference.apply(v))


def test_rates_agree_with_the_derivative_of_the_rotation():
    euler, euler_rates, dt = attitudes(), RNG.normal(size=(200, 3)), 1e-6
    before, after = (Rotation.from_euler("ZYX", (euler + s * dt * euler_rates)[:, ::-1]) for s in (-0.5, 0.5))
    body = (before.inv() * after).as_rotvec() / dt
    assert rotations.body_rates_from_euler(euler, euler_rates) == pytest.approx(body, abs=1e-6)
    assert rotations.euler_rates_from_body(euler, body) == pytest.approx(euler_rates, abs=1e-4)


def test_quaternion_signs_do_not_flip():
    q = Rotation.from_euler("z", np.linspace(0, 12, 300)[:, None]).as_quat()
    smooth = rotations.unit_quaternion(3 * q * RNG.choice([-1, 1], (300, 1)))
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.03
    assert np.linalg.norm(smooth, axis=1) == pytest.approx(1)
