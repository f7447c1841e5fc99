"""The optimized initial state: better than a start from zero, a washout without iterations, gradients as declared."""

import pytest
import torch
from test_networks import noise, vivid
from torch import Tensor, nn
from torch.func import functional_call

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse, write
from bench.training.data import prepare
from bench.training.train import train
from registry import DATASETS, INITIALIZERS, PREDICTORS
from registry.contracts import Initializer, Predictor, Problem

TAU = 8
NETWORKS = ["LSTM", "LSTM TDL", "MLFC", "GRU"]
over = pytest.mark.parametrize("name", NETWORKS, ids=lambda n: n.replace(" ", ""))


def built(name: str, hidden: int = 4, layers: int = 2) -> Predictor:
    torch.manual_seed(7)
    entry = PREDICTORS.get(name)(layers=layers, hidden=hidden, **({"delays": 3} if "TDL" in name else {}))
    return vivid(entry.build(Problem.plain(3, 2, 12, TAU)))


def initializer(predictor: Predictor, name: str = "Optimized", **options: float) -> Initializer:
    return INITIALIZERS.get(name)(history=TAU, **options).build(predictor, predictor.problem)


def history() -> tuple[Tensor, Tensor]:
    return noise(5, TAU + 2, 3, seed=1), noise(5, TAU + 2, 2, seed=2)  # longer than τ: only the end counts


@over
def test_without_iterations_it_is_washout(name: str) -> None:
    predictor = built(name)
    optimized, washout = initializer(predictor, iterations=0), initializer(predictor, "Washout")
    assert torch.equal(optimized.initialize(predictor, *history()), washout.initialize(predictor, *history()))


def history_cost(predictor: Predictor, u: Tensor, y: Tensor, **options: float) -> Tensor:
    """Mean squared error of each window's one-step predictions from its fitted start, written out."""
    states = initializer(predictor, **options).start(predictor, u, y)
    assert not states.requires_grad
    hidden, cell = states.split([predictor.layout.hidden, predictor.layout.cell], -1)
    state = torch.cat([predictor.init_buffers(u[:, :1], y[:, :1]), hidden.tanh(), cell], -1)
    return (predictor.rollout(u[:, 1:], state, y[:, 1:])[0] - y[:, 1:]).square().mean((1, 2))


@over
def test_fitted_states_explain_every_window_better_than_zero(name: str) -> None:
    """Windows that the network itself made, from states that are not zero; under `no_grad`, as predictions are made."""
    predictor = built(name)
    u, state = noise(6, TAU, 3, seed=1), noise(6, predictor.layout.size, seed=4).tanh()
    with torch.no_grad():
        start = torch.cat(
            [predictor.init_buffers(u[:, :1], state[:, None, :2]), state[:, predictor.layout.buffer :]], 1
        )
        y = torch.cat([state[:, None, :2], predictor.rollout(u[:, 1:], start)[0]], 1)
        zero, fitted, settled = (history_cost(predictor, u, y, iterations=i) for i in (0, 10, 100))
    assert (fitted < zero).all() and fitted.mean() < 0.5 * zero.mean() and settled.mean() < 0.2 * zero.mean()
    assert not any(p.grad is not None for p in predictor.parameters())


def test_states_of_a_nearly_linear_system_are_recovered() -> None:
    """A slow damped rotation of two states seen through one of them: not forgotten in washout, found here."""
    predictor = PREDICTORS.get("MLFC")(layers=1, hidden=2).build(Problem.plain(0, 1, 12, TAU)).double()
    with torch.no_grad():
        predictor.input_weight[0].zero_()
        predictor.feedback_weight[0].copy_(0.98 * torch.tensor([[0.9, -0.4], [0.4, 0.9]]))
        predictor.output_weight.copy_(torch.tensor([[1.0, 0.0]]))
    truth = 0.05 * noise(20, 2, seed=3)
    y = [truth[:, :1]]
    for _ in range(TAU - 1):
        truth = (truth @ predictor.feedback_weight[0].detach().mT).tanh()
        y.append(truth[:, :1])
    windows = noise(20, TAU, 0, seed=1), torch.stack(y, 1)
    washed = initializer(predictor, "Washout").initialize(predictor, *windows)[:, 1:]
    fitted = initializer(predictor, iterations=300).initialize(predictor, *windows)[:, 1:]
    assert washed.abs().max() == 0  # nothing drives it from zero
    torch.testing.assert_close(fitted, truth, rtol=0, atol=1e-6)


