"""What a diagnosis says of every equation by itself, and of the constants of the base model."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EquationResult:
    """Root mean square errors of one equation on held-out recordings, everything else as measured. SI."""

    output: str
    """The group of states that the equation moves, such as "velocity" for the forces."""
    horizon_s: float
    unit: str
    nominal: float
    calibrated: float
    extended: float
    """Of the model with the effects that were named; without any, of the calibrated one."""
    predictable: float
    """What the best predictor leaves: the model helped by a regression on every measured signal."""
    floor: float
    """What measurement noise alone leaves."""


@dataclass(frozen=True)
class EffectSaving:
    """What an effect saves of one equation's squared error on held-out recordings."""

    equation: str
    share: float
    """Of what can be explained there, at most 1, with its 95 % interval over blocks of recordings."""
    low: float
    high: float
    matters: bool = True
    """Whether enough can be explained in this equation that anything is worth a term."""


@dataclass(frozen=True)
class ConstantEstimate:
    """A constant of the base model as it was stated and as the last fit has it, SI, with its 95 % interval."""

    stated: float
    value: float
    low: float
    high: float
    unit: str
    determined: bool
    """Whether the recordings narrowed it to less than half the 95 % interval of what was stated."""
