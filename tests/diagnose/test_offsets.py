"""What offsets of a recording's own explain of its errors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_accelerometer import MODEL, RATE, subject

from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import LogBatch
from bench.diagnose.simulate.offsets import ANGLE, attitude_offsets, less_offsets


def test_a_turned_attitude_turns_the_thrust_and_not_the_weight() -> None:
    who = subject()
    found = attitude_offsets(MODEL, LogBatch.of(who.logs), noise_of(who))
    log = who.logs[0]
    thrust = 1.5e-6 * (log.inputs[:, :4].numpy() ** 2).sum(1) / 0.5
    attitude = Rotation.from_quat(log.states[:, 6:10].numpy())
    for turned, moved in zip(found, ([0, -1, 0], [1, 0, 0], [0, 0, 0]), strict=True):  # axis × body z
        lacks = -ANGLE * thrust[:, None] * attitude.apply(moved)
        steps = (lacks[1:] + lacks[:-1]) / 2 / RATE
        seen = turned.steps[0, :, 3:6]
        assert turned.valid[0].sum() > 1000
        assert seen[turned.valid[0]] == pytest.approx(steps[turned.valid[0]], abs=2e-3 * ANGLE * thrust.max() / RATE)


def test_offsets_of_each_recording_explain_constants_and_turned_attitudes_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    turned, recording = rng.normal(size=(200, 3)), np.repeat([0, 1], 100)
    motion = rng.normal(size=(200, 3))
    amount = np.array([0.7, -2.0])[recording][:, None]
    errors = np.array([1.0, -3.0, 2.0]) * amount + amount * turned
    assert less_offsets(errors, [turned], recording) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert min(less_offsets(errors, [], recording)) > 0.5  # a constant alone is not all
    alone = less_offsets(motion, [turned], recording)
    both = less_offsets(errors + motion, [turned], recording)
    assert both == pytest.approx(alone) and min(alone) > 1.5
