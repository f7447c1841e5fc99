"""A predictor and its initializer as one trainable module."""

import torch
from torch import Tensor, nn

from bench.config import RunConfig
from bench.data import Prepared
from bench.seeds import derive
from registry.contracts import Initializer, Predictor
from registry.cost import prediction_cost, state_initialization_cost


class Model(nn.Module):
    """The initializer-predictor pair of the paper. Weights may carry a leading model dimension M."""

    def __init__(self, predictor: Predictor, initializer: Initializer | None) -> None:
        super().__init__()
        self.predictor, self.initializer = predictor, initializer

    def state(self, history_inputs: Tensor, history_outputs: Tensor) -> Tensor:
        """State (…, B, s) at k0 from the scaled history."""
        if self.initializer is None:
            return self.predictor.fill(history_inputs, history_outputs)
        return self.initializer.initialize(self.predictor, history_inputs, history_outputs)

    def forward(self, u_history: Tensor, y_history: Tensor, u: Tensor, y: Tensor, alpha: float, beta: float) -> Tensor:
        """Total cost α L_pred + β L_si on scaled windows; (…), one a model."""
        state = self.state(u_history, y_history)
        predicted, _ = self.predictor.rollout(u, state)
        cost = alpha * prediction_cost(predicted, y)
        if beta and self.initializer is not None and self.initializer.uses_state_cost:
            cost = cost + beta * state_initialization_cost(
                self.predictor, state, u_history[..., -1, :], y_history[..., -1, :]
            )
        return cost

    def predict(self, u_history: Tensor, y_history: Tensor, u: Tensor) -> Tensor:
        """SI windows (B, τ, m), (B, τ, n), (B, T, m) → SI outputs (B, T, n), without gradients."""
        p = self.predictor
        with torch.no_grad():
            state = self.state(p.input_scaler(u_history), p.output_scaler(y_history))
            return p(u, state)

    def weight_count(self) -> int:
        """Weights of predictor and initializer."""
        return self.predictor.weight_count() + (self.initializer.weight_count() if self.initializer else 0)


def build(config: RunConfig, n_inputs: int, n_outputs: int) -> Model:
    """A fresh model, its weights drawn from the run's own seed."""
    torch.manual_seed(derive(config.seed, "weights"))
    predictor = config.predictor.build(n_inputs, n_outputs, config.horizon, config.tau)
    initializer = config.initializer.build(predictor, n_inputs, n_outputs) if config.initializer else None
    return Model(predictor, initializer)


def build_scaled(config: RunConfig, data: Prepared) -> Model:
    """A fresh model with the scalers of its training part."""
    model = build(config, len(data.input_channels), len(data.output_channels))
    model.predictor.input_scaler.set(*data.input_scale)
    model.predictor.output_scaler.set(*data.output_scale)
    return model
