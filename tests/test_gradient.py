"""The networks' own way back in training against autograd's, which must give the same bits."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
import torch
from conftest import Toy
from networks import redrawn
from test_hybrid import QUADROTOR, windows
from test_native import kernel
from torch import Tensor

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.training import gradient
from bench.training.data import prepare
from bench.training.model import Model, build_scaled
from bench.training.train import Group, RunState
from registry.contracts import Gradients, Predictor, Problem
from registry.initializers.each import build as build_initializer
from registry.initializers.mlp import MLPInitializer
from registry.predictors.cascade import CascadePredictor
from registry.predictors.lstm import LSTMPredictor

SPECS = (
    "LSTM: 2x9 - MLP: 9x10",
    "LSTM: 1x8 - RNN: 9x5",
    "LSTM: 2x8 - Washout: 10",
    "LSTM: 1x8 - Washout own: 10",
    "LSTM: 1x8 - Washout: 1",
    "LSTM TDL: 1x8 - MLP: 9x10",
    "LSTM TDL: 2x8 - Washout: 10",
    "LSTM TDL: 2x8 - RNN: 9x10",
    "MLFC: 1x8 - MLP: 9x10",
    "MLFC: 3x8 - RNN: 9x10",
    "MLFC: 2x8 - Washout: 10",
    "MLFC: 2x8 - Washout own: 10",
)


def group(spec: str, models: int = 1, **options: object) -> Group:
    """After a few updates, so that no weight is zero."""
    predictor, initializer = parse(spec)
    training = Training(updates=100, batch=32, learning_rate=1e-2)
    base = RunConfig(replace(predictor, **options), initializer, Toy(), horizon=6, training=training)  # type: ignore[type-var]
    configs = [replace(base, seed=i) for i in range(models)]
    data = prepare(base)
    made = Group([build_scaled(c, data) for c in configs], [RunState(c, data) for c in configs])
    for _ in range(3):
        made.step()
    return made


def both(network: Model, batch: tuple[Tensor, ...]) -> list[tuple[Tensor, Gradients]]:
    """By hand, without a call of autograd, and by autograd."""
    parameters = dict(network.named_parameters())

    def found() -> tuple[Tensor, Gradients]:
        torch.manual_seed(0)  # what dropout lets through
        return gradient.cost_and_gradient(network, parameters, batch, 0.9, 0.3)

    def refused(*_: object, **__: object) -> None:
        raise AssertionError("autograd was called")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch.autograd, "grad", refused)
        by_hand = found()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gradient, "_goes_back", lambda *_: False)
        return [by_hand, found()]


def assert_equal(network: Model, batch: tuple[Tensor, ...]) -> None:
    (cost, by_hand), (expected, automatic) = both(network, batch)
    same = lambda a, b: torch.equal(a.nan_to_num(7), b.nan_to_num(7)) and torch.equal(a.isnan(), b.isnan())  # noqa: E731
    assert by_hand.keys() == automatic.keys()
    assert same(cost, expected)
    assert [n for n in by_hand if not same(by_hand[n], automatic[n])] == []


@pytest.mark.parametrize("models", [1, 3])
@pytest.mark.parametrize("spec", SPECS)
def test_both_ways_give_the_same_bits(spec: str, models: int) -> None:
    with kernel("native"):
        g = group(spec, models)
        assert_equal(g.network, g._batch())


OF_A_BODY = (
    "Hybrid: 2x9 - MLP: 9x10",
    "Hybrid residual: 1x8 - RNN: 9x10",
    "Hybrid unsummed: 1x8 - MLP: 9x10",
    "Cascade: 2x9 - MLP: 9x10",
    "Cascade TDL: 1x8 - RNN: 9x10",
    "Cascade TDL: 1x8 - Washout: 10",
)


def of_a_body(spec: str, **options: object) -> tuple[Model, tuple[Tensor, ...]]:
    """A model as one trains, its weights with a model dimension of one, and windows."""
    entry, initial = parse(spec)
    predictor = replace(entry, **options).build(QUADROTOR)  # type: ignore[type-var]
    assert initial is not None
    predictor.input_scaler.set(torch.full((4,), 480.0), torch.full((4,), 25.0))
    network = Model(predictor, build_initializer(initial, predictor)).float()
    redrawn(network, 0.4)
    for p in network.parameters():
        p.data = p.data.unsqueeze(0)
    u_past, y_past, u = (x.float() for x in windows())
    y = torch.randn(*u.shape[:2], QUADROTOR.n_outputs)
    past = predictor.input_scaler(u_past), predictor.scale_history(y_past)
    return network, tuple(x.unsqueeze(0) for x in (*past, predictor.input_scaler(u), y))


@pytest.mark.parametrize("spec", OF_A_BODY)
def test_two_networks_give_the_same_bits(spec: str) -> None:
    with kernel("native"):
        assert_equal(*of_a_body(spec))


def test_a_hybrid_without_an_output_model_has_no_state_cost() -> None:
    with kernel("native"):
        assert_equal(*of_a_body("Hybrid: 1x8 - MLP: 9x10", output_model="none"))


def test_fitted_constants_are_left_to_autograd() -> None:
    with kernel("native"):
        network, batch = of_a_body("Hybrid: 1x8 - MLP: 9x10", fit_constants=True)
        _, found = gradient.cost_and_gradient(network, dict(network.named_parameters()), batch, 1.0, 1.0)
        assert float(found["predictor.constants"].abs().sum()) > 0


@pytest.mark.parametrize("network", ["LSTM", "MLFC"])
def test_dropout_lets_the_same_through(network: str) -> None:
    with kernel("native"):
        g = group(f"{network}: 2x9 - MLP: 9x10", dropout=0.3)
        assert_equal(g.network, g._batch())


def test_what_is_not_finite_comes_out() -> None:
    with kernel("native"):
        g = group("LSTM: 2x9 - MLP: 9x10")
        batch = g._batch()
        batch[0][0, 3, 2, 1] = torch.nan
        assert_equal(g.network, batch)
        assert both(g.network, batch)[0][0].isnan().all()


def test_a_state_that_reads_as_measured_has_no_slope_of_its_own() -> None:
    """Where the distance is zero its direction is not defined."""
    with kernel("native"):
        g = group("LSTM: 2x9 - MLP: 9x10")
        batch = g._batch()
        with torch.no_grad():
            g.parameters["predictor.output_weight"].zero_(), g.parameters["predictor.output_bias"].zero_()
        batch[1][:, :5, -1] = 0
        assert_equal(g.network, batch)
        assert all(slope.isfinite().all() for slope in both(g.network, batch)[0][1].values())


@pytest.mark.parametrize("ends", ["outputs", "state", "both"])
@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("spec", ["LSTM: 2x9", "LSTM TDL: 2x8", "MLFC: 3x8", "Hybrid: 2x9"])
def test_a_run_goes_back_from_its_outputs_and_from_its_end(spec: str, forced: bool, ends: str) -> None:
    torch.manual_seed(0)
    problem = QUADROTOR if spec.startswith("Hybrid") else Problem.plain(4, 3, 6, 10)
    network = parse(f"{spec} - Washout: 10")[0].build(problem)
    u, y, state = torch.randn(5, 6, 4), torch.randn(5, 6, problem.n_outputs), torch.randn(5, network.layout.size)
    state.requires_grad_()
    with kernel("native"):
        run = network.rollout(u, state, y if forced else None)
        kept = [i for i, name in enumerate(("outputs", "state")) if ends in (name, "both")]
        slopes = [torch.randn_like(x) if i in kept else None for i, x in enumerate(run)]
        of, given = [run[i] for i in kept], [slopes[i] for i in kept]
        d_state, *found = torch.autograd.grad(of, [state, *network.parameters()], given, materialize_grads=True)
        with torch.no_grad():
            *values, vjp = network.rollout_vjp(u, state, y if forced else None)
            d_state_by_hand, by_hand = vjp(*slopes)
    assert all(torch.equal(a, b) for a, b in zip(values, run, strict=True))
    assert torch.equal(d_state_by_hand, d_state)
    assert all(torch.equal(by_hand[n], g) for (n, _), g in zip(network.named_parameters(), found, strict=True))


class Halved(LSTMPredictor):
    """A plug-in's predictor that knows nothing of the way back of what it builds on."""

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        outputs, state = super().rollout(inputs, state, feedback)
        return outputs / 2, state


