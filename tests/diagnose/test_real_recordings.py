"""Real flights whose missing physics is known."""

import numpy as np
import pytest

from bench.diagnose import extend, load
from registry.datasets.crazypad import Crazypad


@pytest.mark.data
@pytest.mark.slow
def test_a_weight_at_motor_3_moves_the_centre_of_gravity_there(bench_data):
    """CrazyPAD, vehicle E9: direction 135° from forward, further for the heavier weight; against flights without."""

    def offset(weight):
        subject = load(Crazypad(vehicle="E9", weight=weight))
        added = extend(subject, subject.model, ["input_delay", "cog_offset"])
        rates = [stage.error["body_rates"] for stage in added.stages]
        assert rates[3] < 0.4 * min(rates[:3])  # nominal, calibrated and + delay, on a flight that was not fitted
        return np.array([added.effects[1].parameters[axis].value for axis in "xy"])

    light, heavy = (offset(w) - offset("normal") for w in ("W1_near_M3", "W3_near_M3"))
    for shift in (light, heavy):
        assert np.degrees(np.arctan2(shift[1], shift[0])) == pytest.approx(135, abs=15)
    assert 0.01 > np.hypot(*heavy) > 3 * np.hypot(*light) > 0.001
