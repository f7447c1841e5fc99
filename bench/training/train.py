"""The training loop: several models of one shape side by side, each with its own seed, data and fate.

Weights of the group are one flat tensor (M, P). Every operation treats the rows alike and apart, so a model's
bits do not depend on what it is trained beside. Divergence is a result, not a crash.
"""

import copy
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call

from bench.experiment.config import RunConfig, Training
from bench.experiment.device import device
from bench.experiment.seeds import derive
from bench.training.adam import Adam
from bench.training.checkpoint import Checkpoint
from bench.training.curriculum import horizon_at, shortened
from bench.training.data import WindowedData
from bench.training.gradient import cost_and_gradient
from bench.training.model import Model, build_scaled

Curve = list[tuple[int, float, float]]
"""(update, training cost since the last validation, validation cost L_pred), scaled units."""
DIVERGED = 1e6
"""A training cost (scaled units) above this has diverged: predictions a thousand deviations off."""
SAVED = ("theta", "m", "v", "best")
"""Tensors of a checkpoint."""
OnValidation = Callable[[list[Curve]], Iterable[int]]
"""Called with every model's curve so far; gives the models, by place, that need not go on."""


@dataclass
class Trained:
    """The outcome of one run of training."""

    model: Model
    """With the weights of the best update."""
    status: str
    """"finished", "diverged", or "pruned" where it was not to go on."""
    updates: int
    best_update: int
    diverged_at: int | None
    curve: Curve


@dataclass
class RunState:
    """Where one model of the group stands."""

    config: RunConfig
    data: WindowedData
    curve: Curve = field(default_factory=list)
    best: float = math.inf
    best_update: int = 0
    stale: int = 0
    ended: str = ""
    ended_at: int = 0


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


def supports_batching(config: RunConfig) -> bool:
    """Whether weights, inputs and outputs have a leading model dimension in training."""
    return config.predictor.supports_batching and (config.initializer is None or config.initializer.supports_batching)


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


