"""The published recordings themselves."""

import os
from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from registry.datasets.nanobench import Nanobench
from registry.datasets.nanodrone import Nanodrone
from registry.datasets.reading.cleaning import delay
from registry.datasets.reading.inspect import inspect
from registry.datasets.reading.rotations import euler_from_quaternion
from registry.datasets.tailsitter import Tailsitter

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not os.path.isdir(os.environ.get("BENCH_DATA", "")), reason="BENCH_DATA names no folder"),
]


@cache
def loaded(entry):
    return entry().load()


def findings(entry, recording, kind):
    return [f for f in loaded(entry).findings if (f.recording, f.kind) == (recording, kind)]


def constant_row(signal, horizon=50):
    """Mean Euclidean error (horizon,) of the baseline that holds the last value, over every valid melon window."""
    errors = []
    for r in loaded(Nanodrone).recordings:
        if r.name.startswith("melon"):
            y = r.pick([signal])[0]
            starts = [k for k in range(len(r) - horizon) if r.valid[k : k + horizon + 1].all()]
            errors.append([np.linalg.norm(y[np.array(starts) + h] - y[starts], axis=1) for h in range(1, horizon + 1)])
    return np.concatenate(errors, axis=1).mean(axis=1)


@pytest.mark.parametrize(
    ("signal", "published"),
    # The published smoothing is unknown: one step of body rates depends on it, so 10 % is allowed there.
    [("velocity", (0.0329, 0.3182, 1.4749, 38.92)), ("body_rates", (0.0796, 0.3596, 0.8837, 29.09))],
)
def test_the_published_constant_row_is_reproduced(signal, published):
    row = constant_row(signal)
    found = (row[0], row[9], row[49], row.sum())
    assert found[0] == pytest.approx(published[0], rel=0.05 if signal == "velocity" else 0.1)
    assert found[1:] == pytest.approx(published[1:], rel=0.05)


def test_nanodrone_faults_are_found():
    (jump,) = findings(Nanodrone, "melon_20251017_run2", "spike")
    assert "0.3 m" in jump.detail
    melon = next(r for r in loaded(Nanodrone).recordings if r.name == "melon_20251017_run2")
    assert np.abs(np.diff(melon.pick(["position"])[0], axis=0)).max() < 0.15
    for name, seconds in (("square_20251017_run1", "3.90 s"), ("square_20251017_run2", "9.28 s")):
        (pause,) = findings(Nanodrone, name, "pause")
        assert seconds in pause.detail
    lags = {f.recording: f.count for f in loaded(Nanodrone).findings if f.kind == "lag"}
    assert len(lags) == 21
    assert lags["melon_20251017_run2"] == pytest.approx(-1.8, abs=0.3)
    assert lags["square_20251017_run1"] == pytest.approx(3.2, abs=0.3)


def test_nanodrone_lag_is_gone_and_speeds_are_possible():
    """The check does not use the estimator: torque and thrust must explain the motion better once aligned."""
    left = {r.name: r for r in Nanodrone(align_lag=False).load().recordings}
    for r in loaded(Nanodrone).recordings:
        assert r.inputs[r.valid].max() < 3000 and r.inputs[r.valid].min() > 300
    name = "square_20251017_run2"
    aligned = next(r for r in loaded(Nanodrone).recordings if r.name == name)

    def fit(r):
        turning = np.gradient(r.pick(["body_rates"])[0][:, :2], axis=0)
        ok = r.valid & np.roll(r.valid, 1) & np.roll(r.valid, -1)
        a = np.column_stack([r.inputs**2, np.ones(len(r))])[ok]
        residual = turning[ok] - a @ np.linalg.lstsq(a, turning[ok], rcond=None)[0]
        return (residual**2).sum() / (turning[ok] ** 2).sum()

    assert fit(aligned) < 0.8 * fit(left[name])


def moved(before, after):
    """By how many samples the rotor speeds of ``after`` come later, found by shifting those of ``before``."""
    position = after.pick(["position"])[0]
    start = next(k for k in range(-20, 21) if same(before.pick(["position"])[0], position, k))
    x, t = before.inputs[:, 0], np.arange(len(after))
    middle = slice(200, 1200)
    shifts = np.arange(-4, 4, 0.02)
    error = [np.abs(np.interp(t + start - s, np.arange(len(x)), x) - after.inputs[:, 0])[middle].mean() for s in shifts]
    return shifts[np.argmin(error)]


def same(a, b, shift):
    """Whether sample k of ``b`` is sample k + shift of ``a``."""
    return np.allclose(a[500 + shift : 600 + shift], b[500:600])


