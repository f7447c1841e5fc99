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
    """What an effect saves of one equation's squared error, along one axis of it or as a whole, on held-out recordings.

    All else is fitted anew without the effect. Shares are of the explainable error: the squared error of the calibrated
    model less that of the best predictor.
    """

    equation: str
    axis: str
    """Such as "torque z"; empty: the equation as a whole."""
    horizon_s: float
    share: float
    """At most 1, with its 95 % interval over blocks of recordings."""
    low: float
    high: float
    matters: bool = True
    """Whether the explainable error is large enough that anything is worth a term."""
    worth: bool = False
    """Whether the share is large enough, and sure, to name the effect for it."""

    @property
    def where(self) -> str:
        """Equation and axis, as `NamedEffect.acts_on` has them."""
        return f"{self.equation}: {self.axis}" if self.axis else self.equation


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


@dataclass(frozen=True)
class GivenPast:
    """What inputs do beside a slow disturbance that its past tells, where held-out recordings confirm it."""

    numbers: dict[str, tuple[float, str]]
    """By name such as "inertia[0]" or "motor_lag.tau_up", SI: value and unit. No interval: what a controller answers
    within a row of the regression moves them by more than their noise."""
    saves: float
    """Squared error of the equation, given the past, that it saves of that of the model that was fitted without."""
    low: float
    high: float
    """95 % over blocks of held-out recordings."""
    horizon_s: float


@dataclass(frozen=True)
class InverseDynamics:
    """What an input works against, where forwards it seems to do nothing: the input regressed on measured motion."""

    effect: str
    """Id of the dry friction."""
    drive: str
    """The input in words, such as "torque"."""
    friction: tuple[float, float, float]
    """Its one number, with the ends of its 95 % interval."""
    unit: str
    mass: tuple[float, float, float]
    """What the input moves, of what was stated, with the same."""
    saves: float
    """Squared input that it explains of what the model leaves of it, on recordings left out one by one."""
    low: float
    high: float
    """95 % over these recordings."""


@dataclass(frozen=True)
class ObscuredConstant:
    """A constant that was let go and went where no such system has it: these recordings hide it."""

    constant: str
    times: float
    """What the recordings would make of it, of what was stated; of a vector the component that goes furthest."""
    equation: str
    """The one that it acts in most, such as "torques"."""
    group: str
    """The states that this equation moves."""
    finer: str = ""
    """The option of the data set with which these states are measured more finely; empty: there is none."""
    repeats: float = 0.0
    """Share of what the constant as stated leaves of this equation that its own past tells, if that is slow; else 0."""
    told: GivenPast | None = None
    """What is told of it nevertheless."""
