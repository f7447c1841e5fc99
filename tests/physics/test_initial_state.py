"""Unmeasured states at the start, found again from what a model with known ones did; against closed forms."""

import numpy as np
import pytest
import torch

from registry.contracts import Channel, Problem
from registry.core import PREDICTORS
from registry.dynamics.initial_state import estimate_initial_state
from registry.physics.mass_on_rail import MassOnRail
from registry.physics.oscillator import Oscillator
from registry.physics.tanks import Tanks


@pytest.mark.parametrize("speed", [-3.0, 0.2, 1.5])
def test_the_speed_of_a_free_mass_is_its_slope(speed: float) -> None:
    """q = q_0 + v t without a force."""
    t = torch.arange(8, dtype=torch.float64) * 0.01
    measured = torch.stack([0.5 + speed * t, torch.zeros(8, dtype=torch.float64)], -1)[None]
    found = estimate_initial_state(MassOnRail(), measured[:, 0], [1], torch.zeros(1, 8, 1).double(), measured, 0.01)
    assert found.item() == pytest.approx(speed, rel=1e-6)


def test_each_window_by_itself_and_in_single_precision() -> None:
    model, dt = Oscillator(mass=1.0, damping=0.5, stiffness=100.0), 0.02
    true = torch.tensor([[0.1, -2.0], [0.0, 0.7], [-0.3, 0.0]], dtype=torch.float64)
    inputs = torch.randn(3, 12, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    states = model.simulate(true, inputs, dt).float()
    found = estimate_initial_state(model, states[:, 0], [1], inputs.float(), states, dt)
    assert found.dtype == torch.float32
    np.testing.assert_allclose(found[:, 0].numpy(), true[:, 1].numpy(), atol=1e-4)


@pytest.mark.parametrize("name", ["physics", "Hybrid residual"])
def test_a_simulation_starts_from_the_level_that_nobody_measured(name: str) -> None:
    """Of two tanks five samples of the lower level tell the upper one; an untrained hybrid is the physics model."""
    true = torch.tensor([[7.0, 4.0]], dtype=torch.float64)
    u = 2 + torch.rand(1, 60, 1, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    level = Tanks(input_hold="previous").simulate(true, u, 4.0)[..., 1:]
    nominal = {p.name: p.value for p in Tanks().parameters()}
    channels = (Channel("voltage", "V"),), (Channel("level.h", "V"),)
    problem = Problem(*channels, 55, 5, rate=0.25, system="tanks", physics=nominal, input_hold="previous")
    errors = {}
    for start in ("zero", "sought"):
        predictor = PREDICTORS.get(name)(start=start).build(problem).double()
        state = predictor.init_buffers(u[:, :5], level[:, :5])
        state = torch.nn.functional.pad(state, (0, predictor.layout.size - state.shape[-1]))  # networks at rest
        predicted = predictor(u[:, 5:], state)
        errors[start] = (predicted - level[:, 5:]).abs().max().item()
    assert errors["sought"] < 1e-3 < 0.5 < errors["zero"]
