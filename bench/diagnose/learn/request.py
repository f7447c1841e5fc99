"""What a user asks for: "learned", or an axis and what it follows, such as "force_z ~ height"."""

import re

from bench.diagnose.learn.candidates import Pair, dynamic_axes
from bench.diagnose.learned_shape import RELAXATION, SWING, WAVE
from registry.dynamics import PhysicsModel
from registry.errors import BenchError, near
from registry.terms import signals

LEARNED = "learned"
"""Asks for whatever terms held-out recordings confirm."""
_ALIASES = {"position.z": "height", "speed": "airspeed"}


def is_request(text: str) -> bool:
    """Whether an argument asks for a learned term rather than for an effect of the catalogue."""
    return text == LEARNED or "~" in text


def parsed(text: str, model: PhysicsModel) -> Pair | None:
    """The axis and signals that "axis ~ signal", "axis ~ signal * signal" or "axis ~ wave" asks for; None of "learned".

    A "swing" or "relaxation" is a hidden mode; of the axes along which one acts, the first is enough.

    Raises:
        BenchError: an axis or a signal that the model does not have.
    """
    if text == LEARNED:
        return None
    left, _, right = text.partition("~")
    left = left.partition(",")[0]
    axis = _named(left, dynamic_axes(model), f"--add {text!r}: {type(model).system_name()} has no axis")
    if right.strip() in (WAVE, SWING, RELAXATION):
        return Pair(axis, (right.strip(),))
    known = list(signals.available(model))
    names = tuple(_named(s, known, f"--add {text!r}: there is no signal") for s in right.split("*"))
    if len(names) > 2:
        raise BenchError(f"--add {text!r}: a term follows one signal, or is a function of one times another.")
    return Pair(axis, names)


def _named(text: str, known: list[str], what: str) -> str:
    """One of the known names: as it is, with spaces, or by its first or last part where that is enough."""
    asked = re.sub(r"\s*([+-])\s*", r"\1", text.strip()).replace(" ", "_")
    if asked in known:
        return asked
    if _ALIASES.get(asked) in known:
        return _ALIASES[asked]
    fitting = [n for n in known if asked and (asked == n.replace(".", "_") or asked in n.split("."))]
    if len(fitting) == 1:
        return fitting[0]
    raise BenchError(f"{what} {text.strip()!r}: {near(asked, known)}")
