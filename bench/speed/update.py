"""A whole update of `bench.training.train`, and the share of it that the networks themselves do not take."""

from dataclasses import replace

import numpy as np
import torch

from bench.experiment.config import RunConfig, Training
from bench.experiment.notation import parse
from bench.speed.networks import problem
from bench.speed.rows import DELAYS, INPUTS, OUTPUTS, TAU, Row
from bench.speed.timing import Contender
from bench.training.data import WindowedData, Windows
from bench.training.model import build_scaled
from bench.training.train import Group, RunState
from registry.contracts import Split
from registry.core import DATASETS
from registry.kernels.lstm import Layer, lstm_vjp
from registry.kernels.mlp import mlp_vjp

WEIGHTS = ("input_weight", "recurrent_weight", "bias", "peephole")
SAMPLES = 20_000
"""Of the recording that the updates learn from: noise."""


def update(row: Row) -> Contender:
    """An update as `bench run` does it: batch, forward, both costs, backward, clipping, Adam."""
    return _group(row).step


def _group(row: Row) -> Group:
    asked = problem(row)
    training = Training(updates=10**9, batch=row.batch)
    base = RunConfig(*parse(row.spec), DATASETS.get("pelican_twin")(), horizon=row.horizon, training=training)
    configs = [replace(base, seed=seed) for seed in range(row.models)]
    rng = np.random.default_rng(0)
    inputs, outputs, context = (
        torch.from_numpy(rng.standard_normal((SAMPLES, n)).astype(np.float32)) for n in (INPUTS, OUTPUTS, 0)
    )
    as_they_are = [(torch.zeros(x.shape[1]), torch.ones(x.shape[1])) for x in (inputs, outputs, context)]
    count = SAMPLES - TAU - row.horizon
    windows = Windows(torch.arange(count), np.zeros(count, int))
    data = WindowedData(
        inputs=inputs,
        outputs=outputs,
        context=context,
        input_channels=asked.inputs,
        output_channels=asked.outputs,
        context_channels=(),
        rate=asked.rate,
        tau=TAU,
        horizon=row.horizon,
        train=windows,
        validation=windows.every(8),
        test=windows.every(8),
        names=("noise",),
        split=Split(("noise",), (), ()),
        input_scale=as_they_are[0],
        output_scale=as_they_are[1],
        context_scale=as_they_are[2],
    )
    return Group([build_scaled(c, data) for c in configs], [RunState(c, data) for c in configs])


def networks(row: Row) -> Contender:
    """The networks of such an update alone, forward and backward, as training calls the compiled core.

    Operands are as the kernels take them: batches, delay lines, bounds, costs and the optimizer are left out.
    """
    group, (m, n), lead = _group(row), (INPUTS, OUTPUTS), (row.models, row.batch)
    weights = {name: w.detach().clone() for name, w in group.network.named_parameters()}
    predictor, initializer = (
        {k.removeprefix(part): w for k, w in weights.items() if k.startswith(part)}
        for part in ("predictor.", "initializer.")
    )
    taps, states = DELAYS if row.model == "LSTM TDL" else 1, 2 * row.layers * row.hidden
    layers = [Layer(*(predictor[f"{name}.{i}"] for name in WEIGHTS)) for i in range(row.layers)]
    read_out, last = ((w["output_weight"], w["output_bias"]) for w in (predictor, initializer))
    u, state = torch.randn(*lead, row.horizon, m), torch.randn(*lead, (taps - 1) * m + taps * n + states)
    d_outputs, d_states = torch.randn(*lead, row.horizon, n), torch.randn(*lead, states)

    def run() -> None:
        _, _, back = lstm_vjp(u, state, layers, *read_out, delays=taps)
        back(d_outputs, None)

    if row.initializer.startswith("MLP"):
        history = torch.randn(*lead, TAU * (m + n))

        def start() -> None:
            _, back = mlp_vjp(history, [(initializer["hidden_weight"], initializer["hidden_bias"]), last])
            back(d_states, False)
    else:
        history, width = torch.randn(*lead, TAU, m + n), last[0].shape[-1]
        zero, reader = history.new_zeros(*lead, 2 * width), [Layer(*(initializer[name] for name in WEIGHTS))]

        def start() -> None:
            _, end, through_time = lstm_vjp(history, zero, reader)
            _, back = mlp_vjp(end[..., :width].contiguous(), [last])
            d_last, _ = back(d_states, True)
            assert d_last is not None
            through_time(None, torch.cat([d_last, d_last], -1))

    def step() -> None:
        with torch.no_grad():
            start()
            run()

    return step
