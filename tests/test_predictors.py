"""Every registered network that is trained by gradient, by its contract: a new one is tested once it is registered.

Each on unnamed signals; what chooses its signals (`PredictorEntry.signals`) has tests of its own.
"""

from dataclasses import fields

import pytest
import torch
from networks import Called, Trained, check_group, check_pieces, check_slopes, noise, vivid
from torch import Tensor

from registry import INITIALIZERS, PREDICTORS
from registry.contracts import Predictor, PredictorEntry, Problem

TAU, M, N = 5, 2, 1
"""Samples of history; inputs and outputs."""


def networks(**only: object) -> list[object]:
    """Name and options of each, in every mode of training; ``only`` those entries with these attributes."""
    found = []
    for name in PREDICTORS.names():
        entry = PREDICTORS.get(name)
        plain = entry.training == "gradient" and entry.signals is PredictorEntry.signals
        if plain and all(getattr(entry, k) == v for k, v in only.items()):
            modes = [{"mode": m} for f in fields(entry) if f.name == "mode" for m in f.metadata["choices"]] or [{}]
            found += [pytest.param(name, mode, id="-".join([name.replace(" ", ""), *mode.values()])) for mode in modes]
    return found


every = pytest.mark.parametrize(("name", "options"), networks())
run = pytest.mark.parametrize("measured", [False, True], ids=["own", "measured"])


def built(name: str, hidden: int, horizon: int = 12, **options: object) -> Predictor:
    """Of two layers where it has layers."""
    entry, size = PREDICTORS.get(name), {"layers": 2, "hidden": hidden}
    options |= {f.name: size[f.name] for f in fields(entry) if f.name in size}
    return entry(**options).build(Problem.plain(M, N, horizon, TAU))


def drawn(predictor: Predictor, steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs, a state and measured outputs of three windows."""
    state = 0.3 * noise(3, predictor.layout.size, seed=4)
    return noise(3, steps, M, seed=3), state, noise(3, steps, N, seed=5)


@every
@run
def test_a_horizon_in_two_pieces_is_the_horizon(name: str, options: dict[str, str], measured: bool) -> None:
    predictor = vivid(built(name, 4, **options), 0.4)
    u, state, y = drawn(predictor, 12)
    check_pieces(predictor, u, state, y if measured else None)


@every
def test_an_input_acts_on_its_own_window_and_not_before(name: str, options: dict[str, str]) -> None:
    predictor = vivid(built(name, 4, **options), 0.4)
    u, state, _ = drawn(predictor, 12)
    before, _ = predictor.rollout(u, state)
    for value in (1.0, torch.nan):
        pushed = u.clone()
        pushed[1, 5] = value
        after, end = predictor.rollout(pushed, state)
        assert torch.equal(after[[0, 2]], before[[0, 2]]) and torch.equal(after[1, :5], before[1, :5])
        assert not torch.equal(after[1, 5:7], before[1, 5:7])
        assert end[1].isfinite().all() == (value == 1.0)


@every
@run
def test_gradient_is_the_finite_difference(name: str, options: dict[str, str], measured: bool) -> None:
    predictor = vivid(built(name, 2, 4, **options), 0.4)
    u, state, y = drawn(predictor, 4)
    data = u.requires_grad_(), state.requires_grad_()
    check_slopes(Called(predictor, predictor.rollout), *data, y if measured else None)
    check_slopes(Called(predictor, lambda u, state: (predictor.training_rollout(u, y, state),)), *data)


@pytest.mark.parametrize(("name", "options"), networks(supports_batching=True))
@pytest.mark.parametrize("batch", [64, 7])
def test_training_in_a_group_changes_no_bit(name: str, options: dict[str, str], batch: int) -> None:
    """Outputs, cost and gradients of three stacked models are those of three stacks of one."""
    models = []
    for seed in range(3):
        torch.manual_seed(seed)
        predictor, how = built(name, 50, 40, **options), None
        if PREDICTORS.get(name).stateful:
            how = INITIALIZERS.get("MLP")(history=TAU, hidden=20).build(predictor, predictor.problem)
        models.append(Trained(predictor, how))
    check_group(models, [(TAU, M), (TAU, N), (40, M), (40, N)], batch, 1e-6)
