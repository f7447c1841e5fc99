"""What is said of shifts that are read into the recordings."""

from collections.abc import Sequence

from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.timing.estimate import Shift


def _in_ms(subject: Subject, shift: Shift) -> tuple[str, str]:
    """The size of a shift, and its interval."""
    ms = 1e3 * subject.logs[0].dt
    low, high = sorted(abs(x) * ms for x in (shift.low, shift.high))
    return f"{abs(shift.value) * ms:.3g} ms", f"{low:.3g} to {high:.3g} ms"


def _filed(subject: Subject, shift: Shift) -> str:
    by, between = _in_ms(subject, shift)
    return f"filed {by} ({between}) {'after' if shift.value > 0 else 'before'}"


def held_said(names: Sequence[str]) -> str:
    """Of disturbances that hold between samples."""
    listed = " and ".join(name.replace("_", " ") for name in names)
    return f"The {listed} {'is' if len(names) == 1 else 'are'} best read as what holds from one sample to the next."


def sensor_said(subject: Subject, shift: Shift) -> str:
    """Of a sensor that is late."""
    signal = subject.model.sensed_channels[0].group.replace("_", " ")
    return (
        f"The {signal} is {_filed(subject, shift)} the motion that it shows, and is read so everywhere: a clock or a "
        "filter of the sensor."
    )


def motion_said(subject: Subject, shift: Shift) -> str:
    """Of position and velocity that are late against the attitude."""
    return (
        f"Position and velocity are {_filed(subject, shift)} the attitude that tilts the forces, and are read so "
        "everywhere: a filter, or a clock of its own."
    )


def input_said(subject: Subject, shift: Shift) -> str:
    """Of inputs that act at another time than they are filed."""
    return (
        f"The {_acts(subject, shift, f', {abs(shift.value):.2f} samples')} it is filed, and is read so everywhere: "
        "what happens between two samples, or a clock or filter that is late."
    )


def force_said(subject: Subject, shift: Shift) -> str:
    """Of inputs that act in forces at another time than in torques."""
    return (
        f"In forces the {_acts(subject, shift)} in torques, and the attitude is read with it: an estimator adds up "
        "what it feels, turned by its attitude, each with a delay of its own."
    )


def _acts(subject: Subject, shift: Shift, more: str = "") -> str:
    """Such as "rotor speed acts 1 ms (.9 to 1.1 ms) later than"; ``more`` stands behind the interval."""
    channels = subject.logs[0].recording.input_channels
    signal = channels[0].group.replace("_", " ") if channels else "input"
    by, between = _in_ms(subject, shift)
    return f"{signal} acts {by} ({between}{more}) {'earlier' if shift.value > 0 else 'later'} than"
