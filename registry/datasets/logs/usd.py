"""The binary log that a Crazyflie writes on its memory card (Bitcraze usd-log, version 2)."""

import struct
import zlib
from pathlib import Path

import numpy as np

from registry.errors import BenchError

_START, _VERSION = 0xBC, 2
_TYPES = frozenset("bBhHiIfd")


def read_usd_log(file: Path, event: str = "fixedFrequency") -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (N,) [s], from the vehicle's start, and the variables (N,) of one kind of event, as the firmware has them.

    Raises:
        BenchError: the file is damaged, of another version or holds no such event.
    """
    content = file.read_bytes()
    if len(content) < 9 or content[0] != _START:
        raise BenchError(f"{file} is not a Crazyflie log: it does not begin with 0xBC.")
    version, kinds = struct.unpack_from("<HH", content, 1)
    if version != _VERSION:
        raise BenchError(f"{file} is a Crazyflie log of version {version}: only version {_VERSION} can be read.")
    if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
        raise BenchError(f"{file} is damaged (its checksum does not fit its contents): download it again.")
    try:
        layouts, at = _layouts(content, kinds)
        times, rows, names = [], [], []
        while at < len(content) - 4:
            code, stamp = struct.unpack_from("<HQ", content, at)
            name, variables, layout = layouts[code]
            values = layout.unpack_from(content, at + 10)
            at += 10 + layout.size
            if name == event:
                times.append(1e-6 * stamp)
                rows.append(values)
                names = variables
    except (struct.error, KeyError, ValueError) as error:
        raise BenchError(f"{file} is damaged ({error}): download it again.") from error
    if not rows:
        raise BenchError(f"{file} holds no {event} samples.")
    table = np.array(rows, dtype=float)
    return np.array(times), {name: table[:, i] for i, name in enumerate(names)}


def _layouts(content: bytes, kinds: int) -> tuple[dict[int, tuple[str, list[str], struct.Struct]], int]:
    """Name, variables and layout of each kind of event, and where the events begin."""
    layouts, at = {}, 5

    def text() -> str:
        nonlocal at
        end = content.index(0, at)
        found, at = content[at:end].decode("ascii"), end + 1
        return found

    for _ in range(kinds):
        (code,) = struct.unpack_from("<H", content, at)
        at += 2
        name = text()
        (count,) = struct.unpack_from("<H", content, at)
        at += 2
        described = [text().rstrip(")").partition("(") for _ in range(count)]
        types = [kind for _, _, kind in described]
        if not set(types) <= _TYPES:
            raise ValueError(f"variables of unknown type {sorted(set(types) - _TYPES)}")
        layouts[code] = (name, [variable for variable, _, _ in described], struct.Struct("<" + "".join(types)))
    return layouts, at
