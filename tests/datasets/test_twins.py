"""The simulated data sets: deterministic, in the room, near the published maxima, measured as documented."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from registry.core import DATASETS
from registry.datasets import twins
from registry.datasets.twin import helicopter as twin_helicopter
from registry.datasets.twin import quadrotor as twin_quadrotor
from registry.datasets.twin.reference import slow_error
from registry.errors import BenchError


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def pelican(cache):
    return twins.PelicanTwin().load()


@pytest.fixture(scope="module")
def helicopter(cache):
    return twins.HelicopterTwin().load()


def columns(loaded, signal):
    return np.concatenate([r.pick([signal])[0] for r in loaded.recordings])


def test_pelican_maxima_are_near_the_published_table(pelican):
    published = np.array([3.9268, 3.9721, 5.8526, 3.9116, 3.8506, 3.7902])
    largest = np.abs(np.hstack([columns(pelican, "velocity"), columns(pelican, "body_rates")])).max(0)
    assert (np.abs(largest / published - 1) < 0.2).all(), largest


def test_pelican_stays_in_the_room(pelican):
    position = columns(pelican, "position")
    assert (np.abs(position[:, :2]) < 2.5).all(), np.abs(position).max(0)
    assert position[:, 2].min() > 0.05 and position[:, 2].max() < 5
    assert position[:, 2].min() < 0.4, "some of it is in ground effect"


def test_regimes_grow(pelican):
    speed = {r.name: np.linalg.norm(r.pick(["velocity"])[0], axis=1).mean() for r in pelican.recordings}
    means = [np.mean([v for n, v in speed.items() if n.startswith(g)]) for g in twins.REGIMES]
    assert (np.diff(means) > 0).all() and means[0] < 0.2 and means[-1] > 0.8, means


def test_signals_agree_with_each_other(pelican, helicopter):
    """Euler rates are those of the attitude, by another library's rotations."""
    for loaded, tolerance in ((pelican, 0.02), (helicopter, 0.5)):
        recording = next(r for r in loaded.recordings if r.name.startswith("moderate"))
        angles = Rotation.from_quat(recording.pick(["attitude"])[0]).as_euler("ZYX")[:, ::-1]
        difference = np.diff(np.unwrap(angles, axis=0), axis=0) * recording.rate
        assert np.abs(difference - recording.pick(["euler_rates"])[0][1:]).mean() < tolerance
        assert np.abs(angles[:, 1]).max() < np.deg2rad(80)


def test_measurement_is_smoothed_then_differenced():
    n = 400
    t = np.arange(n) * 0.01
    truth = np.zeros((n, 21))
    truth[:, 0] = np.sin(3 * t)
    angles = np.stack([0.4 * np.sin(2 * t), 0.3 * np.cos(3 * t), 5 * t], axis=1)
    truth[:, 6:10] = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat()
    truth[:, 13:17] = 601.0
    out = twin_quadrotor.measure(np.random.default_rng(0), truth)
    assert out.shape == (n - 1, 24) and (out[5:-5, :4] == pytest.approx(600.0)), "rotor speeds come in whole counts"
    # The difference of samples k-1 and k is the velocity half a sample earlier.
    error = out[5:-5, 7] - 3 * np.cos(3 * (t[1:] - 0.005))[5:-5]
    assert error.std() == pytest.approx(
        0.0004 * 100 * np.sqrt(518) / 35, rel=0.15
    )  # (-3 15 5 -5 -15 3)/35 of white noise
    back, ahead = (Rotation.from_euler("ZYX", angles[s, ::-1]) for s in (slice(0, -1), slice(1, None)))
    exact = (back.inv() * ahead).as_rotvec() * 100  # body rates half a sample earlier
    assert np.abs(out[5:-5, 14:17] - exact[5:-5]).max() < 0.06


def test_slow_error_is_bounded_and_slow():
    error = slow_error(np.random.default_rng(1), 6000, 0.005, 3)
    assert np.abs(error).max() <= 0.005 < 2 * np.abs(error).max()
    assert np.abs(np.diff(error, axis=0)).max() * 100 < 0.004


def test_simple_model_lacks_what_the_truth_has():
    """One step ahead from true states: the motion model misses accelerations that the truth's effects explain."""
    with torch.inference_mode():
        truth = torch.from_numpy(twin_quadrotor.flights(0, [10, 10, 10, 600])[1][3])
        simple = twin_quadrotor.Quadrotor()
        full = twin_quadrotor.TRUTH.step(truth[:-1, :17], truth[:-1, 17:], truth[:-1, 17:], 0.01)[:, :13]
        nominal = simple.step(truth[:-1, :13], truth[:-1, 13:17], truth[1:, 13:17], 0.01)
    assert (full - truth[1:, :13]).abs().max() < 1e-12
    assert (nominal - truth[1:, :13])[:, 3:6].abs().mean() * 100 > 0.02  # m/s²


