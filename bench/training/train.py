"""The training loop: batch, cost, optimizer, validation, and what ends a run; several models of one shape side by side.

Each has its own seed, data and fate; what they are made of is in `bench.training.group`. Divergence is a result, not a
crash.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bench.experiment.config import RunConfig, Training
from bench.experiment.device import device
from bench.training.data import WindowedData
from bench.training.gradient import cost_and_gradient
from bench.training.group import Curve, Rows, RunState, Trained, supports_batching
from bench.training.model import Model, build_scaled

BETAS, EPS = (0.9, 0.999), 1e-8
"""Of Adam."""
DIVERGED = 1e6
"""A training cost (scaled units) above this has diverged: predictions a thousand deviations off."""
OnValidation = Callable[[list[Curve]], Iterable[int]]
"""Called with every model's curve so far; gives the models, by place, that need not go on."""


def batchable(config: RunConfig, data: WindowedData) -> bool:
    """Whether runs like this are trained in updates, and keep their bits in a group.

    They do when they draw no random numbers while training, when their batches are whole vectors (see
    `registry.kernels.pointwise.pad_batch`) and when their layers are not too thin for BLAS to treat them alike.
    """
    dropout, hidden = (getattr(config.predictor, o, 0) for o in ("dropout", "hidden"))
    sizes = (hidden, getattr(config.initializer, "hidden", hidden))
    return (
        config.predictor.training == "gradient"
        and supports_batching(config)
        and device(config).type == "cpu"
        and not dropout
        and getattr(config.initializer, "start", "zero") == "zero"
        and min(sizes) >= 8
        and config.training.batch % 32 == 0
        and config.training.batch <= len(data.train)
    )


def train(
    configs: Sequence[RunConfig],
    data: Sequence[WindowedData],
    progress: Callable[[int], None] = lambda updates: None,
    checkpoint: Path | None = None,
    on_validation: OnValidation = lambda curves: (),
) -> list[Trained]:
    """Train models of one shape side by side.

    Args:
        configs: equal but for `bench.experiment.run_key.FREE`.
        data: what each run trains on.
        progress: called with the number of updates done since the last call, summed over models.
        checkpoint: file for the state at every validation; a second call goes on from there. It is the caller's to
            remove once the outcome is safe.
        on_validation: called after each validation, and when a checkpoint is resumed; what it gives ends as "pruned".
    """
    models = [build_scaled(c, d) for c, d in zip(configs, data, strict=True)]
    if configs[0].predictor.training != "gradient":
        return [_closed_form(m, d) for m, d in zip(models, data, strict=True)]
    return Group(models, [RunState(c, d) for c, d in zip(configs, data, strict=True)], checkpoint).train(
        progress, on_validation
    )


def _closed_form(model: Model, data: WindowedData) -> Trained:
    """Fit a baseline on at most 20,000 training windows, evenly spread."""
    u_history, y_history, u, y = data.gather(data.train.every(20_000).starts)
    p = model.predictor
    scale_u, scale_y = p.input_scaler, p.output_scaler
    p.fit(scale_u(u_history), p.scale_history(y_history), scale_u(u), scale_y(y))
    return Trained(model, "finished", 0, 0, None, [])


def horizon_at(options: Training, update: int, horizon: int) -> int:
    """Steps that the windows of an update have, from 0 on: ``stages`` lengths that grow by equal factors, then all.

    Each of the shorter lengths has as many updates as the others, in the first ``grown_at`` of the budget. A network
    that does not yet predict ten steps learns nothing from two hundred, at twenty times the price.
    """
    first, stages = options.first_horizon, options.stages
    if not 0 < first < horizon:
        return horizon
    stage = int(update / options.updates / options.grown_at * stages)
    return horizon if stage >= stages else round(first * (horizon / first) ** (stage / stages))


def shortened(windows: tuple[Tensor, ...], steps: int) -> tuple[Any, ...]:
    """Windows (history, history, inputs (…, T, m), outputs (…, T, n)) with their first ``steps`` steps alone."""
    u_history, y_history, u, y = windows
    return u_history, y_history, u[..., :steps, :], y[..., :steps, :]