class Group:
    """The state of a group in training.

    Rows of ``theta``, ``m``, ``v`` and ``train_cost`` are the runs that still train; ``best`` has all of them. The
    weights of ``network`` are views of ``theta``, (M, …) each; without M for a run that cannot have others beside it.
    """

    def __init__(self, models: list[Model], runs: list[RunState], checkpoint: Path | None = None) -> None:
        self.runs, self.models = runs, models
        self.options: Training = runs[0].config.training
        self.device = device(runs[0].config)
        self.lead = slice(None) if supports_batching(runs[0].config) else 0
        """What to take of (M, …)."""
        for model in models:
            model.to(self.device)
        self.shapes = {n: p.shape for n, p in models[0].named_parameters()}
        self.theta = torch.stack([self._flat(m) for m in models])
        self.m, self.v = torch.zeros_like(self.theta), torch.zeros_like(self.theta)
        self.best = self.theta.clone()
        self.train_cost = torch.zeros(len(models), device=self.device)
        self.update = 0
        self.checkpoint = Checkpoint(checkpoint) if checkpoint else None
        scaled = {id(r.data): self._scaled(m, r.data) for m, r in zip(models, runs, strict=True)}
        self.scaled = [scaled[id(r.data)] for r in runs]
        self.validation = [self._validation(i) for i in range(len(runs))]
        self.orders: dict[int, tuple[int, Tensor]] = {}
        self.network = copy.deepcopy(models[0]).train()
        self._train_only(list(range(len(runs))))

    @staticmethod
    def _flat(model: Model) -> Tensor:
        flat = torch.cat([p.detach().flatten() for p in model.parameters()])
        return torch.nn.functional.pad(flat, (0, -len(flat) % 64))

    def _scaled(self, model: Model, data: WindowedData) -> WindowedData:
        """The run's data in scaled units, once."""
        p = model.predictor
        inputs, outputs, context = (x.to(self.device) for x in (data.inputs, data.outputs, data.context))
        context = context if p.context_scaler is None else p.context_scaler(context)
        return replace(data, inputs=p.input_scaler(inputs), outputs=p.output_scaler(outputs), context=context)

    def named(self, theta: Tensor) -> dict[str, Tensor]:
        """Views of weights (M, P) by name, (M, …) or plain ones."""
        sizes = [s.numel() for s in self.shapes.values()]
        pieces = theta.split([*sizes, theta.shape[-1] - sum(sizes)], -1)[:-1]  # the last one is padding
        return {n: w.view(len(theta), *s)[self.lead] for (n, s), w in zip(self.shapes.items(), pieces, strict=True)}

    def _train_only(self, active: list[int]) -> None:
        """Go on with these runs; the rows are theirs, in this order."""
        self.active = active
        if not active:  # a network without a model dimension has no row left that its weights could be
            return
        self.gradient = torch.zeros_like(self.theta)
        self.gradients, weights = self.named(self.gradient), self.named(self.theta)
        self.parameters = dict(self.network.named_parameters())
        for name, p in self.parameters.items():
            p.data = weights[name]
        rates = [self.runs[i].config.training.learning_rate for i in active]
        self.adam = Adam(self.options, rates, (self.theta, self.gradient, self.m, self.v))

    def _leave_ended(self) -> None:
        """Take the rows of runs that have ended out."""
        left = [j for j, i in enumerate(self.active) if not self.runs[i].ended]
        if len(left) < len(self.active):
            self.theta, self.m, self.v, self.train_cost = (
                x[left] for x in (self.theta, self.m, self.v, self.train_cost)
            )
            self._train_only([self.active[j] for j in left])

    def _validation(self, i: int) -> list[tuple[Tensor, ...]]:
        """What the run is validated on: (B, …) each, windows of one length together."""
        data = self.scaled[i]
        longest = self.options.validation_horizon
        if not longest:
            return [data.gather(data.validation.every(self.options.validation_windows).starts)]
        starts: dict[int, list[int]] = {}
        for first, length in data.held_back:
            run = min(longest, length - data.tau)
            starts.setdefault(run, []).extend(range(first, first + length - data.tau - run + 1, run))
        return [replace(data, horizon=run).gather(torch.tensor(at)) for run, at in starts.items()]

    def _batch(self) -> tuple[Tensor, ...]:
        """The next batch of every model, (M, B, …) or (B, …) each: a permutation an epoch, drawn from its own seed."""
        gathered = []
        for i in self.active:
            data = self.scaled[i]
            size = min(self.options.batch, len(data.train))
            epoch, at = divmod(self.update, len(data.train) // size)
            order = self._order(self.runs[i].config.seed, epoch, len(data.train))
            gathered.append(data.gather(data.train.starts[order[at * size : (at + 1) * size]]))
        if len(gathered) == 1:
            return tuple(x.unsqueeze(0)[self.lead] for x in gathered[0])
        return tuple(torch.stack(parts) for parts in zip(*gathered, strict=True))

    def _order(self, seed: int, epoch: int, size: int) -> Tensor:
        """The permutation of an epoch; that of a seed is kept until its next one."""
        if self.orders.get(seed, (-1,))[0] != epoch or len(self.orders[seed][1]) != size:
            drawn = np.random.default_rng(derive(seed, f"batches/{epoch}")).permutation(size)
            self.orders[seed] = epoch, torch.from_numpy(drawn)
        return self.orders[seed][1]

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
        self.adam.step(self.update)
        if not all(healthy):
            for i, fine in zip(self.active, healthy, strict=True):
                if not fine:
                    self.runs[i].ended, self.runs[i].ended_at = "diverged", self.update
            self._leave_ended()

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

    def _cost(self, i: int, theta: Tensor) -> float:
        """Cost of free runs of a model with weights (1, P), the mean over its batches."""
        costs = []
        for batch in self.validation[i]:
            windows = tuple(x.unsqueeze(0)[self.lead] for x in batch)
            with torch.no_grad():
                costs.append(float(functional_call(self.network, self.named(theta), (*windows, 1.0, 0.0))))
        return sum(costs) / len(costs)

    def _prune(self, on_validation: OnValidation) -> None:
        """Show the curves, and end the runs that need not go on."""
        for i in on_validation([r.curve for r in self.runs]):
            if not self.runs[i].ended:
                self.runs[i].ended, self.runs[i].ended_at = "pruned", self.update
        self._leave_ended()

    def _trained(self, i: int) -> Trained:
        run, model = self.runs[i], self.models[i]
        named = self.named(self.best[i : i + 1])
        with torch.no_grad():
            for name, weight in model.named_parameters():
                weight.copy_(named[name].view_as(weight))
        model.cpu().eval()
        at, diverged = run.ended_at or self.update, run.ended == "diverged"
        return Trained(model, run.ended or "finished", at, run.best_update, at if diverged else None, run.curve)

    def _save(self) -> None:
        assert self.checkpoint
        tensors = {name: getattr(self, name).cpu() for name in SAVED}
        runs = [
            {k: getattr(r, k) for k in ("curve", "best_update", "stale", "ended", "ended_at")}
            | {"best": r.best if math.isfinite(r.best) else None}
            for r in self.runs
        ]
        self.checkpoint.save(tensors, {"update": self.update, "runs": runs})

    def _resume(self) -> None:
        assert self.checkpoint
        found = self.checkpoint.load()
        if found is None:
            return
        tensors, state = found
        for name in SAVED:
            setattr(self, name, tensors[name].to(self.device))
        self.update = state["update"]
        for run, saved in zip(self.runs, state["runs"], strict=True):
            for name, value in saved.items():
                setattr(run, name, value)
            run.best = math.inf if run.best is None else run.best
            run.curve = [(int(u), t, v) for u, t, v in run.curve]
        self.train_cost = torch.zeros(len(self.theta), device=self.device)
        self._train_only([i for i, r in enumerate(self.runs) if not r.ended])

    def _draw_from(self, what: str) -> None:
        """Seed the generator of the device; `torch.manual_seed` takes as long as a small network."""
        seed = derive(self.runs[0].config.seed, what)
        if self.device.type == "cuda":
            torch.cuda.manual_seed(seed)
        torch.default_generator.manual_seed(seed)
