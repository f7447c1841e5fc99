"""Noise of the states bends the numbers of an equation in which they stand, and is taken off (errors in variables)."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from torch import Tensor

from bench.diagnose.fit import fit_parameters
from bench.diagnose.logs.noise import noise_of
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select import search
from bench.diagnose.select.timing.reading import reread
from bench.diagnose.select.timing.regression import read_at
from registry.contracts import Channel
from registry.dynamics import constant, tensor
from registry.effects.actuation import InputDelay
from registry.physics.state_space import StateSpace
from registry.units import Signal
from tests.diagnose.machines_of_any_size import Array, recorded

TRUTH, RATE = {"gain": 60.0, "viscous": 5.0, "flow": 100.0, "back": 200.0, "leakage": 20.0}, 400.0
"""It swings at 17 Hz."""


@dataclass(frozen=True)
class Cylinder(StateSpace):
    """A piston that a valve's pressure moves."""

    gain: Any = constant(66.0, "g", "m/(s^2 bar)", low=0, uncertainty=0.15)
    viscous: Any = constant(5.5, "b", "1/s", low=0, uncertainty=0.3)
    flow: Any = constant(90.0, "q", "bar/(s V)", low=0, uncertainty=0.15)
    back: Any = constant(220.0, "a", "bar/m", low=0, uncertainty=0.15)
    leakage: Any = constant(15.0, "c", "1/s", low=0, uncertainty=0.5)

    state_channels: ClassVar[tuple[Channel, ...]] = (Channel("speed.rod", "m/s"), Channel("pressure.load", "bar"))
    input_signals: ClassVar[tuple[str, ...]] = ("valve",)
    signals: ClassVar[dict[str, Signal]] = {"pressure": Signal("bar", ("load",)), "valve": Signal("V", ("",))}

    def own_rate(self, state: Tensor, inputs: Tensor) -> Tensor:
        """Of speed [m/s²] and pressure [bar/s]."""
        g, b, q, a, c = (tensor(x, state) for x in (self.gain, self.viscous, self.flow, self.back, self.leakage))
        v, p = state.unbind(-1)
        return torch.stack([g * p - b * v, q * inputs[..., 0] - a * v - c * p], -1)


def run(seed: int, noise: float) -> tuple[Array, Array]:
    """Valve (N,) [V], which holds for a sample, and state (N, 2) [m/s], [bar] by the matrix exponential.

    Args:
        seed: of valve and noise.
        noise: 1σ of the pressure's white noise over its deviation; of the speed a hundredth of that.
    """
    rng, samples = np.random.default_rng(seed), 4000
    g, b, q, a, c = TRUTH.values()
    step = expm(np.array([[-b, g, 0], [-a, -c, q], [0, 0, 0]]) / RATE)
    valve = np.convolve(rng.normal(size=samples), np.ones(20) / 20, "same") * 5
    x = np.zeros((samples, 2))
    for k in range(samples - 1):
        x[k + 1] = (step @ [*x[k], valve[k]])[:2]
    return valve, x + rng.normal(size=x.shape) * x.std(0) * noise * (0.01, 1.0)


def noisy(noise: float) -> Subject:
    """Four recordings, and a model whose numbers are off."""
    model = Cylinder(input_hold="previous")
    return recorded(model, [run(seed, noise) for seed in range(4)], Channel("valve", "V"), RATE)


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_numbers_are_not_bent_by_noise_of_the_states(noise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The viscous part of a drive was 4 to 13 % off, and every interval ten times as wide."""
    subject = noisy(noise)
    told = {x.entry.name: x for x in fit_parameters(subject, subject.model, noise_of(subject))[1]}
    assert all(told[name].low <= true <= told[name].high for name, true in TRUTH.items())
    assert all(x.high - x.low < noise * x.value for x in told.values() if x.entry.name != "viscous")

    monkeypatch.setattr(search, "SEARCHING", replace(search.SEARCHING, bent=np.inf))
    bent = {
        x.entry.name: x for x in fit_parameters(subject, subject.model, noise_of(subject), lambda _: None, False)[1]
    }
    assert not all(bent[name].low <= true <= bent[name].high for name, true in TRUTH.items())


def test_no_more_noise_is_taken_off_than_there_is() -> None:
    """Of a rate read from an encoder's slopes it was: a delay of 22 ms was told as 0 to 270."""
    subject = noisy(0.2)
    told = noise_of(subject)
    much = replace(told, **{of: tuple(12 * sigma for sigma in getattr(told, of)) for of in ("raw", "processed")})
    for x in fit_parameters(subject, subject.model, much)[1]:
        assert x.low <= TRUTH[x.entry.name] <= x.high and x.high - x.low < x.value


def test_a_reading_that_a_lag_undoes_is_read_anew() -> None:
    """Of noisy pressures a held command seemed to act half a sample early, and a delay of as much stood beside it."""
    filed = noisy(0.2)
    filed = replace(filed, model=Cylinder(*TRUTH.values(), input_hold="previous"))
    early = replace(filed, logs=tuple(replace(x, inputs=read_at(x.inputs, 1, 0.5, held=True)) for x in filed.logs))
    noise, late = noise_of(filed), replace(filed.model, effects=(InputDelay(0.5 / RATE),))
    again = reread(filed, replace(early, timed=True), late, noise)
    assert again is not None
    assert all(torch.equal(a.inputs, b.inputs) for a, b in zip(again.logs, filed.logs, strict=True))
    assert reread(filed, again, filed.model, noise) is None
