"""The weak form against closed forms, and its shortcuts against the long way."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.signal import savgol_filter

from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Log
from bench.diagnose.regression import test_functions, weak
from bench.diagnose.regression.recurrence import solved
from registry.effects.suspended_load import SuspendedLoad
from registry.physics.quadrotor import Quadrotor

DT = 0.01
T = np.arange(600) * DT


def test_the_model_is_smoothed_as_the_data_were_and_no_window_touches_an_invalid_sample():
    speed, rate = np.sin(25 * T), 25 * np.cos(25 * (T[:-1] + DT / 2))
    measured = savgol_filter(speed, 21, 2)[:, None]
    valid = torch.ones(len(T), dtype=torch.bool)
    valid[300] = False
    nothing = torch.zeros(len(T), 0, dtype=torch.float64)
    # Test functions look at the length and the mask of a log only.
    log = Log("wave", 1 / DT, torch.from_numpy(measured), (True,), nothing, valid, SimpleNamespace())
    left = {}
    for smoothing in (Smoothing("savgol", 21, 2), Smoothing()):
        tests = test_functions.TestFunctions.over([log], 6, [smoothing])
        integral = tests.integral(0, 0, rate[:, None], DT)
        left[smoothing.kind] = np.abs(tests.increment(0, measured) - integral)[2:-2].max()
        reach = len(smoothing.kernel()) // 2 + 6
        assert (np.abs(tests.centres[0] - 300) >= reach).all()
    assert left["savgol"] < 0.02 * left["none"]


@pytest.mark.parametrize("length", [0.7, torch.tensor([0.25, 2.2], dtype=torch.float64).reshape(2, 1, 1)])
def test_a_swinging_load_that_is_solved_at_once_takes_the_path_of_one_step_after_another(length, monkeypatch):
    flight = torch.from_numpy(np.cumsum(np.random.default_rng(3).normal(size=(2, 403, 13)), axis=1) * 1e-2)
    flight[..., 9] += 1.0
    speeds = 900 + 30 * torch.sin(torch.arange(403.0, dtype=torch.float64)).reshape(1, -1, 1).expand(2, -1, 4)
    model = Quadrotor(effects=(SuspendedLoad(m_l=0.1, l=length, zeta=0.1),))
    stack = weak.LogBatch((), flight, speeds, 0.01)
    at_once = weak.own_states(model, stack)
    monkeypatch.setattr(weak, "solved", lambda *a: None)
    one_by_one = weak.own_states(model, stack)
    assert one_by_one.abs().max() > 0.01
    torch.testing.assert_close(at_once, one_by_one, rtol=1e-11, atol=1e-12)
    assert solved(lambda x: x + 0.01 * (1 - x * x), (3, 50), 1, stack.states) is None  # not affine: never at once