def test_a_steep_cost_does_not_make_the_descent_diverge() -> None:
    predictor = built("LSTM")
    with torch.no_grad():
        predictor.output_weight.mul_(100)
    zero, fitted = (history_cost(predictor, *history(), iterations=i, rate=100.0) for i in (0, 20))
    assert (fitted < zero).all()


class Initialized(nn.Module):
    """Initializer and free run."""

    def __init__(self, predictor: Predictor, initializer: Initializer) -> None:
        super().__init__()
        self.predictor, self.initializer = predictor, initializer

    def forward(self, u_past: Tensor, y_past: Tensor, u: Tensor) -> Tensor:
        return self.predictor.rollout(u, self.initializer.initialize(self.predictor, u_past, y_past))[0]


@over
def test_gradient_to_the_weights_holds_the_fitted_start(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    predictor = built(name, hidden=2)
    model = Initialized(predictor, initializer(predictor, iterations=3))
    names, values = zip(*((n, p.detach().clone().requires_grad_()) for n, p in model.named_parameters()), strict=True)
    past, u = tuple(x[:2, -TAU:] for x in history()), noise(2, 3, 3, seed=3)

    def run(*values: Tensor) -> Tensor:
        return functional_call(model, dict(zip(names, values, strict=True)), (*past, u))

    whole = torch.autograd.grad(run(*values).square().sum(), values)
    held = model.initializer.start(predictor, *past)
    assert held.abs().max() > 1e-3 and not held.requires_grad
    monkeypatch.setattr(model.initializer, "start", lambda *_: held)
    torch.testing.assert_close(torch.autograd.grad(run(*values).square().sum(), values), whole)
    assert torch.autograd.gradcheck(run, values, fast_mode=True)


@over
@pytest.mark.parametrize("batch", [64, 7])
def test_training_in_a_group_changes_no_bit(name: str, batch: int) -> None:
    models = []
    for seed in range(3):
        torch.manual_seed(seed)
        predictor = PREDICTORS.get(name)(layers=1, hidden=20).build(Problem.plain(4, 2, 10, TAU))
        models.append(Initialized(predictor, initializer(predictor, iterations=4)))
    data = [noise(3, batch, *shape, seed=i).float() for i, shape in enumerate([(TAU, 4), (TAU, 2), (10, 4)])]

    def step(members: list[int]) -> tuple[Tensor, dict[str, Tensor]]:
        stacked = {
            n: torch.stack([models[i].get_parameter(n) for i in members]).detach().requires_grad_()
            for n, _ in models[0].named_parameters()
        }
        outputs = functional_call(models[0], stacked, tuple(x[members] for x in data))
        outputs.square().mean().mul(len(members)).backward()
        return outputs.detach(), {n: p.grad for n, p in stacked.items()}

    outputs, gradients = step([0, 1, 2])
    for i in range(3):
        alone, own = step([i])
        assert torch.equal(alone[0], outputs[i])
        assert [n for n in own if not torch.equal(own[n][0], gradients[n][i])] == []
        torch.testing.assert_close(models[i](*(x[i] for x in data)), outputs[i], rtol=1e-4, atol=1e-5)


def test_it_trains_and_predicts_in_an_ordinary_run() -> None:
    """Two seeds side by side; judged and predicting without gradients."""
    options = Training(updates=20, batch=32, evaluate_every=10, validation_windows=64)
    pair = parse("GRU: 1x8 - Optimized: 5")
    configs = [RunConfig(*pair, DATASETS.get("toy")(), horizon=6, training=options, seed=i) for i in (0, 1)]
    data = [prepare(c) for c in configs]
    for trained, prepared in zip(train(configs, data), data, strict=True):
        assert trained.status == "finished" and trained.curve[1][2] < trained.curve[0][2]
        windows = prepared.gather(prepared.test.starts[:4])
        predicted = trained.model.predict(*windows[:3])
        assert predicted.shape == (4, 6, 3) and predicted.isfinite().all() and not predicted.requires_grad


def test_notation_carries_the_length() -> None:
    predictor, made = parse("GRU: 1x20 - Optimized: 25")
    assert made is not None and made.history == 25
    assert write(predictor, made) == "GRU: 1x20 - Optimized: 25"
