"""The published recordings of systems that do not fly, of weighted hops, and the physics known to hide there."""

import os
import zlib
from functools import cache

import numpy as np
import pytest
import scipy.io
import torch
from scipy.interpolate import CubicSpline

from registry.core import DATASETS, PHYSICS
from registry.datasets.benchmarks.cascaded_tanks import CascadedTanks
from registry.datasets.benchmarks.emps import Emps
from registry.datasets.benchmarks.silverbox import RATE, Silverbox, band_limited
from registry.datasets.crazypad import Crazypad
from registry.datasets.logs.formats.usd import read_usd_log
from registry.effects.mechanics.friction import STICKING, CoulombFriction, OffsetForce, ViscousFriction
from registry.effects.mechanics.stiffness import CubicStiffness
from registry.effects.process import Overflow
from registry.errors import BenchError
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.oscillator import Oscillator
from registry.physics.tanks import Tanks

ENTRIES = (Emps, CascadedTanks, Silverbox, Crazypad)
data = [
    pytest.mark.data,
    pytest.mark.skipif(not os.path.isdir(os.environ.get("BENCH_DATA", "")), reason="BENCH_DATA names no folder"),
]


@cache
def loaded(entry):
    return entry().load()


def recordings(entry):
    return {r.name: r for r in loaded(entry).recordings}


def counts(entry, kind):
    return {f.recording: f.count for f in loaded(entry).findings if f.kind == kind}


def columns(r, *names):
    return r.pick(list(names))[0].T


def error(r, model, horizon, stride):
    """Root mean square of the first state over free runs of ``horizon`` samples from measured states."""
    states = r.pick([c.name for c in model.state_channels])[0]
    starts = [k for k in range(0, len(r) - horizon, stride) if r.valid[k : k + horizon + 1].all()]
    at = np.array(starts)[:, None] + np.arange(horizon + 1)
    x, u = torch.from_numpy(states[at]), torch.from_numpy(r.inputs[at])
    with torch.inference_mode():
        return float((model.simulate(x[:, 0], u, 1 / r.rate) - x)[:, 1:, 0].square().mean().sqrt())


def windows(x, dt, width, stride):
    """Integrals of ``x`` (N,) over windows [k, k + width]."""
    total = np.concatenate([[0], np.cumsum((x[1:] + x[:-1]) / 2 * dt)])
    starts = np.arange(width, len(x) - 2 * width, stride)
    return total[starts + width] - total[starts]


@pytest.mark.parametrize("entry", [pytest.param(e, marks=data, id=e.__name__) for e in ENTRIES])
def test_loaders_fit_their_models(entry):
    assert DATASETS.get(DATASETS.name_of(entry)) is entry
    model = PHYSICS.get(entry.system)(**entry.physics)
    names = loaded(entry).names
    split = entry().split(names)
    assert sorted((*split.train, *split.validation, *split.test)) == sorted(names) and split.train and split.test
    for r in loaded(entry).recordings:
        assert {c.group for c in r.input_channels} == set(entry.inputs) <= set(model.input_signals)
        assert {c.name for c in r.channels} & {c.name for c in model.state_channels}
        assert np.isfinite(r.inputs).all() and np.isfinite(r.outputs).all()


class TestEmps:
    pytestmark = data

    def test_what_was_read(self):
        r = recordings(Emps)
        assert {n: len(x) for n, x in r.items()} == {"DATA_EMPS": 24841, "DATA_EMPS_PULSES": 24841}
        position, speed, voltage = columns(r["DATA_EMPS"], "displacement", "speed", "voltage")
        assert position.max() == pytest.approx(0.2464, abs=1e-4) and np.abs(voltage).max() == pytest.approx(
            4.3257, abs=1e-4
        )
        # Integrated, the speed gives the position back.
        assert windows(speed, 1e-3, 500, 100) == pytest.approx(differences(position, 500, 100), abs=2e-6)

    def test_friction_and_offset_are_what_is_missing(self):
        train, test = (recordings(Emps)[n] for n in ("DATA_EMPS", "DATA_EMPS_PULSES"))
        speed, voltage = columns(train, "speed", "voltage")
        change = differences(speed, 200, 50)
        terms = [voltage * 35.15065, -speed, -np.tanh(speed / STICKING), np.ones_like(speed)]
        a = np.stack([windows(x, 1e-3, 200, 50) for x in terms], axis=1)
        inverse, *scaled = np.linalg.lstsq(a, change, rcond=None)[0]
        mass, (f_v, f_c, f_0) = 1 / inverse, np.array(scaled) / inverse
        assert (mass, f_v, f_c, f_0) == pytest.approx((95.1, 203.5, 20.4, 3.16), rel=0.05)
        alone = 1 / np.linalg.lstsq(a[:, :1], change, rcond=None)[0][0]
        friction = (ViscousFriction(f_v=f_v), CoulombFriction(f_c=f_c), OffsetForce(f_0=f_0))
        before = 1e3 * error(test, MassOnRail(mass=alone), 500, 400)
        after = 1e3 * error(test, MassOnRail(mass=mass, effects=friction), 500, 400)
        assert before == pytest.approx(8.82, rel=0.15) and after < 1.0


