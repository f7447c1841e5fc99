"""A whole update of `bench.train`, and the share of it that the networks themselves do not take."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from bench.config import RunConfig, Training
from bench.data import Prepared, Windows
from bench.model import build_scaled
from bench.notation import parse
from bench.speed.networks import problem
from bench.speed.rows import DELAYS, INPUTS, OUTPUTS, TAU, Row
from bench.speed.timing import Contender
from bench.train import Group, Run
from registry.contracts import Split
from registry.core import DATASETS
from registry.kernels.lstm import Layer, lstm

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
    data = Prepared(
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
    return Group([build_scaled(c, data) for c in configs], [Run(c, data) for c in configs])


def networks(row: Row) -> Contender:
    """The LSTMs and products of such an update alone, forward and backward.

    Operands are as the kernels take them: batches, delay lines, costs, padding and the optimizer are left out.
    """
    group, (m, n), lead = _group(row), (INPUTS, OUTPUTS), (row.models, row.batch)
    weights = {name: w.detach().clone().requires_grad_() for name, w in group.network.named_parameters()}
    predictor, initializer = (
        {k.removeprefix(part): w for k, w in weights.items() if k.startswith(part)}
        for part in ("predictor.", "initializer.")
    )
    taps = DELAYS if row.model == "LSTM TDL" else 1
    mlp = row.initializer.startswith("MLP")
    history = torch.randn(*lead, TAU * (m + n)) if mlp else torch.randn(*lead, TAU, m + n)
    u, state = (
        torch.randn(*lead, row.horizon, m),
        torch.randn(*lead, (taps - 1) * m + taps * n + 2 * row.layers * row.hidden),
    )

    def states() -> Tensor:
        w = initializer
        if mlp:
            h = _affine(history, w["hidden_weight"], w["hidden_bias"]).tanh()
        else:
            width = w["output_weight"].shape[-1]
            h = lstm(history, history.new_zeros(*lead, 2 * width), [Layer(*(w[k] for k in WEIGHTS))])[1][..., :width]
        return _affine(h, w["output_weight"], w["output_bias"])

    def outputs() -> Tensor:
        w = predictor
        layers = [Layer(*(w[f"{name}.{i}"] for name in WEIGHTS)) for i in range(row.layers)]
        return lstm(u, state, layers, w["output_weight"], w["output_bias"], delays=taps)[0]

    runs = ((states, [*initializer.values()]), (outputs, [*predictor.values(), state.requires_grad_()]))
    slopes = [torch.randn_like(run()) for run, _ in runs]

    def step() -> None:
        for (run, leaves), slope in zip(runs, slopes, strict=True):
            torch.autograd.grad(run(), leaves, slope)

    return step


def _affine(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    return torch.baddbmm(bias.unsqueeze(-2), x, weight.mT)
