"""The paper's notation of a configuration, read and written: "LSTM: 2x50 - MLP: 100x10".

predictor [": " layers "x" hidden] [" - " initializer ": " [hidden "x"] history]
"""

import re
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from registry.core import INITIALIZERS, PREDICTORS, check_options
from registry.errors import BenchError

if TYPE_CHECKING:  # they load torch, and a wrong name is to be said at once
    from registry.contracts import InitializerEntry, PredictorEntry

EXAMPLE = "such as 'LSTM: 1x50 - MLP: 60x10' or 'LSTM: 1x50 - Washout: 10'"
_NUMBER = re.compile(r"\d{1,9}")


def _sizes(text: str, start: int, spec: str, names: tuple[str, ...]) -> list[int]:
    """Numbers of "2x50" or "10"; an error points at the first wrong character."""
    pieces = re.split(r"([x×X])", text)
    sizes, at = [], start
    for piece in pieces[::2]:
        stripped = piece.strip()
        if not _NUMBER.fullmatch(stripped) or int(stripped) == 0:
            column = at + len(piece) - len(piece.lstrip()) + 1
            raise BenchError(
                f"{spec!r}, character {column}: {stripped!r} should be a positive whole number, {EXAMPLE}."
            )
        sizes.append(int(stripped))
        at += len(piece) + 1
    if len(sizes) != len(names):
        raise BenchError(f"{spec!r}, character {start + 1}: expected {' x '.join(names)}, {EXAMPLE}.")
    return sizes


def _part(text: str, start: int, spec: str) -> tuple[str, str | None, int]:
    """ "name: sizes" → name, sizes or None, where the sizes start in ``spec``."""
    name, colon, sizes = text.partition(":")
    if not name.strip():
        raise BenchError(f"{spec!r}, character {start + 1}: a name is missing, {EXAMPLE}.")
    return " ".join(name.split()), sizes if colon else None, start + len(name) + 1


def parse(spec: str) -> "tuple[PredictorEntry, InitializerEntry | None]":
    """Predictor and initializer that ``spec`` names; × or x, spaces free, sizes left out are the defaults.

    Raises:
        BenchError: what is wrong and at which character, or the near names of one that is unknown.
    """
    if not spec.strip():
        raise BenchError(f"The configuration is empty: write one {EXAMPLE}.")
    pieces = re.split(r"\s+[-–]\s+|(?<=\d)\s*[-–]\s*(?=[A-Za-z])", spec)
    if len(pieces) > 2:
        raise BenchError(f"{spec!r} has {len(pieces)} parts: one predictor and one initializer, {EXAMPLE}.")
    name, sizes, at = _part(pieces[0], 0, spec)
    kind = PREDICTORS.get(name)
    predictor: Any = kind()
    if sizes is not None:
        if not kind.network:
            own = next(
                (f": options are set by name, as in --set predictor.{f.name}={f.default}" for f in fields(kind)), ""
            )
            raise BenchError(f"{spec!r}, character {at + 1}: {PREDICTORS.name_of(kind)!r} has no size{own}.")
        layers, hidden = _sizes(sizes, at, spec, ("layers", "hidden"))
        predictor = replace(predictor, layers=layers, hidden=hidden)
    check_options(predictor, PREDICTORS.name_of(kind))
    if len(pieces) == 1:
        if kind.stateful:
            raise BenchError(f"{spec!r} names no initializer: write one {EXAMPLE}.")
        return predictor, None
    if not kind.stateful:
        raise BenchError(
            f"{spec!r}: {PREDICTORS.name_of(kind)!r} has no states to initialize; leave the initializer out."
        )
    start = spec.rindex(pieces[1])
    name, sizes, at = _part(pieces[1], start, spec)
    made = INITIALIZERS.get(name)
    initializer: Any = made()
    if sizes is not None:
        if made.sized:
            width, history = _sizes(sizes, at, spec, ("hidden", "history"))
            initializer = replace(initializer, hidden=width, history=history)
        else:
            (history,) = _sizes(sizes, at, spec, ("history",))
            initializer = replace(initializer, history=history)
    check_options(initializer, INITIALIZERS.name_of(made))
    return predictor, initializer


@dataclass(frozen=True)
class Label:
    """What a configuration in writing says, for those who need not have what it names."""

    predictor: str
    size: str
    """Such as "2x50"; empty where it has none."""
    initializer: str
    """Empty where there is none."""
    history: int | None
    """Initialization length τ; None without an initializer."""

    @property
    def trained(self) -> bool:
        """Whether seeds matter: there are sizes, or states to initialize. Baselines have neither."""
        return bool(self.size or self.initializer)


def label(spec: str) -> Label:
    """The parts of a configuration as `write` writes it."""
    predictor, _, initializer = spec.partition(" - ")
    predictor, _, size = predictor.partition(": ")
    initializer, _, sizes = initializer.partition(": ")
    length = sizes.rpartition("x")[2]
    return Label(predictor, size, initializer, int(length) if length.isdecimal() else None)


def write(predictor: "PredictorEntry", initializer: "InitializerEntry | None") -> str:
    """The notation of a pair: ``parse(write(p, i))`` gives the same sizes."""
    text = PREDICTORS.name_of(type(predictor))
    if predictor.network:
        text += f": {getattr(predictor, 'layers')}x{getattr(predictor, 'hidden')}"  # noqa: B009
    if initializer is None:
        return text
    sized = f"{getattr(initializer, 'hidden')}x" if initializer.sized else ""  # noqa: B009
    return f"{text} - {INITIALIZERS.name_of(type(initializer))}: {sized}{initializer.history}"
