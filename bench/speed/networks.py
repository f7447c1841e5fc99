"""What takes part in a row: the reference, torch's own layers and ours, each as a function that does one step."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any, cast

import torch
from torch import Tensor, nn

from bench.experiment.notation import parse
from bench.speed.naive import NaiveLSTM, NaiveMLFC
from bench.speed.rows import DELAYS, INPUTS, OUTPUTS, TAU, Row
from bench.speed.timing import Contender
from bench.training.gradient import run_cost_and_gradient
from registry.contracts import Channel, Composite, Predictor, Problem
from registry.kernels.native.library import core
from registry.units import SIGNALS

KERNEL = "BENCH_KERNEL"


def channels(*signals: str) -> tuple[Channel, ...]:
    """Those of a quadrotor."""
    return tuple(Channel(f"{s}.{a}", SIGNALS[s].unit) for s in signals for a in SIGNALS[s].axes or "1234")


def problem(row: Row) -> Problem:
    """Rates from rotor speeds; for a hybrid model velocity too, with what else its physics needs."""
    hybrid = row.model == "Hybrid"
    outputs = ("velocity", "body_rates") if hybrid else ("body_rates",)
    context = channels("attitude", "position") if hybrid else ()
    return Problem(channels("rotor_speed"), channels(*outputs), row.horizon, TAU, context)


def predictor(row: Row) -> Predictor:
    """A fresh one of ours, from a fixed seed."""
    torch.manual_seed(0)
    built: Predictor = parse(row.spec if row.initializer else f"{row.spec} - Washout: {TAU}")[0].build(problem(row))
    return built


def reference(row: Row) -> nn.Module:
    """The naive network with the same weights."""
    own = predictor(row).state_dict()
    size = (INPUTS, OUTPUTS, row.layers, row.hidden)
    if row.model == "MLFC":
        return NaiveMLFC(*size).load(own)
    return NaiveLSTM(*size, DELAYS if row.model == "LSTM TDL" else 1).load(own)


class Library(nn.Module):
    """`torch.nn.LSTM` or `torch.nn.RNN` of the size, with a linear read-out.

    It does less: no peepholes, no skip connections, no outputs fed back; measured ones stand in their place.
    """

    def __init__(self, row: Row) -> None:
        super().__init__()
        kind, taps = nn.RNN if row.model == "MLFC" else nn.LSTM, DELAYS if row.model == "LSTM TDL" else 1
        self.columns = INPUTS if taps == 1 else taps * (INPUTS + OUTPUTS)
        self.network = kind(self.columns, row.hidden, row.layers)
        self.out = nn.Linear(row.hidden, OUTPUTS)

    def forward(self, inputs: Tensor, states: tuple[Tensor, ...]) -> Tensor:
        """inputs (T, B, K) and states (L, B, H) → outputs (T, B, n)."""
        after, _ = self.network(inputs, states if len(states) > 1 else states[0])
        outputs: Tensor = self.out(after)
        return outputs


def kernels() -> list[str]:
    """The kernels that this machine has, the fastest last."""
    with using("auto"):
        return ["pytorch", "native"] if core() else ["pytorch"]


@contextmanager
def choosing(variable: str, value: str) -> Iterator[None]:
    """Within, an environment variable has this value."""
    before = os.environ.get(variable)
    os.environ[variable] = value
    try:
        yield
    finally:
        os.environ.pop(variable)
        if before is not None:
            os.environ[variable] = before


def using(kernel: str) -> AbstractContextManager[None]:
    """Within, networks run on this kernel."""
    return choosing(KERNEL, kernel)


def with_kernel(kernel: str, work: Contender) -> Contender:
    """The work, done on a kernel."""

    def step() -> None:
        with using(kernel):
            work()

    return step


def training(run: Callable[[], Tensor], weights: Sequence[Tensor], starts: Sequence[Tensor]) -> Contender:
    """Forward, squared error, backward to weights and initial states, fused Adam."""
    target, update = torch.randn_like(run().detach()), _adam(weights)

    def step() -> None:
        for leaf in (*weights, *starts):
            leaf.grad = None
        (run() - target).square().mean().backward()
        update([cast(Tensor, w.grad) for w in weights])

    return step


def training_flat(network: Predictor, u: Tensor, start: Tensor, models: int = 1) -> Contender:
    """As `bench.training.train` does it: all weights are views of one tensor; with ``models`` > 1 (M, …) each."""
    leaves = dict(network.named_parameters())
    theta = torch.cat([p.detach().flatten().expand(models, -1) for p in leaves.values()], 1)
    gradient = torch.zeros_like(theta)
    sizes, lead = [p.numel() for p in leaves.values()], (models,) if models > 1 else ()
    views = [x.split(sizes, 1) for x in (theta, gradient)]
    gradients = {}
    for (name, p), w, g in zip(leaves.items(), *views, strict=True):
        shape = (*lead, *p.shape)
        p.data, gradients[name] = w.view(shape), g.view(shape)
    target, update = torch.randn(*u.shape[:-1], network.n_outputs), _adam([theta])

    def step() -> None:
        _, _, slopes = run_cost_and_gradient(network, leaves, u, start, target)
        torch._foreach_copy_([gradients[name] for name in slopes], list(slopes.values()))
        update([gradient])

    return step


def _adam(weights: Sequence[Tensor]) -> Callable[[list[Tensor]], None]:
    """torch's fused Adam, called as `bench.training.train` does: its wrapper would add as much to every row."""
    given = [w.detach() for w in weights]
    means, squares = ([torch.zeros_like(w) for w in given] for _ in range(2))
    steps = [torch.zeros(()) for _ in given]
    options: dict[str, Any] = {"lr": 1e-4, "beta1": 0.9, "beta2": 0.999, "weight_decay": 0.0, "eps": 1e-8}

    def update(gradients: list[Tensor]) -> None:
        torch._foreach_add_(steps, 1)
        torch._fused_adam_(given, gradients, means, squares, [], steps, amsgrad=False, maximize=False, **options)

    return update