def test_one_lag_for_all_flights_shifts_the_rotor_speeds_by_the_median_of_those_that_do_not_test():
    read = [Nanodrone(**o).load() for o in ({}, {"align_lag": False}, {"common_lag": True})]
    own, left, common = ({r.name: r for r in x.recordings} for x in read)
    lags = {f.recording: f.count for f in loaded(Nanodrone).findings if f.kind == "lag"}
    median = np.median([lag for name, lag in lags.items() if not name.startswith("melon")])
    for name in ("melon_20251017_run2", "square_20251017_run1"):
        assert abs(lags[name] - median) > 0.5  # far enough from it to tell the two apart
        assert moved(left[name], common[name]) == pytest.approx(median, abs=0.1)
        assert moved(left[name], own[name]) == pytest.approx(lags[name], abs=0.1)
    said = [f.detail for f in read[2].findings if f.kind == "lag"]
    assert all(detail.endswith(f", {median:+.2f} removed, as of every flight") for detail in said)


def test_nanobench_duplicates_ground_and_short_files():
    (duplicate,) = findings(Nanobench, "B9_trefoil_fast_rep6", "duplicate")
    assert "B9_trefoil_fast_rep11" in duplicate.detail
    assert findings(Nanobench, "B7_oval_slow_rep1", "short")
    for r in loaded(Nanobench).recordings:
        height, force = r.pick(["position.z"])[0], r.pick(["specific_force.z"])[0]
        assert height[r.valid].min() > 0.15
        assert force.mean() == pytest.approx(9.8, abs=0.3)  # SI, and hovering on the mean


def test_the_gyroscope_of_nanobench_follows_the_motors_where_differences_of_poses_hardly_do():
    """A line through roll and pitch accelerations over what the motors did 40 ms before, between 1.5 and 6.5 Hz."""
    turning = np.array([[-1, -1, 1, 1], [-1, 1, 1, -1]]).T
    band = butter(3, [1.5, 6.5], "band", fs=100, output="sos")

    def explained(dataset):
        pairs = []
        for r in dataset.load().recordings:
            rates, pwm = (sosfiltfilt(band, r.pick([name])[0], axis=0) for name in ("body_rates", "pwm"))
            pairs.append(((pwm @ turning)[100:-104], np.gradient(rates[:, :2], axis=0)[104:-100]))
        x, y = (np.concatenate(side) for side in zip(*pairs, strict=True))
        return 1 - (y - x * (x * y).sum(0) / (x * x).sum(0)).var(0) / y.var(0)

    assert (explained(Nanobench(gyroscope=True)) > 0.7).all()
    assert (explained(Nanobench()) < 0.5).all()


@pytest.mark.parametrize("flight", ["B10_lissajous_slow_rep1", "B2_circle_medium_rep2"])
def test_the_gyroscope_of_nanobench_is_put_on_the_clock_of_the_motion_capture(flight):
    """What was late by more than a sample turns with the attitude, as far as whole samples can tell."""
    read = Nanobench(gyroscope=True).load()
    (late,) = (f.count for f in read.findings if (f.recording, f.kind) == (flight, "lag"))
    (recording,) = (r for r in read.recordings if r.name == flight)
    attitude, rates = (recording.pick([name])[0] for name in ("attitude", "body_rates"))
    turned = Rotation.from_quat(attitude)
    steps = 100 * (turned[:-1].inv() * turned[1:]).as_rotvec()
    left, _ = delay(steps, (rates[1:] + rates[:-1]) / 2)
    assert abs(late) > 1 and abs(left) < 0.75


def test_tailsitter_body_rates_are_body_rates():
    r = next(r for r in loaded(Tailsitter).recordings if r.name == "manual_altitude_3")
    q = r.pick(["attitude"])[0]
    turn = 2 * 100 * np.diff(q, axis=0)  # dq/dt = q * (0, w) / 2
    x, y, z, w = ((q[1:] + q[:-1]) / 2).T
    body = np.column_stack(
        [
            w * turn[:, 0] - x * turn[:, 3] - y * turn[:, 2] + z * turn[:, 1],
            w * turn[:, 1] - y * turn[:, 3] - z * turn[:, 0] + x * turn[:, 2],
            w * turn[:, 2] - z * turn[:, 3] - x * turn[:, 1] + y * turn[:, 0],
        ]
    )
    error = {s: np.abs(body - r.pick([s])[0][1:]).mean() for s in ("body_rates", "euler_rates")}
    assert error["body_rates"] < 0.8 * error["euler_rates"]
    assert np.abs(euler_from_quaternion(q)).max() < 0.7


@pytest.mark.parametrize("entry", [Nanodrone, Nanobench, Tailsitter])
def test_splits_use_every_recording_once(entry):
    names = loaded(entry).names
    split = entry().split(names)
    assert sorted((*split.train, *split.validation, *split.test)) == sorted(names)
    assert split.train and split.validation and split.test


def test_inspect_lists_what_was_read_and_left_out():
    rows, found = inspect(Nanobench())
    rows = {row["name"]: row for row in rows}
    assert len(rows) == 38 and found
    assert rows["B7_oval_slow_rep1"]["samples"] == 0 and rows["B9_trefoil_fast_rep6"]["duplicate"]
    low, high, unit = rows["B2_circle_fast_rep1"]["ranges"]["body_rates.q"]
    assert unit == "deg/s" and -300 < low < 0 < high < 300
