"""The baseline that is linear in the history and in the inputs up to each step."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.errors import BenchError


class LinearPredictor(Predictor):
    """One ridge regression a step k on [1 | history | u_{k0+1} .. u_k]: causal, no free-run feedback.

    Because the regressors of step k are the leading ones of step k+1, one Cholesky factor of the full normal
    matrix serves all steps: the factor of a leading block is the leading block of the factor.
    """

    def __init__(self, problem: Problem, ridge: float) -> None:
        super().__init__(problem)
        self.history, self.ridge = problem.history, ridge
        self.layout = StateLayout(self.history * problem.n_measured, 0, 0)
        self.width = 1 + self.layout.buffer + self.horizon * self.n_inputs
        self.register_buffer("coefficients", torch.zeros(self.horizon, self.width, self.n_outputs))
        self.coefficients: Tensor

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The whole history, inputs then outputs, oldest first."""
        u, y = inputs[..., -self.history :, :], outputs[..., -self.history :, :]
        return torch.cat([u.flatten(-2), y.flatten(-2)], -1)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; where the history holds more than inputs and outputs, the state stays as it is."""
        steps = inputs.shape[-2]
        if steps > self.horizon:
            raise BenchError(f"The linear baseline was fitted for {self.horizon} steps and cannot predict {steps}.")
        x = torch.cat([torch.ones_like(state[..., :1]), state, inputs.flatten(-2)], -1)
        w = self.coefficients[:steps, : x.shape[-1]]
        outputs = torch.einsum("bd,tdn->btn", x, w)
        if self.n_context:
            return outputs, state
        u, y = state.split([self.history * self.n_inputs, self.history * self.n_outputs], -1)
        y = torch.cat([y.unflatten(-1, (self.history, -1)), outputs if feedback is None else feedback], -2)
        u = torch.cat([u.unflatten(-1, (self.history, self.n_inputs)), inputs], -2)
        return outputs, self.init_buffers(u, y)

    def fit(self, history_inputs: Tensor, history_outputs: Tensor, inputs: Tensor, outputs: Tensor) -> None:
        """Ridge on scaled windows (W, τ, m), (W, τ, n + c), (W, T, m), (W, T, n), in float64 whatever they are."""
        x = torch.cat([self.init_buffers(history_inputs, history_outputs), inputs.flatten(1)], 1).double()
        x = torch.cat([torch.ones_like(x[:, :1]), x], 1)
        normal = x.mT @ x
        penalty = torch.full((x.shape[1],), self.ridge * len(x), dtype=x.dtype)
        penalty[0] = 0.0
        factor = torch.linalg.cholesky(normal + torch.diag(penalty + 1e-12 * normal.diagonal()))
        right = torch.einsum("wd,wtn->tdn", x, outputs.double())
        lead = 1 + self.layout.buffer
        self.coefficients.zero_()
        for step in range(self.horizon):
            d = lead + (step + 1) * self.n_inputs
            solved = torch.cholesky_solve(right[step, :d], factor[:d, :d])
            self.coefficients[step, :d] = solved.to(self.coefficients.dtype)

    def weight_count(self) -> int:
        """Number of fitted coefficients that may differ from zero."""
        lead = 1 + self.layout.buffer
        return sum((lead + (k + 1) * self.n_inputs) * self.n_outputs for k in range(self.horizon))


@PREDICTORS.register("linear")
@dataclass(frozen=True)
class Linear(PredictorEntry):
    """Ridge regression on the history and the inputs up to each step: the honest linear baseline."""

    training: ClassVar[str] = "closed_form"
    stateful: ClassVar[bool] = False

    ridge: float = option(
        1e-3, "penalty on squared scaled coefficients, per sample", low=0.0, log=True, search=(1e-6, 10.0)
    )

    @override
    def build(self, problem: Problem) -> Predictor:
        return LinearPredictor(problem, self.ridge)
