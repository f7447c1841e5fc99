"""A syringe that leaks as through an orifice: a dead zone was named beside a needle as narrow as it may be."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from torch import Tensor

from bench.diagnose import diagnose
from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.effects.learned_term import LearnedTerm
from registry.physics.state_space import StateSpace
from registry.units import Signal
from tests.diagnose.machines_of_any_size import recorded

COMPLIANCE, RESISTANCE, LEAK, RATE = 0.0091, 14.6, 0.08, 10.0
"""[mL/kPa], [kPa min/mL], [mL/(min √kPa)] and [Hz]."""


@dataclass(frozen=True)
class Syringe(StateSpace):
    """A soft volume that a plunger fills and a needle empties."""

    compliance: Any = constant(0.0102, "C", "mL/kPa", low=1e-9, uncertainty=0.1)
    resistance: Any = constant(15.0, "R", "kPa min/mL", low=1e-6, uncertainty=0.03)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("pressure.syringe", "kPa"),)
    input_signals: ClassVar[tuple[str, ...]] = ("flow",)
    signals: ClassVar[dict[str, Signal]] = {"pressure": Signal("kPa", ("syringe",)), "flow": Signal("mL/min", ("",))}
    equation: ClassVar[str] = "60 C dp/dt = Q - p / R"

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Rate of the pressure (…, 1) [kPa/s]."""
        c, r = (tensor(v, state).unsqueeze(-1) for v in (self.compliance, self.resistance))
        return (inputs[..., :1] - state / r) / (60 * c)


def run(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Flow (N,) [mL/min], which holds for a sample, and pressure (N, 1) [kPa], by Euler's method."""
    rng, fine = np.random.default_rng(seed), 50
    flow = np.repeat(rng.uniform(0.0, 9.0, 28), 80)
    p = [15 * float(flow[0])]
    for q in flow[:-1]:
        now = p[-1]
        for _ in range(fine):
            now += (q - now / RESISTANCE - LEAK * np.sqrt(now)) / (60 * COMPLIANCE) / RATE / fine
        p.append(now)
    return flow, np.array(p)[:, None] + 0.05 * rng.normal(size=(len(p), 1))


def test_what_an_effect_explains_beside_a_constant_at_its_bound_is_sought_without_it() -> None:
    subject = recorded(Syringe(input_hold="previous"), [run(s) for s in range(5)], Channel("flow", "mL/min"), RATE)
    told, model = diagnose(subject, brief=True)
    (term,) = model.effects
    assert isinstance(term, LearnedTerm) and term.shape == "root"
    assert term.values[0] == pytest.approx(-LEAK / (60 * COMPLIANCE), rel=0.05)
    syringe: Any = model
    assert (syringe.compliance, syringe.resistance) == (
        pytest.approx(COMPLIANCE, rel=0.01),
        pytest.approx(14.6, rel=0.01),
    )
    error, floor = (e["pressure"].rmse for e in (told.error.extended, told.noise_floor))
    assert error < 1.1 * floor
