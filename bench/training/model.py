"""A predictor and its initializer as one trainable module."""

import torch
from torch import Tensor, nn

from bench.experiment.config import RunConfig
from bench.experiment.seeds import derive
from bench.training.data import WindowedData
from registry.contracts import Channel, Initializer, Predictor, Problem
from registry.initializers.each import build as build_initializer
from registry.state_cost import state_initialization_cost


class Model(nn.Module):
    """The initializer-predictor pair of the paper. Weights may carry a leading model dimension M."""

    def __init__(self, predictor: Predictor, initializer: Initializer | None) -> None:
        super().__init__()
        self.predictor, self.initializer = predictor, initializer

    def state(self, history_inputs: Tensor, history_outputs: Tensor) -> Tensor:
        """State (…, B, s) at k0 from the scaled history."""
        if self.initializer is None:
            return self.predictor.init_buffers(history_inputs, history_outputs)
        return self.initializer.initialize(self.predictor, history_inputs, history_outputs)

    def forward(self, u_history: Tensor, y_history: Tensor, u: Tensor, y: Tensor, alpha: float, beta: float) -> Tensor:
        """Total cost α L_pred + β L_si on scaled windows; (…), one a model."""
        p = self.predictor
        if self.training:
            u_history, y_history, u, y = p.augment((u_history, y_history, u, y))
        state = self.state(u_history, y_history)
        predicted = p.training_rollout(u, y, state) if self.training else self._free_run(u, state)
        cost = times(alpha, p.cost(predicted, y))
        if beta and self.initializer is not None and self.initializer.uses_state_cost:
            last = y_history[..., -1, : p.n_outputs]
            cost = cost + times(beta, state_initialization_cost(p, state, u_history[..., -1, :], last))
        return cost

    def _free_run(self, u: Tensor, state: Tensor) -> Tensor:
        """Scaled outputs (…, T, n); a run longer than the horizon goes on from piece to piece by its state."""
        pieces = []
        for piece in u.split(self.predictor.problem.horizon, -2):
            outputs, state = self.predictor.rollout(piece, state)
            pieces.append(outputs)
        return pieces[0] if len(pieces) == 1 else torch.cat(pieces, -2)

    def predict(self, u_history: Tensor, y_history: Tensor, u: Tensor) -> Tensor:
        """SI windows (B, τ, m), (B, τ, n + c), (B, T, m) → SI outputs (B, T, n), without gradients."""
        p = self.predictor
        with torch.no_grad():
            state = self.state(p.input_scaler(u_history), p.scale_history(y_history))
            return p(u, state)

    def judge(self, u_history: Tensor, y_history: Tensor, u: Tensor, y: Tensor) -> Tensor:
        """The free run and every view of the predictor, side by side (B, T, n + …), SI, without gradients.

        Columns are those of `judged`; arguments as for `predict`, with the measured outputs y (B, T, n).
        """
        p = self.predictor
        with torch.no_grad():
            state = self.state(p.input_scaler(u_history), p.scale_history(y_history))
            predicted = [p(u, state)]
            for name in p.views:
                scaled, s, columns = (
                    p.view(name, p.input_scaler(u), p.output_scaler(y), state),
                    p.output_scaler,
                    p.viewed(name),
                )
                predicted.append(scaled * s.scale[columns] + s.offset[columns])
            return torch.cat(predicted, -1)

    def judged(self) -> list[tuple[Channel, int]]:
        """The channels that `judge` predicts, each with the column of the measured outputs that it stands beside."""
        p = self.predictor
        found = [(c, i) for i, c in enumerate(p.problem.outputs)]
        for name in p.views:
            for i in p.viewed(name):
                c = p.problem.outputs[i]
                found.append((Channel(f"{c.group}_{name}.{c.axis}" if c.axis else f"{c.name}_{name}", c.unit), i))
        return found

    def weight_count(self) -> int:
        """Weights of predictor and initializer."""
        return self.predictor.weight_count() + (self.initializer.weight_count() if self.initializer else 0)


def times(weight: float, cost: Tensor) -> Tensor:
    """A weighted cost."""
    return cost if weight == 1 else weight * cost


def build(
    config: RunConfig,
    inputs: tuple[Channel, ...],
    outputs: tuple[Channel, ...],
    context: tuple[Channel, ...],
    rate: float,
) -> Model:
    """A fresh model, its weights drawn from the run's own seed."""
    data = config.dataset
    recorded = (data.system, data.physics, data.input_hold)
    problem = Problem(inputs, outputs, config.horizon, config.tau, context, rate, *recorded, truth=data.truth)
    torch.manual_seed(derive(config.seed, "weights"))
    predictor = config.predictor.build(problem)
    return Model(predictor, build_initializer(config.initializer, predictor) if config.initializer else None)


def build_scaled(config: RunConfig, data: WindowedData) -> Model:
    """A fresh model with the scalers of its training part."""
    model = build(config, data.input_channels, data.output_channels, data.context_channels, data.rate)
    model.predictor.input_scaler.set(*data.input_scale)
    model.predictor.output_scaler.set(*data.output_scale)
    if data.increment_scale is not None:
        model.predictor.set_increments(data.increment_scale / model.predictor.output_scaler.scale)
    if model.predictor.context_scaler is not None:
        model.predictor.context_scaler.set(*data.context_scale)
    return model
