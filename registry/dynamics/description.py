"""What a diagnosis says about a system: which functions of its states it looks at, and what they are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from registry.contracts import Channel

Signals = dict[str, dict[str, np.ndarray]]
"""By signal, such as "velocity": its functions by their text, such as "v_x", each of one shape (…)."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """One quantity at every instant."""

    name: str
    """As a reader says it."""
    unit: str
    """SI, or "rotor radii"."""
    values: np.ndarray
    """(…)."""


@dataclass(frozen=True, eq=False)
class Axis:
    """A direction along which a model can leave something out."""

    name: str
    """Such as "force x"."""
    rates: np.ndarray
    """(…, channels): what a unit along it adds to the rates of the channels."""
    follows: tuple[str, ...] = ()
    """The signals that what acts along it may follow; none: any."""


def per_second(unit: str) -> str:
    """The unit of a rate of change."""
    return f"{unit}^2" if unit.endswith("/s") else f"{unit}/s"


class Description:
    """Of a system of which nothing is known but its states and inputs: each of them stands for itself.

    Kinds of systems of which more is known say it in a subclass (`PhysicsModel.description`).
    """

    def __init__(self, model: Any) -> None:
        """Of a `PhysicsModel`."""
        self.model = model

    @property
    def located(self) -> tuple[str, ...]:
        """Groups of states whose errors are located, if any of them was measured, else all; here all."""
        return ()

    @property
    def turning(self) -> tuple[str, str] | None:
        """The groups of a unit quaternion and of the rates about the body's axes that turn it; None: no such states."""
        return None

    @property
    def moving(self) -> tuple[str, ...]:
        """The groups that say where a body that turns is and how fast it moves, by a clock of their own; here none."""
        return ()

    def signals(self, state: Tensor) -> Signals:
        """What a missing term could follow, at states (…, s)."""
        found: Signals = {}
        for i, channel in enumerate(self.model.state_channels):
            found.setdefault(channel.group, {})[channel.name] = state[..., i].numpy()
        return found

    def curved(self, signals: Signals) -> tuple[str, ...]:
        """Those of ``signals``, inputs among them, that a term may follow along any curve; here all."""
        return tuple(signals)

    def laws(self, signals: Signals) -> Signals:
        """Functions of ``signals`` that such systems are known to follow, beside powers and products; here none."""
        return {}

    def mixing(self, drives: int) -> np.ndarray | None:
        """(drives, drives): the sums of so many driving channels, a column each, that act apart; None: each does."""
        return None

    def axes(self, state: Tensor, channels: Sequence[int]) -> list[Axis]:
        """The directions along which something may be missing; here the rate of each channel.

        Args:
            state: (…, s).
            channels: places of those that are looked at, among the `measured_channels`.
        """
        found = []
        for i, c in enumerate(channels):
            rates = np.zeros((*state.shape[:-1], len(channels)))
            rates[..., i] = 1.0
            found.append(Axis(f"d {self.model.measured_channels[c].name}/dt", rates))
        return found

    def conditions(
        self, states: Tensor, inputs: Tensor, dt: float, measured: Sequence[bool], drives: Sequence[Channel]
    ) -> list[Quantity]:
        """The conditions in which the system is met, extras not counted.

        Args:
            states: (L, N, s).
            inputs: (L, N, m).
            dt: [s].
            measured: (s,) the states that were measured.
            drives: the driving channels, the first ones of ``inputs``.

        Returns:
            Values (L, N). Here every state and input, its size where it takes both signs, and the change of an input.
        """
        channels = self.model.state_channels
        columns = [(c, states[..., i].numpy()) for i, c in enumerate(channels) if measured[i]]
        columns += [(c, inputs[..., i].numpy()) for i, c in enumerate(drives)]
        groups = [c.group for c, _ in columns]
        found = []
        for channel, values in columns:
            name = channel.group if groups.count(channel.group) == 1 else channel.name
            name = name.replace("_", " ").replace(".", " ")
            found.append(Quantity(name, channel.unit, values))
            if np.nanmin(values) < 0 < np.nanmax(values):
                found.append(Quantity(f"|{name}|", channel.unit, np.abs(values)))
            if channel in drives:
                slope = np.abs(np.gradient(values, dt, axis=1))
                found.append(Quantity(f"change of {name}", per_second(channel.unit), slope))
        return found

    def residuals(self, state: Tensor, inputs: Tensor, rates: Mapping[int, np.ndarray]) -> list[Quantity]:
        """What residual rates mean; here themselves.

        Args:
            state: (J, s).
            inputs: (J, m).
            rates: (J,) by place of a measured state, how much faster it changes than the model says.

        Returns:
            Values (J,).
        """
        channels = [(self.model.state_channels[c], y) for c, y in rates.items()]
        return [Quantity(f"rate of change of {c.name}", per_second(c.unit), y) for c, y in channels]
