"""What a model is to predict from what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from registry.contracts.measurements import Channel


@dataclass(frozen=True)
class Problem:
    """What a model is to predict from what: all that a predictor or an initializer is built from."""

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    horizon: int
    """Prediction length T [samples]."""
    history: int
    """Initialization length τ [samples]."""
    context: tuple[Channel, ...] = ()
    """Measured during the history only: they set initial states and are not predicted."""
    rate: float = 100.0
    """Samples per second [Hz]."""
    system: str = "quadrotor"
    """The registered physics model of what was recorded, its nominal constants, and what inputs do between samples."""
    physics: Mapping[str, Any] = field(default_factory=dict)
    input_hold: str = "linear"
    truth: Any = None
    """The physics model that simulated the recordings, driven by their inputs; None: they were measured."""

    @classmethod
    def plain(cls, n_inputs: int, n_outputs: int, horizon: int, history: int, n_context: int = 0) -> Problem:
        """A problem whose channels have no meaning."""

        def channels(name: str, count: int) -> tuple[Channel, ...]:
            return tuple(Channel(f"{name}.{i}", "1") for i in range(count))

        named = channels("input", n_inputs), channels("output", n_outputs)
        return cls(*named, horizon, history, channels("context", n_context))

    @property
    def n_inputs(self) -> int:
        """m."""
        return len(self.inputs)

    @property
    def n_outputs(self) -> int:
        """n."""
        return len(self.outputs)

    @property
    def n_context(self) -> int:
        """c."""
        return len(self.context)

    @property
    def n_measured(self) -> int:
        """Columns m + n + c of a sample of the history."""
        return self.n_inputs + self.n_outputs + self.n_context
