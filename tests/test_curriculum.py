"""The length of training windows over the updates."""

from dataclasses import replace

import pytest
import torch
from conftest import Toy

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.training.data import prepare
from bench.training.model import build_scaled
from bench.training.train import Group, RunState, horizon_at


def test_lengths_grow_by_equal_factors_and_then_are_whole() -> None:
    options = Training(updates=100, first_horizon=20, stages=3, grown_at=0.6)
    lengths = [horizon_at(options, u, 190) for u in range(100)]
    assert sorted(set(lengths)) == [20, 42, 90, 190]
    assert [lengths.count(x) for x in (20, 42, 90, 190)] == [20, 20, 20, 40]
    assert lengths == sorted(lengths)


@pytest.mark.parametrize("first", [0, 190, 400])
def test_windows_are_whole_unless_asked(first: int) -> None:
    assert {horizon_at(Training(updates=9, first_horizon=first), u, 190) for u in range(9)} == {190}


def test_an_update_on_short_windows_is_one_at_that_horizon() -> None:
    """The first ten of 25 steps, from the same starts, give the same weights; the loss of the rest is not looked at."""
    config = RunConfig(*parse("LSTM: 1x8 - MLP: 9x10"), Toy(), horizon=25, training=Training(updates=4, batch=32))
    short = replace(config, training=replace(config.training, first_horizon=10, stages=1, grown_at=1.0))
    data = prepare(config)
    groups = [Group([build_scaled(c, data)], [RunState(c, data)]) for c in (config, short)]
    batch = groups[0]._batch
    groups[0]._batch = lambda: tuple(x[..., :10, :] if i > 1 else x for i, x in enumerate(batch()))  # type: ignore[method-assign]
    for _ in range(3):
        for group in groups:
            group.step()
    assert torch.equal(groups[0].theta, groups[1].theta)
