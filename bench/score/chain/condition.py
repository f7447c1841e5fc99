"""What a case of the second chain is like: what is hidden, how it is flown and logged."""

from dataclasses import dataclass

from bench.score.case import Case

UNDETERMINED = ("rotor_reaction_torque.rotor_inertia", "rotational_damping.d_z", "torque_bias.t_z")
"""Parameters that flights tell only relative to the yaw inertia: of no true value where that is stated roughly."""


@dataclass(frozen=True)
class ChainCase(Case):
    """A `Case` that the second chain flies; ``noise`` is of `sensors.QUALITIES`, ``style`` of `paths.MANNERS`."""

    vehicle: str = "survey"
    control_hz: int = 250
    log_hz: int = 100
    lag: tuple[float, float] = (0.02, 0.02)
    """Time constants of the motors up and down [s], where neither `motor_lag` nor `input_delay` is hidden."""
    states: str = "capture"
    clock: str = "even"
    jitter: float = 0.1
    telemetry: float = 0.0
    accelerometer: bool = False
    turbulence: float = 0.0
    """Mean wind at 20 feet that the gusts belong to [m/s]; 0: none. The mean itself does not blow."""
    rough: bool = False
    """Whether stated constants are far off."""

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters whose error is not asked for, as effect.parameter."""
        return UNDETERMINED if self.rough else ()
