"""The weak form on a smoothed signal in closed form: the model's side must be smoothed as the data were."""

from types import SimpleNamespace

import numpy as np
import torch
from scipy.signal import savgol_filter

from bench.diagnose.logs.smoothing import Smoothing
from bench.diagnose.logs.subject import Log
from bench.diagnose.regression import weak

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
        tests = weak.TestFunctions.over([log], 6, [smoothing])
        integral = tests.integral(0, rate[None, :, None], DT)[0]
        left[smoothing.kind] = np.abs(tests.increment(0, measured) - integral)[2:-2].max()
        reach = len(smoothing.kernel()) // 2 + 6
        assert (np.abs(tests.centres[0] - 300) >= reach).all()
    assert left["savgol"] < 0.02 * left["none"]
