"""Both kernels of the MLFC against the unrolled reference, which `test_speed` holds to the paper's equations."""

import pytest
import torch
from networks import Called, noise
from torch import Tensor, nn
from torch.func import functional_call

from bench.speed.naive import NaiveMLFC
from bench.speed.networks import kernels, using
from registry import PREDICTORS
from registry.contracts import Predictor, Problem

INPUTS, OUTPUTS = 4, 3
SIZES = [(1, 5, 1, 9), (2, 50, 64, 40), (3, 13, 37, 12)]
both = pytest.mark.parametrize("kernel", kernels())
sizes = pytest.mark.parametrize(("layers", "hidden", "batch", "steps"), SIZES)


def pair(layers: int, hidden: int) -> tuple[Predictor, NaiveMLFC]:
    predictor = PREDICTORS.get("MLFC")(layers=layers, hidden=hidden).build(Problem.plain(INPUTS, OUTPUTS, 40, 10))
    with torch.no_grad():
        for i, p in enumerate(predictor.double().parameters()):
            p.copy_(noise(*p.shape, seed=i) / p.shape[-1] ** 0.5)
    naive = NaiveMLFC(INPUTS, OUTPUTS, layers, hidden).double().load(predictor.state_dict())
    return predictor, naive


def slopes(outputs: Tensor, network: nn.Module, *leaves: Tensor) -> list[Tensor]:
    """Gradients of a squared error to the leaves and to the read-out, which both kinds of network have."""
    target = noise(*outputs.shape, seed=9).to(outputs.dtype)
    by_name = dict(network.named_parameters())
    weight = by_name.get("output_weight", by_name.get("out.weight"))
    return list(torch.autograd.grad((outputs - target).square().mean(), [*leaves, weight], retain_graph=True))


def inner(outputs: Tensor, network: nn.Module, hidden: int) -> list[Tensor]:
    """Gradients of the layers' weights, joined per layer as [inputs | y¹ .. y^L] and bias."""
    target = noise(*outputs.shape, seed=9).to(outputs.dtype)
    names, weights = zip(*network.named_parameters(), strict=True)
    grads = dict(zip(names, torch.autograd.grad((outputs - target).square().mean(), weights), strict=True))
    if not isinstance(network, NaiveMLFC):
        found = []
        for i in range(network.layers):
            seen, *others = grads[f"input_weight.{i}"].split([INPUTS + OUTPUTS] + [hidden] * (network.layers - 1), 1)
            others.insert(i, grads[f"feedback_weight.{i}"])
            found += [torch.cat([seen, *others], 1), grads[f"bias.{i}"]]
        return [*found, grads["direct_weight"], grads["output_bias"]]
    found = []
    for i in range(len(network.entering)):
        joined = [grads[f"joining.{i}.{j}.weight"] for j in range(len(network.entering))]
        found += [torch.cat([grads[f"entering.{i}.weight"], *joined], 1), grads[f"entering.{i}.bias"]]
    return [*found, grads["direct.weight"], grads["out.bias"]]


def everything(network: nn.Module, hidden: int, u: Tensor, state: Tensor, kernel: str = "") -> list[Tensor]:
    """Outputs, then all gradients."""
    u, state = u.clone().requires_grad_(), state.clone().requires_grad_()
    if isinstance(network, NaiveMLFC):
        outputs = network(u, state)
    else:
        with using(kernel):
            outputs = network.rollout(u, state)[0]
    return [outputs.detach(), *slopes(outputs, network, u, state), *inner(outputs, network, hidden)]


def error(found: list[Tensor], exact: list[Tensor]) -> list[float]:
    return [float((a - b).norm() / b.norm()) for a, b in zip(found, exact, strict=True)]


def joint_error(found: list[Tensor], exact: list[Tensor]) -> float:
    a, b = (torch.cat([x.double().flatten() for x in xs]) for xs in (found, exact))
    return float((a - b).norm() / b.norm())


@both
@sizes
def test_both_precisions_are_the_reference(kernel: str, layers: int, hidden: int, batch: int, steps: int) -> None:
    predictor, naive = pair(layers, hidden)
    u, state = noise(batch, steps, INPUTS, seed=20), noise(batch, predictor.layout.size, seed=21).tanh()
    exact = everything(naive, hidden, u, state)
    found = everything(predictor, hidden, u, state, kernel)
    assert float((found[0] - exact[0]).abs().max()) < 1e-12 and max(error(found, exact)) < 1e-10
    single = everything(naive.float(), hidden, u.float(), state.float())
    found = everything(predictor.float(), hidden, u.float(), state.float(), kernel)
    assert float((found[0] - exact[0]).abs().max()) < 1e-5
    ours, theirs = joint_error(found[1:], exact[1:]), joint_error(single[1:], exact[1:])
    assert ours < 3 * theirs, (ours, theirs)


@both
def test_dropout_lets_the_same_through_in_both_kernels(kernel: str) -> None:
    predictor = PREDICTORS.get("MLFC")(layers=2, hidden=9, dropout=0.4).build(Problem.plain(INPUTS, OUTPUTS, 8, 10))
    predictor.double().train()
    u, state = noise(37, 8, INPUTS, seed=1), noise(37, predictor.layout.size, seed=2)
    drawn = []
    for used in ("pytorch", kernel):
        torch.manual_seed(5)
        with using(used):
            outputs, end = predictor.rollout(u, state)
        drawn.append([outputs, end, *torch.autograd.grad(outputs.sum() + end.sum(), list(predictor.parameters()))])
    for a, b in zip(*drawn, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-12)


@both
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_is_not_finite_comes_out(kernel: str, bad: float) -> None:
    predictor, _ = pair(2, 13)
    names = [n for n, _ in predictor.named_parameters()]
    u, state = noise(5, 12, INPUTS, seed=20), noise(5, predictor.layout.size, seed=21)
    run = Called(predictor, predictor.rollout)
    with using(kernel):
        for name in names:
            weights = {n: p.detach().clone() for n, p in predictor.named_parameters()}
            weights[name].view(-1)[-1] = bad
            outputs = functional_call(run, {f"network.{n}": w for n, w in weights.items()}, (u, state))[0]
            # an infinite weight of a tanh layer saturates it: that is the right answer
            assert not outputs.isfinite().all() or (bad == float("inf") and ("_weight" in name or "bias." in name))
        for at in range(predictor.layout.size):
            spoilt = state.clone()
            spoilt[3, at] = float("nan")
            assert predictor.rollout(u, spoilt)[0][3].isnan().all()
            assert predictor.rollout(u, spoilt)[0][[0, 1, 2, 4]].isfinite().all()