def differences(x, width, stride):
    """x[k + width] − x[k] at the windows of `windows`."""
    starts = np.arange(width, len(x) - 2 * width, stride)
    return x[starts + width] - x[starts]


class TestCascadedTanks:
    pytestmark = data

    def test_what_was_read(self):
        r = recordings(CascadedTanks)
        assert {n: len(x) for n, x in r.items()} == {"estimation": 1024, "validation": 1024}
        assert counts(CascadedTanks, "saturated") == {"estimation": 48, "validation": 39}
        assert columns(r["validation"], "level")[0, 0] == 4.9728

    def test_overflow_explains_the_ceiling(self):
        """Constants of fits to the estimation recording; the upper tank's start is sought."""
        r = recordings(CascadedTanks)["validation"]
        level = columns(r, "level")[0]
        rims = Overflow(k=0.556, upper_rim=20.0, lower_rim=9.949, share=0.693)
        base = Tanks(input_hold=CascadedTanks.input_hold)
        extended = Tanks(0.02476, 0.00389, 0.08852, -0.00881, 0.05646, effects=(rims,), input_hold="previous")

        def rmse(model, starts):
            first = torch.tensor([[h, level[0]] for h in starts], dtype=torch.float64)
            drive = torch.from_numpy(r.inputs).expand(len(starts), -1, -1)
            with torch.inference_mode():
                found = model.simulate(first, drive, 4.0)[..., 1].numpy()
            return np.sqrt(((found - level) ** 2).mean(axis=1)).min()

        before, after = rmse(base, (24.5, 25.3, 26.0)), rmse(extended, (15.2, 15.8, 16.4))
        assert before == pytest.approx(0.66, abs=0.02) and after == pytest.approx(0.258, abs=0.01)


class TestSilverbox:
    pytestmark = data

    def test_what_was_read(self):
        r = recordings(Silverbox)
        sizes = {"arrow": 40500} | {f"multisine_{k:02d}": 8600 for k in range(1, 11)}
        assert {n: len(x) / 4 for n, x in r.items()} == sizes
        for name, x in r.items():
            force, position = columns(x, "force", "displacement")
            assert 0.07 < np.abs(force).max() < 0.17 and 0.15 < np.abs(position).max() < 0.32
            # Each begins out of rest: nothing of the one before is left in it.
            assert np.abs(force[:8]).max() < 0.03 and np.abs(position[:8]).max() < 0.03, name

    @pytest.mark.parametrize("finer", [1, 4])
    def test_interpolation_is_exact_within_the_band(self, finer):
        w, t = 2 * np.pi * 67.0, np.arange(4000) / RATE
        fine = np.arange(4000 * finer) / RATE / finer
        inside = slice(400 * finer, -400 * finer)
        for order, expected in enumerate((np.sin(w * fine), w * np.cos(w * fine))):
            found = band_limited(np.sin(w * t), finer, order)
            assert found[inside] == pytest.approx(expected[inside], abs=2e-3 * w**order)

    def test_the_spring_hardens_with_the_cube(self):
        r = recordings(Silverbox)
        terms, drive = [], []
        for name in Silverbox().split(list(r)).train:
            x = r[name]
            q, v, u = (columns(x, s)[0] for s in ("displacement", "speed", "force"))
            t = np.arange(len(v)) / x.rate
            acceleration = CubicSpline(t, v)(t, 1)
            terms.append(np.stack([acceleration, v, q, q**3], axis=1)[x.valid])
            drive.append(u[x.valid])
        m, d, k, k_3 = np.linalg.lstsq(np.concatenate(terms), np.concatenate(drive), rcond=None)[0]
        base, spring = Oscillator(**Silverbox.physics), Oscillator(m, d, k, effects=(CubicStiffness(k_3=k_3),))
        for name, before, after in (("multisine_09", 6.7, 1.0), ("arrow", 13.9, 2.0)):
            found = [1e3 * error(r[name], x, 1200, 1200) for x in (base, spring)]
            assert found[0] == pytest.approx(before, rel=0.15) and found[1] < after, (name, found)