class Group(Rows):
    """The loop."""

    def __init__(self, models: list[Model], runs: list[RunState], checkpoint: Path | None = None) -> None:
        super().__init__(models, runs, device(runs[0].config), checkpoint)

    def train(self, progress: Callable[[int], None], on_validation: OnValidation = lambda curves: ()) -> list[Trained]:
        """Run to the end: budget, early stopping, divergence or `on_validation`, model by model."""
        if self.checkpoint:
            self._resume()
            progress(self.update * len(self.runs))
            self._prune(on_validation)
        o = self.options
        if o.validation_horizon and not self.update:
            self._validate(0)
        while self.update < o.updates and self.active:
            self.step()
            if self.update % o.evaluate_every == 0 or self.update == o.updates:
                since = (self.update - 1) % o.evaluate_every + 1
                self._validate(since)
                if self.checkpoint:
                    self._save()
                progress(since * len(self.runs))
                self._prune(on_validation)
        progress((o.updates - self.update) * len(self.runs))
        return [self._trained(i) for i in range(len(self.runs))]

    def step(self) -> None:
        """One update of the runs that still train."""
        o = self.options
        if len(self.runs) == 1:  # noise of dropout or of a random washout start, the same after a resume
            self._draw_from(f"noise/{self.update}")
        windows = shortened(self._batch(), horizon_at(o, self.update, self.runs[0].data.horizon))
        cost, gradients = cost_and_gradient(self.network, self.parameters, windows, o.alpha, o.beta)
        torch._foreach_copy_([self.gradients[name] for name in gradients], list(gradients.values()))
        norms = torch.stack([g.norm() for g in self.gradient.unbind(0)])
        self.train_cost += cost
        size, steep = cost.reshape(-1).tolist(), norms.tolist()
        healthy = [math.isfinite(c) and math.isfinite(n) and c < DIVERGED for c, n in zip(size, steep, strict=True)]
        if any(not n <= o.clip for n in steep):
            self.gradient.mul_((o.clip / norms.clamp(min=o.clip)).unsqueeze(-1))
        self.update += 1
        self._adam()
        if not all(healthy):
            for i, fine in zip(self.active, healthy, strict=True):
                if not fine:
                    self.runs[i].ended, self.runs[i].ended_at = "diverged", self.update
            self._leave_ended()

    def _adam(self) -> None:
        """One step of Adam with decoupled weight decay; the rate falls along a cosine to its final fraction.

        torch's private function, as it is in the one version that is required: the public `torch.optim.adamw.adamw`
        comes to the same bits and takes 80 µs more, of the 1 to 3 ms of an update.
        """
        o = self.options
        fall = 0.5 * (1 + math.cos(math.pi * (self.update - 1) / o.updates))
        for rate, (weights, gradients, means, squares) in self.alike.items():
            torch._fused_adamw_(
                weights,
                gradients,
                means,
                squares,
                [],
                [torch.tensor(float(self.update), device=self.device)] * len(weights),
                lr=rate * (o.final_rate + (1 - o.final_rate) * fall),
                beta1=BETAS[0],
                beta2=BETAS[1],
                weight_decay=o.weight_decay,
                eps=EPS,
                amsgrad=False,
                maximize=False,
            )

    def _validate(self, since: int) -> None:
        """Cost of free runs on the validation part, ``since`` updates after the last validation.

        Keeps the best weights and ends a run that has stopped improving.
        """
        self.network.eval()
        self._draw_from(f"validation/{self.update}")  # a random washout start
        for j, i in enumerate(self.active):
            run = self.runs[i]
            validation = self._cost(i, self.theta[j : j + 1])
            if since:
                run.curve.append((self.update, float(self.train_cost[j]) / since, validation))
            if validation < run.best:
                run.best, run.best_update, run.stale = validation, self.update, 0
                self.best[i] = self.theta[j]
            elif math.isfinite(validation) or self.options.validation_horizon:  # long runs get away early on
                run.stale += 1
                if run.stale >= self.options.patience:
                    run.ended, run.ended_at = "finished", self.update
            else:
                run.ended, run.ended_at = "diverged", self.update
        self.network.train()
        self.train_cost.zero_()
        self._leave_ended()

    def _prune(self, on_validation: OnValidation) -> None:
        """Show the curves, and end the runs that need not go on."""
        for i in on_validation([r.curve for r in self.runs]):
            if not self.runs[i].ended:
                self.runs[i].ended, self.runs[i].ended_at = "pruned", self.update
        self._leave_ended()
