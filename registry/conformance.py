"""Tests that a plug-in subclasses to prove itself.

from registry.conformance import EffectConformance

class TestMyEffect(EffectConformance):
    effect = MyEffect
"""

import dataclasses
import math
from typing import Any, ClassVar

import torch
from torch import Tensor

from registry.core import EFFECTS, PHYSICS
from registry.dynamics import Effect, InputEffect, PhysicsModel, in_measure
from registry.units import SIGNALS, exponents, powers_of

_STARTS = {
    "mass_on_rail": (0.013, 0.12),
    "oscillator": (0.13, -0.4),
    "pendulum": (0.7, 1.1),
    "falling_body": (30.0, -12.0),
    "projectile": (0.0, 1.0, 30.0, 7.0, -3.0, 5.0),
    "tanks": (12.0, 9.6),
    "van_der_pol": (1.3, -0.8),
    "lorenz": (-8.0, 7.0, 27.0),
}
"""States of the systems that are no rigid body, at the start of the trajectory."""
_IN_FLIGHT = (0.1, -0.2, 0.35, 1.5, -0.8, 0.4, 0.1, -0.05, 0.2, 0.97, 0.6, -0.7, 0.5)
"""State of a rigid body that moves, turns and is near the ground; its quaternion is normalised before use."""
_EXTRAS = {"battery": (3.9, -2.0), "time": (20.0, 1.0)}
"""At the start of the trajectory, and their time derivatives."""