class TestCrazypad:
    pytestmark = data

    def test_what_was_read(self):
        r = recordings(Crazypad)
        assert len(r) == 20 and {n.partition("_")[0] for n in r} == {"E8", "E9"}
        for x in r.values():
            height, force = columns(x, "position.z", "specific_force.z")[:, x.valid]
            assert x.rate == 100 and height.min() > 0.25 and 13 < x.valid.sum() / 100 < 15.5
            assert force.mean() == pytest.approx(9.7, abs=0.2)
            assert 20_000 < x.inputs[x.valid].mean() < 50_000
        assert set(counts(Crazypad, "gap")) == set(r), "every log has a pause between its two hops"
        assert all(600 < c < 750 for c in counts(Crazypad, "gap").values())
        few = Crazypad(vehicle="E9", weight="W3_near_M3").load()
        assert few.names == ["E9_W3_near_M3_01", "E9_W3_near_M3_02", "E9_W3_near_M3_05"]

    def test_motor_commands_turn_the_body(self):
        """More thrust on the left rolls, at the rear pitches, of motors 2 and 4 yaws to the positive side."""
        r = recordings(Crazypad)["E9_normal_00"]
        torque = (r.inputs - r.inputs.mean(1, keepdims=True)) @ np.array(
            [[-1, -1, -1], [-1, 1, 1], [1, 1, -1], [1, -1, 1.0]]
        )
        for i, axis in enumerate("pqr"):
            turning = np.gradient(columns(r, f"body_rates.{axis}")[0])
            best = max(np.corrcoef(np.roll(torque[:, i], k)[r.valid], turning[r.valid])[0, 1] for k in range(5))
            assert best > (0.2 if axis == "r" else 0.4), axis

    def test_the_weight_pulls_towards_motor_3(self):
        """Vehicle E9: to hover, the motors hold a torque that points where the weight is, 135° from forward."""

        def arm(weight):
            flights = [x for n, x in recordings(Crazypad).items() if n.startswith(f"E9_{weight}")]
            mean = np.mean([x.inputs[x.valid].mean(axis=0) for x in flights], axis=0)
            return np.array([[1, -1, -1, 1], [-1, -1, 1, 1]]) @ mean / mean.sum()  # share forward, share left

        shifts = [arm(weight) - arm("normal") for weight in ("W1_near_M3", "W3_near_M3")]
        angles = [np.degrees(np.arctan2(y, x)) for x, y in shifts]
        assert 110 < angles[0] < 140 and 125 < angles[1] < 140
        assert np.hypot(*shifts[1]) > 2 * np.hypot(*shifts[0])


def usd_log(version=2, rows=3):
    body = b"\xbc" + version.to_bytes(2, "little") + (2).to_bytes(2, "little")
    body += (7).to_bytes(2, "little") + b"other\0" + (1).to_bytes(2, "little") + b"mode(B)\0"
    body += (65535).to_bytes(2, "little") + b"fixedFrequency\0" + (2).to_bytes(2, "little") + b"a.x(f)\0a.n(h)\0"
    for k in range(rows):
        body += (65535).to_bytes(2, "little") + (10_000 * k).to_bytes(8, "little")
        body += np.float32(k / 2).tobytes() + np.int16(-k).tobytes()
        body += (7).to_bytes(2, "little") + (10_000 * k + 5).to_bytes(8, "little") + b"\x01"
    return body + zlib.crc32(body).to_bytes(4, "little")


def test_crazyflie_log_is_read_event_by_event(tmp_path):
    (file := tmp_path / "log00").write_bytes(usd_log())
    t, variables = read_usd_log(file)
    assert t.tolist() == pytest.approx([0, 0.01, 0.02])
    assert variables["a.x"].tolist() == [0, 0.5, 1] and variables["a.n"].tolist() == [0, -1, -2]


def test_a_broken_crazyflie_log_is_refused(tmp_path):
    file, whole = tmp_path / "log00", usd_log()
    for content, message in (
        (whole[:-9] + whole[-8:], "checksum"),
        (b"text, no log", "0xBC"),
        (usd_log(version=3), "version 3"),
        (usd_log(rows=0), "no fixedFrequency"),
        (whole[:60] + zlib.crc32(whole[:60]).to_bytes(4, "little"), "damaged"),
    ):
        file.write_bytes(content)
        with pytest.raises(BenchError, match=message):
            read_usd_log(file)


@pytest.mark.data
@pytest.mark.skipif(not os.path.isdir(os.environ.get("BENCH_DATA", "")), reason="BENCH_DATA names no folder")
def test_official_parts_are_the_raw_samples(bench_data):
    """As the package nonlinear_benchmarks cuts them: V1 and V2 of rows 100 .., position and voltage as stored."""
    table = np.loadtxt(bench_data / "silverbox/SNLS80mV.csv", delimiter=",", skiprows=1, usecols=(0, 1))
    parts = {r.name: r for r in Silverbox(official=True).load().recordings}
    starts = {"multisine": (40_650, 65_062), "multisine_test": (105_712, 21_688), "arrow": (100, 40_475)}
    for name, (start, length) in {**starts, "arrow_no_extrapolation": (100, 32_000)}.items():
        assert parts[name].valid.all() and parts[name].rate == pytest.approx(610.35, abs=0.01)
        both = np.concatenate([parts[name].inputs, parts[name].outputs], 1)
        np.testing.assert_array_equal(both, table[start : start + length])
    for recording in Emps(official=True).load().recordings:
        stored = scipy.io.loadmat(bench_data / f"emps/{recording.name}.mat")
        np.testing.assert_array_equal(recording.outputs, stored["qm"])
        np.testing.assert_array_equal(recording.inputs, stored["vir"])
        assert recording.valid.all() and [c.name for c in recording.output_channels] == ["displacement.q"]


def test_absent_files_say_where_they_can_be_had(tmp_path, monkeypatch):
    monkeypatch.setenv("BENCH_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for entry in ENTRIES:
        with pytest.raises(BenchError, match=r"download them from https://github\.com/.* SHA-256 [0-9a-f]{64}"):
            entry().load()
