"""Sparse identification of nonlinear dynamics with control: a polynomial of a few past samples, chosen by PySINDy."""

import math
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any, ClassVar

import torch
from torch import Tensor
from typing_extensions import override

from registry.contracts import Predictor, PredictorEntry, Problem, StateLayout
from registry.core import PREDICTORS, option
from registry.errors import BenchError
from registry.predictors.lstm import newest_first

MOST = 5_000
"""Terms of a polynomial."""
ROWS = 100_000
"""Samples that it is fitted to, at most, evenly spread."""


class SindyPredictor(Predictor):
    """Network of `Sindy`. State: the buffers [u_{k0} .. u_{k0−D+2} | ỹ_{k0} .. ỹ_{k0−D+1}], newest first."""

    def __init__(self, entry: "Sindy", problem: Problem) -> None:
        super().__init__(problem)
        self.entry, self.history = entry, entry.delays
        self.past = (entry.delays - 1) * self.n_inputs
        self.layout = StateLayout(self.past + entry.delays * self.n_outputs, 0, 0)
        columns = entry.delays * (self.n_inputs + self.n_outputs)
        terms = math.comb(columns + entry.degree, entry.degree)
        if terms > MOST:
            raise BenchError(f"PySINDy would choose among {terms} terms: take fewer delays or a lower degree.")
        powers = torch.zeros(terms, columns)
        chosen = (c for d in range(entry.degree + 1) for c in combinations_with_replacement(range(columns), d))
        for row, term in enumerate(chosen):
            for column in term:
                powers[row, column] += 1
        self.register_buffer("powers", powers)
        self.register_buffer("coefficients", torch.zeros(self.n_outputs, terms))
        self.powers: Tensor
        self.coefficients: Tensor

    def init_buffers(self, inputs: Tensor, outputs: Tensor) -> Tensor:
        """The measured history in the order of the state; a short one repeats its first sample."""
        u = newest_first(inputs, self.entry.delays - 1)
        return torch.cat([u, newest_first(outputs[..., : self.n_outputs], self.entry.delays)], -1)

    def rollout(self, inputs: Tensor, state: Tensor, feedback: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """See `Predictor.rollout`; measured outputs take the place of predicted ones."""
        outputs = []
        for k, u in enumerate(inputs.unbind(-2)):
            x = torch.cat([u, state], -1)  # D inputs, D outputs, newest first each
            y = (x.unsqueeze(-2) ** self.powers).prod(-1) @ self.coefficients.mT
            outputs.append(y)
            fed = y if feedback is None else feedback[..., k, :]
            inner = x[..., : self.past], fed, x[..., self.past + self.n_inputs : x.shape[-1] - self.n_outputs]
            state = torch.cat(inner, -1)
        return torch.stack(outputs, -2), state

    def fit(self, history_inputs: Tensor, history_outputs: Tensor, inputs: Tensor, outputs: Tensor) -> None:
        """The terms that PySINDy keeps, from one step ahead, on scaled training windows; see `Predictor.fit`.

        Raises:
            BenchError: PySINDy is not installed.
        """
        sindy = _installed()
        u = torch.cat([history_inputs, inputs], -2)
        y = torch.cat([history_outputs[..., : self.n_outputs], outputs], -2)
        taps, steps = self.entry.delays, u.shape[-2]
        if steps <= taps:
            raise BenchError(f"PySINDy looks {taps} samples back, and a window has {steps}: lengthen the horizon.")
        late = [u[:, taps - d : steps - d] for d in range(taps)]
        late += [y[:, taps - d : steps - d] for d in range(1, taps + 1)]
        x, target = torch.cat(late, -1).flatten(0, 1), y[:, taps:].flatten(0, 1)
        every = -(-len(x) // ROWS)
        x, target = x[::every].double(), target[::every].double()
        library = sindy.PolynomialLibrary(degree=self.entry.degree).fit(x.numpy())
        columns = library.transform(x.numpy())
        least = sindy.STLSQ(threshold=self.entry.threshold, alpha=self.entry.ridge)
        least.fit(columns, target.numpy())
        self.powers.copy_(torch.as_tensor(library.powers_))
        self.coefficients.copy_(torch.as_tensor(least.coef_))

    def weight_count(self) -> int:
        """Number of terms kept."""
        return int(self.coefficients.count_nonzero())


def _installed() -> Any:
    try:
        import pysindy
    except ImportError as error:
        raise BenchError("PySINDy is not installed: pip install pysindy (the extra `peers`).") from error
    return pysindy


@PREDICTORS.register("PySINDy")
@dataclass(frozen=True)
class Sindy(PredictorEntry):
    """Sparse regression on polynomials of past inputs and outputs (SINDy with control, in discrete time), by PySINDy.

    Brunton, Proctor and Kutz (2016), Sparse identification of nonlinear dynamics with control (SINDYc), IFAC 49(18);
    de Silva et al. (2020), PySINDy, JOSS 5(49). Coordinates are delayed samples, for states that nobody measured.
    """

    training: ClassVar[str] = "closed_form"
    stateful: ClassVar[bool] = False

    delays: int = option(2, "taps of each delay line: u_k .. and y_{k−1} ..", unit="samples", low=1, high=20)
    degree: int = option(3, "of the polynomial", low=1, high=5)
    threshold: float = option(
        0.001, "coefficients below it are dropped, scaled units", low=0.0, search=(1e-4, 0.1), log=True
    )
    ridge: float = option(1e-6, "penalty on squared coefficients", low=0.0)

    @override
    def build(self, problem: Problem) -> Predictor:
        return SindyPredictor(self, problem)