def predicting(run: Callable[[], Tensor]) -> Contender:
    """A free run without gradients."""

    def step() -> None:
        with torch.no_grad():
            run()

    return step


def naive(row: Row) -> Contender:
    """The reference, its models one after the other."""
    return _one_by_one(row, lambda: _naive(row))


def library(row: Row) -> Contender:
    """torch's own layers, their models one after the other."""
    return _one_by_one(row, lambda: _library(row))


def _one_by_one(row: Row, make: Callable[[], Contender]) -> Contender:
    each = [make() for _ in range(row.models)]

    def step() -> None:
        for work in each:
            work()

    return step


def _naive(row: Row) -> Contender:
    network = reference(row)
    u, state = torch.randn(row.batch, row.horizon, INPUTS), _state(row.batch, predictor(row))
    return _contender(row, lambda: network(u, state), list(network.parameters()), [state])


def _library(row: Row) -> Contender:
    network = Library(row)
    u = torch.randn(row.horizon, row.batch, network.columns)
    count = 1 if row.model == "MLFC" else 2
    states = tuple((0.3 * torch.randn(row.layers, row.batch, row.hidden)).requires_grad_() for _ in range(count))
    return _contender(row, lambda: network(u, states), list(network.parameters()), states)


def ours(row: Row) -> Contender:
    """A predictor of this suite; several models in one call."""
    network = predictor(row)
    lead = (row.models,) if row.models > 1 else ()
    u = torch.randn(*lead, row.batch, row.horizon, INPUTS)
    state = _start(network, row) if row.model == "Hybrid" else _state(*lead, row.batch, network)
    if row.task == "predict":
        return predicting(lambda: network.rollout(u, state)[0])
    return training_flat(network, u, state, row.models)


def _contender(row: Row, run: Callable[[], Tensor], weights: Sequence[Tensor], starts: Sequence[Tensor]) -> Contender:
    return predicting(run) if row.task == "predict" else training(run, weights, starts)


def _state(*shape: "int | Predictor") -> Tensor:
    *lead, network = shape
    return (0.3 * torch.randn(*cast(list[int], lead), cast(Predictor, network).layout.size)).requires_grad_()


def _start(network: Predictor, row: Row) -> Tensor:
    """A hybrid model at rest, its network states at random."""
    history = (
        torch.zeros(row.batch, TAU, network.n_inputs),
        torch.zeros(row.batch, TAU, network.n_outputs + network.n_context),
    )
    history[1][..., network.n_outputs + 3] = 1.0  # no rotation, as a quaternion xyzw
    buffer = network.init_buffers(*history)
    hidden = 0.3 * torch.randn(row.batch, network.layout.hidden + network.layout.cell)
    return torch.cat([buffer, hidden], -1).requires_grad_()


def parts(row: Row) -> Contender:
    """The two LSTMs of a hybrid model, each alone: as wide, as deep, with as many outputs, which it is fed back."""
    whole = predictor(row)
    assert isinstance(whole, Composite)
    each = []
    for network in whole.parts():
        weights = cast(nn.ParameterList, network.input_weight)[0], cast(Tensor, network.output_weight)
        columns, outputs = weights[0].shape[1], weights[1].shape[0]
        plain = Problem.plain(columns - outputs, outputs, row.horizon, TAU)
        alone: Predictor = parse(f"LSTM: {row.layers}x{row.hidden} - Washout: {TAU}")[0].build(plain)
        u, state = torch.randn(row.batch, row.horizon, columns - outputs), _state(row.batch, alone)
        each.append(training_flat(alone, u, state))

    def step() -> None:
        for work in each:
            work()

    return step
