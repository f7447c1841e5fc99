"""ULog files as docs.px4.io/main/en/dev_log/ulog_file_format.html describes them: topics and parameters.

A header of 16 bytes, then messages: size of the content (uint16), a letter for its type, the content. Everything is
little-endian; topics are described by messages of type F and named by those of type A.
"""

import math
import re
import struct
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from registry.errors import BenchError
from registry.regular_file import regular

_MAGIC = b"ULog\x01\x12\x35"
_HEADER = 16
_TYPES = {f"{'u' * (k == 'u')}int{8 * n}_t": f"<{k}{n}" for k in "iu" for n in (1, 2, 4, 8)}
_TYPES |= {"float": "<f4", "double": "<f8", "bool": "?", "char": "S1"}
_FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
_LARGEST = 65535
"""Bytes of a message, by its size field."""
_DEEPEST = 8
"""Types within each other."""
_APPENDED = 1
"""The flag of data that were written behind the end, after a crash."""


@dataclass
class ULog:
    """The topics and parameters of a log."""

    topics: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    """Topic → field → (N,); elements of an array are "q[0]", "q[1]", …; of several instances the first."""
    parameters: dict[str, float] = field(default_factory=dict)
    """As they were at the start."""
    dropped: float = 0.0
    """Time in which the card was too slow, and messages were lost [s]."""
    whole: bool = True
    """Whether the file ends with a whole message."""


def read(file: Path, wanted: Collection[str]) -> ULog:
    """The ``wanted`` topics of a log, and its parameters.

    Raises:
        BenchError: the file is none, of a version that must not be read so, or damaged.
    """
    content = regular(file).read_bytes()
    if len(content) < _HEADER or not content.startswith(_MAGIC):
        raise BenchError(f"{file} cannot be read as a PX4 ULog: it does not begin as one.")
    try:
        return _read(content, wanted)
    except (struct.error, ValueError, KeyError, IndexError, OverflowError) as error:
        raise BenchError(f"{file} cannot be read as a PX4 ULog: it is damaged ({error}).") from error


def _read(content: bytes, wanted: Collection[str]) -> ULog:
    log, formats = ULog(), dict[str, str]()
    names: dict[int, tuple[str, int]] = {}
    rows: dict[int, list[bytes]] = {}
    at, ends = _HEADER, [len(content)]
    while ends:
        while at + 3 <= ends[0]:
            size, kind = struct.unpack_from("<Hc", content, at)
            body, at = content[at + 3 : at + 3 + size], at + 3 + size
            if at > ends[0]:
                log.whole = log.whole and len(ends) > 1  # a message that a crash cut stands before appended data
            elif kind == b"D":
                number = int.from_bytes(body[:2], "little")
                if number in rows:
                    rows[number].append(body[2:])
            elif kind == b"F":
                name, _, described = body.decode("utf-8").partition(":")
                formats[name] = described
            elif kind == b"A":
                name, number = body[3:].decode("utf-8"), int.from_bytes(body[1:3], "little")
                if name in wanted and number not in rows:
                    names[number], rows[number] = (name, body[0]), []
            elif kind == b"P":
                _parameter(body, log.parameters)
            elif kind == b"O":
                log.dropped += 1e-3 * int.from_bytes(body[:2], "little")
            elif kind == b"B":
                ends = _sections(body, len(content))
        at = ends.pop(0)
    for number, (name, _) in sorted(names.items(), key=lambda item: item[1][1]):
        if name not in log.topics and rows[number]:
            log.topics[name] = _columns(_layout(name, formats, {}), rows[number])
    return log


def _sections(flags: bytes, size: int) -> list[int]:
    """Where the sections of a file end, by its flags."""
    if len(flags) < 40:
        raise ValueError("its flags are cut short")
    if any(flags[9:16]) or flags[8] & ~_APPENDED:
        raise ValueError("it needs a newer reader")
    offsets = [o for o in struct.unpack_from("<3Q", flags, 16) if o] if flags[8] & _APPENDED else []
    if offsets != sorted(offsets) or any(not _HEADER < o < size for o in offsets):
        raise ValueError("data are appended at no place in it")
    return [*offsets, size]


def _parameter(body: bytes, found: dict[str, float]) -> None:
    """Put a parameter into ``found`` unless an earlier one of its name is there."""
    kind, _, name = body[1 : 1 + body[0]].decode("ascii").partition(" ")
    form = {"int32_t": "<i", "float": "<f"}.get(kind)
    if form and name not in found:
        found[name] = float(struct.unpack_from(form, body, 1 + body[0])[0])


def _layout(name: str, formats: dict[str, str], known: dict[str, np.dtype], depth: int = 0) -> np.dtype:
    """The fields of a topic; padding at its end is not written and left out."""
    if name in known:
        return known[name]
    if depth > _DEEPEST:
        raise ValueError(f"types within each other, more than {_DEEPEST} deep")
    fields: list[tuple[str, Any, tuple[int, ...]]] = []
    for text in filter(None, formats[name].split(";")):
        match = _FIELD.fullmatch(text)
        if not match:
            raise ValueError(f"{name} has a field {text!r:.40}")
        kind, count, label = match.groups()
        inner = _TYPES[kind] if kind in _TYPES else _layout(kind, formats, known, depth + 1)
        fields.append((label, inner, (int(count),) if count else ()))
    while depth == 0 and fields and fields[-1][0].startswith("_padding"):
        fields.pop()
    if not 0 < sum(np.dtype(inner).itemsize * math.prod(shape) for _, inner, shape in fields) <= _LARGEST:
        raise ValueError(f"{name} is larger than a message, or empty")
    out = np.dtype(fields)
    if depth:
        known[name] = out
    return out


def _columns(layout: np.dtype, rows: list[bytes]) -> dict[str, np.ndarray]:
    """The fields (N,) of rows that are as long as the layout says."""
    size = layout.itemsize
    table = np.frombuffer(b"".join(row[:size] for row in rows if len(row) >= size), dtype=layout)
    out: dict[str, np.ndarray] = {}
    _flatten("", table, out)
    return out


def _flatten(name: str, values: np.ndarray, out: dict[str, np.ndarray]) -> None:
    """Put the fields and elements of ``values`` (N, …) into ``out`` as "esc[0].esc_rpm"."""
    if values.ndim > 1:
        for i in range(values.shape[1]):
            _flatten(f"{name}[{i}]", values[:, i], out)
    elif values.dtype.names:
        for inner in values.dtype.names:
            _flatten(f"{name}.{inner}" if name else inner, values[inner], out)
    else:
        out[name] = values
