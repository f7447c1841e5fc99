"""What a case of the unknown is like."""

from dataclasses import dataclass

from bench.score.case import Case
from bench.score.unknown.terms import Term

KINDS = (
    "spring",
    "wall",
    "place_lift",
    "cross",
    "dead_zone",
    "taken_out",
    "periodic",
    "drift",
    "load",
    "slosh",
    "motors",
    "twisted",
)
"""What is hidden, one way or another; each is a condition of its own, so that a fraction holds some of all."""
EMPTY = ("empty", "blown", "undersampled")
"""Conditions in which nothing is hidden: white noise, gusts, inputs that change faster than they are logged."""
SWINGS = ("periodic", "load", "slosh")
"""What follows no measured signal and has a frequency."""
STATIC = tuple(k for k in KINDS if k not in (*SWINGS, "twisted"))
"""What is a function of measured signals."""


@dataclass(frozen=True)
class UnknownCase(Case):
    """A `Case` of any system; ``effects`` and ``catalogue_without`` hold what is taken out of the catalogue."""

    system: str = "quadrotor"
    """Or "oscillator", "tanks", "cart"."""
    terms: tuple[Term, ...] = ()
    """What acts beside the nominal model, as functions of signals."""
    told: tuple[Term, ...] = ()
    """What acts in another way (through ``effects``), as functions of signals."""
    swing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of what is periodic, hangs or sloshes: frequency [Hz], size (force over weight, mass ratio, …), damping."""
    frequencies: tuple[float, ...] = ()
    """Right answers [Hz]: what hangs swings otherwise where its suspension is held than where it moves."""
    wave_axis: str = ""
    """Along which a periodic force pushes."""
    twist: float = 0.0
    """Angle by which sensors are turned about body z [rad]."""
    rate: float = 100.0
    """Of the log [Hz]."""

    @property
    def truth(self) -> tuple[Term, ...]:
        """Terms that must be said."""
        return (*self.terms, *self.told)
