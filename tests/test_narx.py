"""NARX against a plain-numpy transcription of its equation."""

import numpy as np
import oracle
import pytest
import torch
from networks import close, noise, vivid, weights

from bench.experiment.notation import parse, write
from registry import PREDICTORS
from registry.contracts import Predictor, Problem
from registry.errors import BenchError

SHAPES = [(1, 3, 3, 2), (2, 3, 1, 2), (2, 3, 4, 1), (1, 0, 3, 1)]


def built(
    layers: int = 2, m: int = 3, delays: int = 3, n: int = 2, hidden: int = 4, mode: str = "parallel"
) -> Predictor:
    entry = PREDICTORS.get("NARX")(layers=layers, hidden=hidden, delays=delays, mode=mode)
    return vivid(entry.build(Problem.plain(m, n, 12, 5)))


def narx(w: oracle.Weights, delays: int, past_u, past_y, u, y=None):
    """One window: histories (τ, m), (τ, n), inputs (T, m), measured outputs (T, n) or None → outputs (T, n).

    Inputs and outputs are whole sequences, indexed as in the paper's equation; a history that is too short repeats
    its first sample.
    """
    start = max(delays, len(past_u))
    us = [past_u[0]] * (start - len(past_u)) + [*past_u, *u]
    ys = [past_y[0]] * (start - len(past_y)) + [*past_y]
    predicted = []
    for k in range(start, start + len(u)):
        x = np.concatenate([us[k - i] for i in range(delays)] + [ys[k - i] for i in range(1, delays + 1)])
        for layer in range(sum(name.startswith("weight.") for name in w)):
            x = np.tanh(w[f"weight.{layer}"] @ x + w[f"bias.{layer}"])
        predicted.append(w["output_weight"] @ x + w["output_bias"])
        ys.append(predicted[-1] if y is None else y[k - start])
    return np.array(predicted)


@pytest.mark.parametrize(("layers", "m", "delays", "n"), SHAPES)
@pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])
@pytest.mark.parametrize("tau", [2, 5])
def test_runs_follow_the_equation(layers: int, m: int, delays: int, n: int, measured: bool, tau: int) -> None:
    predictor = built(layers, m, delays, n)
    past_u, past_y, u, y = (
        noise(3, tau, m, seed=1),
        noise(3, tau, n, seed=2),
        noise(3, 9, m, seed=3),
        noise(3, 9, n, seed=4),
    )
    feedback, state = y if measured else None, predictor.init_buffers(past_u, past_y)
    assert state.shape[-1] == predictor.layout.size
    windows = zip(past_u.numpy(), past_y.numpy(), u.numpy(), y.numpy(), strict=True)
    want = np.array([narx(weights(predictor), delays, *w[:3], w[3] if measured else None) for w in windows])
    outputs, end = predictor.rollout(u, state, feedback)
    close(outputs, want)
    sequence = torch.cat([past_y, y if measured else torch.from_numpy(want)], 1)
    close(end, predictor.init_buffers(torch.cat([past_u, u], 1)[:, -delays:], sequence[:, -delays:]))


def test_series_parallel_training_looks_at_one_step_predictions() -> None:
    """Every step from measured data alone, each as the first step of a run of its own; parallel training runs free."""
    u, y = noise(2, 14, 3, seed=1), noise(2, 14, 2, seed=2)
    predictor = built(mode="series-parallel")
    taught = predictor.training_rollout(u[:, 5:], y[:, 5:], predictor.init_buffers(u[:, :5], y[:, :5]))
    for k in range(5, 14):
        state = predictor.init_buffers(u[:, :k], y[:, :k])
        close(taught[:, k - 5], predictor.rollout(u[:, k : k + 1], state)[0][:, 0].detach())
    free, state = built(), predictor.init_buffers(u[:, :5], y[:, :5])
    assert torch.equal(free.training_rollout(u[:, 5:], y[:, 5:], state), free.rollout(u[:, 5:], state)[0])
    assert not torch.allclose(free.training_rollout(u[:, 5:], y[:, 5:], state), taught)


@pytest.mark.parametrize("spec", ["NARX: 2x30", "TCN: 2x30"])
def test_notation_has_a_size_and_no_initializer(spec: str) -> None:
    predictor, initializer = parse(spec)
    assert (predictor.layers, predictor.hidden, initializer) == (2, 30, None)
    assert write(predictor, None) == spec
    with pytest.raises(BenchError, match="no states to initialize"):
        parse(f"{spec} - Washout: 10")


def test_weight_count() -> None:
    predictor = PREDICTORS.get("NARX")(layers=2, hidden=50).build(Problem.plain(4, 3, 40, 10))
    assert predictor.weight_count() == 50 * 10 * (4 + 3) + 50 + 50 * 50 + 50 + 3 * 50 + 3
