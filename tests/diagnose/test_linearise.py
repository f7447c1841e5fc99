"""A model linearised on measured states, and what taking one of its effects away does."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from bench.diagnose.logs.subject import Log
from bench.diagnose.regression.linearise import directions
from bench.diagnose.regression.weak import Stack, mean_rates
from registry.core import EFFECTS
from registry.physics.quadrotor import Quadrotor


def test_what_needs_an_effect_goes_with_it() -> None:
    rng, samples = np.random.default_rng(0), 200
    wander = np.cumsum(rng.normal(0, 0.02, (samples, 9)), axis=0)
    turned = Rotation.from_rotvec(wander[:, :3]).as_quat()
    states = np.column_stack([wander[:, :3], wander[:, 3:6], turned, wander[:, 6:]])
    inputs = np.full((samples, 4), 496.0) + rng.normal(0, 5, (samples, 4))
    drag, wind = EFFECTS.get("rotor_drag")(k_d=1e-4), EFFECTS.get("wind")(w_x=2.0, w_y=-1.0)
    model = Quadrotor(effects=(drag, wind))
    x, u, valid = torch.from_numpy(states), torch.from_numpy(inputs), torch.ones(samples, dtype=torch.bool)
    stack = Stack.of([Log("flight", 100.0, x, (True,) * 13, u, valid, None)])  # type: ignore[arg-type]
    linear = directions(model, model, {}, stack)
    assert linear.away([1]) == ({1}, [linear.removals[1]])
    assert linear.away([0]) == linear.away([0, 1]) == ({0, 1}, [linear.removals[0]])
    for place, left in ((0, ()), (1, (drag,))):
        expected = mean_rates(replace(model, effects=left), stack).numpy()[..., list(linear.channels)]
        assert linear.rates + linear.columns[linear.removals[place]] == pytest.approx(expected, abs=1e-12)
    both = Quadrotor(effects=(drag, wind, EFFECTS.get("linear_drag").typical()))
    assert directions(both, both, {}, stack).away([0])[0] == {0}  # the other drag still carries the wind