def test_flights_are_deterministic_and_do_not_depend_on_their_number():
    with torch.inference_mode():
        for module in (twin_quadrotor, twin_helicopter):
            few, again, many = (module.flights(5, [n] * k)[0] for n, k in ((150, 4), (150, 4), (150, 9)))
            assert all((a == b).all() for a, b in zip(few, again, strict=True))
            assert all((a == b).all() for a, b in zip(few, many, strict=False))
            assert (module.flights(6, [150])[0][0] != few[0]).any()


def test_thread_count_does_not_matter():
    code = (
        "import torch, hashlib; torch.set_num_threads({}); from registry.datasets.twin import quadrotor as t\n"
        "print(hashlib.sha256(b''.join(f.tobytes() for f in t.flights(0, [80] * 5)[0])).hexdigest())"
    )
    env = {**os.environ, "OMP_NUM_THREADS": "2"}
    runs = [subprocess.check_output([sys.executable, "-c", code.format(n)], env=env) for n in (1, 2)]
    assert runs[0] == runs[1]


def test_cache_gives_the_same_and_a_torn_one_is_made_again(pelican, monkeypatch, caplog):
    caplog.set_level("INFO", "registry")
    file = twins.cache_folder() / f"pelican_twin-small-0-v{twins.VERSION}.npz"
    assert twins.PelicanTwin().load().digest() == pelican.digest()
    whole = file.read_bytes()
    assert caplog.messages == []
    file.write_bytes(whole[: len(whole) // 2])
    monkeypatch.setattr(twins.PelicanTwin, "simulate", lambda self: np.split(np.ones((28 * 3000, 24)), 28))
    assert len(twins.PelicanTwin().read().recordings) == 28
    assert caplog.messages == ["Simulating the 28 flights of pelican_twin, once; they are kept for the next time."]
    file.write_bytes(whole)
    assert twins.PelicanTwin().load().digest() == pelican.digest()
    assert not list(file.parent.glob(".*"))


@pytest.mark.parametrize("name", ["pelican_twin", "helicopter_twin"])
def test_split_has_every_regime_in_every_part(name, pelican, helicopter):
    loaded = pelican if name == "pelican_twin" else helicopter
    parts = DATASETS.get(name)().split(loaded.names)
    every = [*parts.train, *parts.validation, *parts.test]
    assert sorted(every) == sorted(loaded.names) and len(set(every)) == len(every)
    for part, share in ((parts.train, 0.6), (parts.validation, 0.15), (parts.test, 0.25)):
        assert {n.partition("_")[0] for n in part} == set(twins.REGIMES)
        assert len(part) / len(every) == pytest.approx(share, abs=0.05)


def test_full_has_the_published_lengths():
    assert len(twins.PELICAN_LENGTHS) == 54 and sum(twins.PELICAN_LENGTHS) == 1_388_410
    assert twins.PelicanTwin(size="full").lengths() == twins.PELICAN_LENGTHS


@pytest.mark.data
def test_lengths_are_those_of_the_published_description():
    root = os.environ.get("BENCH_DATA", "")
    file = os.path.join(root, "pelican_docs", "copyAY_pelican_dataset.json")
    if not root or not os.path.exists(file):
        pytest.skip("BENCH_DATA holds no pelican_docs")
    with open(file) as text:
        assert tuple(json.load(text)["flight_lengths"]) == twins.PELICAN_LENGTHS


def test_helicopter_is_informative_and_the_wind_hidden(helicopter):
    assert {c.group for c in helicopter.recordings[0].channels} == {
        "pilot", "velocity", "attitude", "body_rates", "euler_rates"
    }  # fmt: skip
    rates, sticks = columns(helicopter, "body_rates"), columns(helicopter, "pilot")
    assert (rates.std(0) > 20 * twin_helicopter.NOISE["body_rates"]).all()
    assert np.abs(sticks).max() <= 1 and (sticks.std(0) > 0.1).all()


def test_a_wrong_option_is_one_sentence():
    with pytest.raises(BenchError, match=r"pelican_twin\.size = 'big': choose one of small, full"):
        twins.PelicanTwin(size="big")