class Taught(LSTMPredictor):
    def training_rollout(self, inputs: Tensor, outputs: Tensor, state: Tensor) -> Tensor:
        return self.rollout(inputs, state, outputs)[0]


class Weighed(LSTMPredictor):
    def cost(self, predicted: Tensor, measured: Tensor) -> Tensor:
        return super().cost(predicted[..., :1], measured[..., :1])


class Mirrored(LSTMPredictor):
    def augment(self, windows: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        return tuple(-x for x in windows)


class Filled(LSTMPredictor):
    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        return super().init_buffers(inputs, outputs) + self.output_bias.unsqueeze(-2)


class Doubled(MLPInitializer):
    def initialize(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        return 2 * super().initialize(predictor, inputs, outputs)


class Joined(CascadePredictor):
    def join(self, states: Sequence[Tensor], inputs: Tensor, outputs: Tensor) -> Tensor:
        return 2 * super().join(states, inputs, outputs)


@pytest.mark.parametrize("changed", [Halved, Taught, Weighed, Mirrored, Filled, Doubled, Joined])
def test_what_a_subclass_changes_is_not_passed_over(changed: type) -> None:
    with kernel("native"):
        network, batch = of_a_body(f"{'Cascade' if changed is Joined else 'LSTM'}: 2x9 - MLP: 9x10")
        part = network.initializer if changed is Doubled else network.predictor
        part.__class__ = changed
        parameters = dict(network.named_parameters())
        cost, found = gradient.cost_and_gradient(network, parameters, batch, 1.0, 1.0)
        expected = network(*batch, 1.0, 1.0)
        slopes = torch.autograd.grad(expected, list(parameters.values()), torch.ones_like(expected))
        assert torch.equal(cost, expected)
        assert all(torch.equal(found[n], s) for n, s in zip(parameters, slopes, strict=True))
