"""Several models of one shape in training: their weights as rows of one tensor, their data, where each stands.

Weights of the group are one flat tensor (M, P). Every operation treats the rows alike and apart, so a model's
bits do not depend on what it is trained beside. How they are trained is in `bench.training.train`.
"""

import copy
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call

from bench.experiment.config import RunConfig, Training
from bench.experiment.seeds import derive
from bench.training.checkpoint import Checkpoint
from bench.training.data import WindowedData
from bench.training.model import Model

Curve = list[tuple[int, float, float]]
"""(update, training cost since the last validation, validation cost L_pred), scaled units."""
SAVED = ("theta", "m", "v", "best")
"""Tensors of a checkpoint."""


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


def supports_batching(config: RunConfig) -> bool:
    """Whether weights, inputs and outputs have a leading model dimension in training."""
    return config.predictor.supports_batching and (config.initializer is None or config.initializer.supports_batching)


class Rows:
    """The state of a group in training.

    Rows of ``theta``, ``m``, ``v`` and ``train_cost`` are the runs that still train; ``best`` has all of them. The
    weights of ``network`` are views of ``theta``, (M, …) each; without M for a run that cannot have others beside it.
    ``alike`` has by learning rate the rows of weights, gradients and the gradients' two moments; the whole tensors, in
    one piece, where all have the same. Rows of a length that no vector of the processor cuts keep their bits however
    they are put together.
    """

    def __init__(
        self, models: list[Model], runs: list[RunState], where: torch.device, checkpoint: Path | None = None
    ) -> None:
        self.runs, self.models = runs, models
        self.options: Training = runs[0].config.training
        self.device = where
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
        rates, tensors = (
            [self.runs[i].config.training.learning_rate for i in active],
            (self.theta, self.gradient, self.m, self.v),
        )
        self.alike = {
            rate: [[x] if len(set(rates)) == 1 else [x[j] for j, r in enumerate(rates) if r == rate] for x in tensors]
            for rate in dict.fromkeys(rates)
        }

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

    def _cost(self, i: int, theta: Tensor) -> float:
        """Cost of free runs of a model with weights (1, P), the mean over its batches."""
        costs = []
        for batch in self.validation[i]:
            windows = tuple(x.unsqueeze(0)[self.lead] for x in batch)
            with torch.no_grad():
                costs.append(float(functional_call(self.network, self.named(theta), (*windows, 1.0, 0.0))))
        return sum(costs) / len(costs)

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
