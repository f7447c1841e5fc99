"""ArduPilot's DataFlash files: messages that describe themselves, by name, field and instance.

Each begins with 0xA3 0x95 and the number of its kind; kind 128 (FMT) says of another one its number, its length with
these three bytes, its name, a letter for the type of each field and the fields' names (the letters are listed in
libraries/AP_Logger/LogStructure.h of ArduPilot).
"""

import struct
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from registry.errors import BenchError
from registry.regular_file import regular

HEAD = b"\xa3\x95"
_FMT = 128
_DESCRIPTION = struct.Struct("<BB4s16s64s")
_TYPES = {
    "a": ("<i2", 32, 1.0),
    "b": ("<i1", 0, 1.0),
    "B": ("<u1", 0, 1.0),
    "h": ("<i2", 0, 1.0),
    "H": ("<u2", 0, 1.0),
    "i": ("<i4", 0, 1.0),
    "I": ("<u4", 0, 1.0),
    "f": ("<f4", 0, 1.0),
    "d": ("<f8", 0, 1.0),
    "g": ("<f2", 0, 1.0),
    "n": ("S4", 0, 0.0),
    "N": ("S16", 0, 0.0),
    "Z": ("S64", 0, 0.0),
    "c": ("<i2", 0, 0.01),
    "C": ("<u2", 0, 0.01),
    "e": ("<i4", 0, 0.01),
    "E": ("<u4", 0, 0.01),
    "L": ("<i4", 0, 1e-7),
    "M": ("<u1", 0, 1.0),
    "q": ("<i8", 0, 1.0),
    "Q": ("<u8", 0, 1.0),
}
"""By letter: type, elements where it is an array, and what 1 stands for; 0: a text."""


@dataclass(frozen=True)
class _Kind:
    """What an FMT message says of another kind."""

    name: str
    letters: str
    layout: np.dtype


@dataclass
class DataFlash:
    """The messages of a log."""

    messages: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    """Name → field → (N,), texts as bytes, numbers as they are meant; arrays (N, 32)."""
    parameters: dict[str, float] = field(default_factory=dict)
    """As they were first."""
    skipped: int = 0
    """Bytes that belong to no message: the log is damaged there."""


def read(file: Path, wanted: Collection[str]) -> DataFlash:
    """The ``wanted`` messages of a log, and its parameters.

    Raises:
        BenchError: the file is none, or holds nothing that can be read.
    """
    content = regular(file).read_bytes()
    if not content.startswith(HEAD):
        raise BenchError(f"{file} cannot be read as an ArduPilot log: it does not begin with 0xA3 0x95.")
    kinds, starts, skipped = _messages(content, {*wanted, "PARM"})
    log = DataFlash(skipped=skipped)
    for number, offsets in starts.items():
        kind = kinds[number]
        size = kind.layout.itemsize
        rows = np.frombuffer(b"".join(content[a : a + size] for a in offsets), dtype=kind.layout)
        columns = {n: _meant(rows[n], letter) for n, letter in zip(kind.layout.names or (), kind.letters, strict=True)}
        if kind.name in log.messages:  # described twice, as by a log that goes on
            old = log.messages[kind.name]
            columns = {n: np.concatenate([old[n], x]) for n, x in columns.items() if n in old}
        log.messages[kind.name] = columns
    if not log.messages:
        raise BenchError(f"{file} cannot be read as an ArduPilot log: it holds no message that is known.")
    parameters = log.messages.pop("PARM", {})
    for name, value in zip(parameters.get("Name", ()), parameters.get("Value", ()), strict=False):
        log.parameters.setdefault(bytes(name).decode("latin-1"), float(value))
    return log


def _messages(content: bytes, wanted: Collection[str]) -> tuple[dict[int, _Kind], dict[int, list[int]], int]:
    """The kinds by number, where the contents of each message begin, and how many bytes belong to none."""
    lengths = {_FMT: 3 + _DESCRIPTION.size}
    kinds: dict[int, _Kind] = {}
    starts: dict[int, list[int]] = {}
    at, skipped = 0, 0
    while at + 3 <= len(content):
        number = content[at + 2]
        length = lengths.get(number, 0) if content.startswith(HEAD, at) else 0
        if not length or at + length > len(content):
            after = content.find(HEAD, at + 1)
            after = after if after > 0 else len(content)
            skipped, at = skipped + after - at, after
            continue
        if number == _FMT:
            other, size, kind = _described(content, at + 3)
            if other not in lengths and size > 3:
                lengths[other] = size
                if kind and kind.name in wanted:
                    kinds[other], starts[other] = kind, []
        elif number in starts:
            starts[number].append(at + 3)
        at += length
    return kinds, {number: offsets for number, offsets in starts.items() if offsets}, skipped


def _described(content: bytes, at: int) -> tuple[int, int, _Kind | None]:
    """Number, length and kind of what an FMT message describes; None: its fields are not as its length says."""
    other, size, *texts = _DESCRIPTION.unpack_from(content, at)
    name, letters, labels = (text.split(b"\0")[0].decode("latin-1") for text in texts)
    names = labels.split(",")
    if len(names) != len(letters) or len(set(names)) < len(names) or not all(names) or not set(letters) <= set(_TYPES):
        return other, size, None
    fields = [(n, _TYPES[c][0], (_TYPES[c][1],) if _TYPES[c][1] else ()) for n, c in zip(names, letters, strict=True)]
    layout = np.dtype(fields)
    return other, size, _Kind(name, letters, layout) if layout.itemsize == size - 3 else None


def _meant(values: np.ndarray, letter: str) -> np.ndarray:
    scale = _TYPES[letter][2]
    return values if scale == 0 or letter in "Q" else values.astype(float) * scale