class EffectConformance:
    """What every effect must be: described, nothing at neutral values, something at typical ones, differentiable."""

    effect: ClassVar[type[Effect]]
    others: ClassVar[tuple[Effect, ...]] = ()
    """Effects that must be in the model beside it (`Effect.requires`)."""
    extras: ClassVar[tuple[str, ...]] = ()
    """Signals beside the driving one that it looks at, "battery" or "time"."""
    visible_after: ClassVar[int] = 5
    """Steps within which a typical effect shows."""
    dt: ClassVar[float] = 0.01
    """Length of a step [s]."""
    start: ClassVar[tuple[float, ...]] = ()
    """State (s,) at the start of the trajectory; empty: one of the system. A system of your own needs it."""

    def model(self, *effects: Effect, **constants: Any) -> PhysicsModel:
        """The first physics model that the effect fits, with effects; override for a system of your own."""
        name = (self.effect.systems or ("quadrotor",))[0]
        made: PhysicsModel = PHYSICS.get(name)(effects=(*effects, *self.others), extras=self.extras, **constants)
        return made

    def trajectory(self) -> tuple[Tensor, Tensor]:
        """The state (s,) at the start, in which an effect shows, and inputs (N, m) that change."""
        model, count = self.model(), self.visible_after + 1
        start = self.start or _STARTS.get(model.system_name(), _IN_FLIGHT)
        assert len(start) == len(model.state_channels), f"start: the state of {model.system_name()} where it shows"
        state = torch.tensor(start, dtype=torch.float64)
        time = self.dt * torch.arange(count, dtype=torch.float64)
        if len(start) == len(_IN_FLIGHT):
            state[6:10] /= state[6:10].norm()
            generator = torch.Generator().manual_seed(3)
            noise = torch.rand(count, 4, generator=generator, dtype=torch.float64)
            inputs = 450 + 100 * noise if model.input_signals[0].startswith("rotor") else noise - 0.5
        else:
            drive = 3.2 * torch.sin(torch.arange(count, dtype=torch.float64) + 0.7)[:, None]
            drive = 4 + drive if model.system_name() == "tanks" else drive
            inputs = drive.expand(-1, model.driving_channels)
        extras = [_EXTRAS[name][0] + _EXTRAS[name][1] * time for name in self.extras]
        return state, torch.cat([inputs, *(e.unsqueeze(-1) for e in extras)], dim=-1)

    def final(self, *effects: Effect, **constants: Any) -> Tensor:
        """The state (s,) at the end of the trajectory."""
        state, inputs = self.trajectory()
        return self.model(*effects, **constants).simulate(state, inputs, self.dt)[-1]

    def test_is_described(self) -> None:
        """Registered, with an equation, the signals that show it, a manoeuvre, and values from which to search."""
        effect, neutral = self.effect, self.effect.neutral()
        assert EFFECTS.get(EFFECTS.name_of(effect)) is effect
        assert effect.equation and effect.manoeuvre, "say how to see it"
        assert effect.needs or issubclass(effect, InputEffect), "name the signals without which it cannot be seen"
        kind = type(self.model())
        assert all(name in SIGNALS or kind.signal(name) for name in effect.needs), "needs: a signal that nobody knows"
        assert all(EFFECTS.get(name) for name in effect.requires) and all(PHYSICS.get(name) for name in effect.systems)
        for name, values in effect.screen.items():
            p = next(p for p in neutral.parameters() if p.name == name)
            assert values, f"screen: no values of {name}"
            assert p.measure or all(_within(v, p.low, p.high) for v in values), f"screen: {name} out of its bounds"

    def test_parameters_are_described(self) -> None:
        """Each with a unit of SI and an explanation; neutral and typical value within the bounds. Options beside."""
        parameters = self.effect.neutral().parameters()
        options = [
            f
            for f in dataclasses.fields(self.effect)
            if "help" in f.metadata and "uncertainty" not in f.metadata and f.default is not None
        ]
        described = sum(f.default is not None for f in dataclasses.fields(self.effect)) - len(options)
        assert len(parameters) == described > 0
        for p in parameters:
            assert p.unit and p.about, f"{p.name} lacks unit or explanation"
            exponents(p.unit)
            assert _within(p.neutral, p.low, p.high) and _within(p.typical, p.low, p.high), (
                f"{p.name} out of its bounds"
            )

    def test_neutral_is_no_effect(self) -> None:
        """The neutral values leave every step as it was, with measured and with held inputs."""
        for hold in ("linear", "previous"):
            bare, neutral = self.final(input_hold=hold), self.final(self.effect.neutral(), input_hold=hold)
            torch.testing.assert_close(neutral, bare, rtol=1e-13, atol=1e-13)

    def test_typical_shows(self) -> None:
        """Typical values change the motion."""
        assert (self.final(self.effect.typical()) - self.final()).abs().max() > 1e-6

    def test_units_do_not_matter(self) -> None:
        """The same machine counted in other units of length, mass and voltage moves alike, and its measures go along.

        A number with a unit that is written into the equation, not a parameter, is right for machines of one size only.
        """
        model, effect, (state, inputs) = self.model(), self.effect.typical(), self.trajectory()
        counted = [{p.name: _times(p.value, _factor(p.unit)) for p in model.parameters()}]
        for e in (effect, *self.others):
            counted.append({p.name: _times(p.value, _factor(model.effect_unit(p.unit))) for p in e.parameters()})
        drive = type(model).signal(model.input_signals[0]) if model.input_signals else None
        driven = [_factor(drive.unit if drive else "1")] * model.driving_channels
        beside = [_factor(SIGNALS[name].unit) if name in SIGNALS else 1.0 for name in self.extras]
        by_state = torch.tensor([_factor(c.unit) for c in model.state_channels], dtype=torch.float64)
        other_state, other_inputs = state * by_state, inputs * torch.tensor([*driven, *beside], dtype=torch.float64)
        effects = [dataclasses.replace(e, **of) for e, of in zip((effect, *self.others), counted[1:], strict=True)]
        other = dataclasses.replace(model, effects=tuple(effects), **counted[0])
        found = other.simulate(other_state, other_inputs, self.dt)[-1] / by_state
        why = "a number with a unit stands in the equation: make it a parameter, or take one of the model's constants"
        torch.testing.assert_close(found, self.final(effect), rtol=1e-8, atol=1e-10, msg=lambda said: f"{why}.\n{said}")
        before, after = (
            {n: float(x.abs().max()) for n, x in m.followed(s, u).items()} | {"time_scale": m.time_scale(s, u)}
            for m, s, u in ((model, state, inputs), (other, other_state, other_inputs))
        )
        for p in (p for p in effect.parameters() if p.measure):
            assert set(powers_of(p.measure)) <= set(before), f"measure: {p.name} is measured in a signal nobody has"
            ratio = in_measure(p, after) / in_measure(p, before)
            assert abs(ratio / _factor(model.effect_unit(p.unit)) - 1) < 1e-9, f"measure: {p.name} has another unit"

    def test_batches(self) -> None:
        """A batch of states, and of parameters, gives what its elements give alone."""
        state, inputs = self.trajectory()
        half = self.effect(**{p.name: p.typical / 2 for p in self.effect.neutral().parameters()})
        both = self.effect(
            **{
                p.name: torch.tensor([p.typical / 2, p.typical], dtype=torch.float64)
                for p in self.effect.neutral().parameters()
            }
        )
        states = self.model(both).simulate(state.expand(2, -1), inputs.expand(2, -1, -1), self.dt)[:, -1]
        expected = torch.stack([self.final(half), self.final(self.effect.typical())])
        torch.testing.assert_close(states, expected, rtol=1e-12, atol=1e-12)

    def test_parameters_with_more_dimensions_than_the_signals(self) -> None:
        """Numbers (3, 1), those of the model too, and states (2, s) give rates (3, 2, s), each as it comes alone.

        So a search tries many models on one recording. Own states (3, 2, i) have the dimensions of both. Systems whose
        equations do not broadcast, and effects of the input, are given states of the dimensions of the numbers.
        """
        if not self.model().broadcasts or issubclass(self.effect, InputEffect):
            return
        state, inputs = self.trajectory()
        states, own = torch.stack([state, self.final(self.effect.typical())]), self.effect.internal_size
        slopes, shares = inputs.diff(dim=0)[:2] / self.dt, (0.5, 0.75, 1.0)
        typical = {p.name: p.typical for p in self.effect.neutral().parameters()}
        constants = {p.name: p.value for p in self.model().parameters() if p.uncertainty > 0 and _is_number(p.value)}

        def rates(states: Tensor, share: Any) -> Tensor:
            effect, stated = ({n: share * v for n, v in of.items()} for of in (typical, constants))
            return self.model(self.effect(**effect), **stated).derivative(states, inputs[:2], slopes)

        inner = 0.1 * torch.arange(1, 6 * own + 1, dtype=torch.float64).reshape(3, 2, own)
        every = torch.cat([states.expand(3, 2, -1), inner], dim=-1)
        found = rates(every if own else states, torch.tensor(shares, dtype=torch.float64).unsqueeze(-1))
        alone = torch.stack([rates(of, share) for of, share in zip(every, shares, strict=True)])
        torch.testing.assert_close(found.expand(3, 2, -1), alone, rtol=1e-12, atol=1e-12)

    def test_gradients(self) -> None:
        """Exact gradients with respect to state, inputs and parameters."""
        state, inputs = self.trajectory()
        if not issubclass(self.effect, InputEffect):
            inputs = inputs[:3]
        names = [p.name for p in self.effect.neutral().parameters()]
        # Off the nodes of a piecewise linear interpolation, where a numerical gradient means nothing.
        shift = 1.137 if issubclass(self.effect, InputEffect) else 1.0
        values = [
            torch.tensor(p.typical * shift, dtype=torch.float64, requires_grad=True)
            for p in self.effect.neutral().parameters()
        ]
        scale = torch.tensor([p.typical for p in self.effect.neutral().parameters()], dtype=torch.float64).abs()

        def run(first: Tensor, driven: Tensor, *relative: Tensor) -> Tensor:
            scaled = {n: r * s for n, r, s in zip(names, relative, scale, strict=True)}
            return self.model(self.effect(**scaled)).simulate(first, driven * 100, self.dt)[-1]

        relative = [(v.detach() / s).requires_grad_() for v, s in zip(values, scale, strict=True)]
        first, driven = state.clone().requires_grad_(), (inputs / 100).requires_grad_()
        assert torch.autograd.gradcheck(run, (first, driven, *relative), eps=1e-6, atol=1e-5, rtol=1e-4)

    def test_neutral_has_gradients(self) -> None:
        """Finite ones: a fit starts there."""
        neutral = {p.name: torch.tensor(p.neutral, dtype=torch.float64) for p in self.effect.neutral().parameters()}
        for value in neutral.values():
            value.requires_grad_()
        self.final(self.effect(**neutral)).sum().backward()
        for name, value in neutral.items():
            assert value.grad is None or value.grad.isfinite(), f"{name} has no gradient at its neutral value"


_COUNTED = {"m": 0.01, "kg": 30.0, "N": 0.3, "V": 7.0}
"""How many of them a unit is, counted in others: of length, mass and voltage."""


def _factor(unit: str) -> float:
    """What values in a unit are multiplied by where it is counted in other ones."""
    return math.prod(_COUNTED.get(symbol, 1.0) ** power for symbol, power in powers_of(unit).items())


def _times(value: Any, factor: float) -> Any:
    """A number or a nested tuple of numbers, multiplied."""
    return tuple(_times(v, factor) for v in value) if isinstance(value, tuple) else value * factor


def _is_number(value: Any) -> bool:
    """Whether it is neither a vector nor a tensor."""
    return isinstance(value, (int, float))


def _within(value: float, low: float | None, high: float | None) -> bool:
    return (low is None or value >= low) and (high is None or value <= high)
