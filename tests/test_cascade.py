"""Two networks in a row: the second sees predicted rates in a free run and measured ones when forced."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import torch
from conftest import Toy
from torch import Tensor

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.training.run import run_group
from registry.contracts import Channel, Problem, RecordingSet
from registry.core import DATASETS, PREDICTORS
from registry.errors import BenchError
from registry.predictors.cascade import CascadePredictor

RATES = ("roll", "pitch", "yaw")


def channels(group: str, axes: str) -> tuple[Channel, ...]:
    return tuple(Channel(f"{group}.{a}", "1") for a in axes)


@DATASETS.register("toy_flight")
@dataclass(frozen=True)
class ToyFlight(Toy):
    """The toy's rates, and a velocity that follows them."""

    chain: ClassVar[tuple[str, ...]] = ("velocity", "euler_rates")

    def read(self) -> RecordingSet:
        made = []
        for r in super().read().recordings:
            velocity = np.cumsum(r.outputs @ np.array([[0, 1, 0.2], [-1, 0, 0], [0.1, 0, 1]]), 0) / r.rate
            outputs = np.concatenate([r.outputs, velocity], 1)
            made.append(replace(r, outputs=outputs, output_channels=(*r.output_channels, *channels("velocity", "xyz"))))
        return RecordingSet(tuple(made), ())


def built(name: str = "Cascade") -> tuple[CascadePredictor, Tensor, Tensor, tuple[Tensor, Tensor], list[Tensor]]:
    """Predictor, horizon inputs and outputs, history, and states of both networks."""
    torch.manual_seed(0)
    outputs = (*channels("velocity", "xyz"), *channels("body_rates", "pqr"))
    predictor = PREDICTORS.get(name)(layers=1, hidden=5).build(Problem(channels("pilot", "ab"), outputs, 6, 10))
    g = torch.Generator().manual_seed(1)
    u, y = torch.randn(3, 6, 2, generator=g), torch.randn(3, 6, 6, generator=g)
    past = torch.randn(3, 10, 2, generator=g), torch.randn(3, 10, 6, generator=g)
    states = [
        torch.cat([p.init_buffers(*predictor.part_history(i, *past)), torch.randn(3, 10, generator=g)], -1)
        for i, p in enumerate(predictor.parts())
    ]
    return predictor, u, y, past, states


@pytest.mark.parametrize("name", ["Cascade", "Cascade TDL"])
def test_the_networks_run_one_after_the_other(name: str) -> None:
    predictor, u, y, past, states = built(name)
    state = predictor.join(states, *past)
    assert state.shape[-1] == predictor.layout.size
    rates, _ = predictor.first.rollout(u, states[0])
    practical, _ = predictor.second.rollout(torch.cat([u, rates], -1), states[1])
    forced, _ = predictor.second.rollout(torch.cat([u, y[..., 3:]], -1), states[1])
    free, _ = predictor.rollout(u, state)
    torch.testing.assert_close(free, torch.cat([practical, rates], -1))
    torch.testing.assert_close(predictor.training_rollout(u, y, state), torch.cat([forced, rates], -1))
    torch.testing.assert_close(predictor.view("forced", u, y, state), forced)
    assert (practical - forced).abs().max() > 1e-3


def test_a_run_can_be_cut_in_two() -> None:
    predictor, u, _, past, states = built("Cascade TDL")
    state = predictor.join(states, *past)
    whole, end = predictor.rollout(u, state)
    first, middle = predictor.rollout(u[:, :2], state)
    second, last = predictor.rollout(u[:, 2:], middle)
    torch.testing.assert_close(torch.cat([first, second], 1), whole)
    torch.testing.assert_close(last, end)


def test_the_velocity_network_learns_from_measured_rates_only() -> None:
    predictor, u, y, past, states = built()
    velocity = predictor.training_rollout(u, y, predictor.join(states, *past))[..., :3].sum()
    grads = torch.autograd.grad(velocity, list(predictor.first.parameters()))
    assert not any(g.any() for g in grads)


def test_it_predicts_two_signals_of_any_size() -> None:
    with pytest.raises(BenchError, match="cascade predicts two signals"):
        PREDICTORS.get("Cascade")().build(Problem.plain(2, 6, 4, 10))
    position, speeds = (Channel("displacement.q", "m"),), (Channel("speed.1", "m/s"), Channel("speed.2", "m/s"))
    problem = replace(Problem.plain(2, 3, 4, 10), outputs=(*position, *speeds))
    predictor = PREDICTORS.get("Cascade")(hidden=5).build(problem)
    assert (predictor.first.n_outputs, predictor.second.n_outputs, predictor.second.n_inputs) == (2, 1, 4)
    u, state = torch.randn(3, 4, 2), torch.randn(3, sum(predictor.layout.sizes))
    rates, _ = predictor.first.rollout(u, predictor.separate(state)[0])
    seen = torch.cat([u, rates], -1)
    expected = predictor.second.rollout(seen, predictor.separate(state)[1])[0]
    torch.testing.assert_close(predictor.rollout(u, state)[0], torch.cat([expected, rates], -1))
    assert predictor.viewed("forced") == [0]


def test_a_recorded_run_holds_both_modes() -> None:
    pair, training = parse("Cascade: 1x8 - MLP: 8x10"), Training(updates=30, evaluate_every=15)
    (outcome,) = run_group([RunConfig(*pair, ToyFlight(), horizon=12, training=training)])
    names = [
        f"{g}.{a}"
        for g, axes in (("velocity", "xyz"), ("euler_rates", RATES), ("velocity_forced", "xyz"))
        for a in axes
    ]
    assert outcome.summary["outputs"] == names and outcome.summary["predicted"] == 6
    assert {"velocity", "velocity_forced", "euler_rates"} <= set(outcome.tables["steps"].quantity)
    found = outcome.summary["metrics"]
    assert found["rmsse.velocity"] != found["rmsse.velocity_forced"]
