"""The binary log that a Crazyflie writes on its memory card (Bitcraze usd-log, versions 1 and 2).

Little-endian: 0xBC, version and number of kinds of events (uint16 each); of every kind its number (uint16), its name,
the number of its variables (uint16) and for each "name(type)", texts ending in a zero byte and types those of
`struct`; then events: number of the kind (uint16), time (uint32 [ms] in version 1, uint64 [µs] in version 2), values;
CRC-32 of everything before it.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from registry.datasets.logs.table import Table
from registry.errors import BenchError
from registry.regular_file import regular

START = 0xBC
_STAMPS = {1: (struct.Struct("<HI"), 1e-3), 2: (struct.Struct("<HQ"), 1e-6)}
"""By version: what precedes the values of an event, and what 1 of its time is [s]."""
_TYPES = frozenset("bBhHiIfd")
Layout = tuple[str, np.dtype]
"""Name of a kind of event, and its variables."""


def read_usd_log(file: Path, event: str = "fixedFrequency") -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (N,) [s], from the vehicle's start, and the variables (N,) of one kind of event, as the firmware has them.

    Raises:
        BenchError: the file is damaged, cut short, of another version or holds no such event.
    """
    tables, whole = read_usd_events(file)
    if not whole:
        raise BenchError(f"{file} is damaged (its checksum does not fit its contents): download it again.")
    if event not in tables:
        raise BenchError(f"{file} holds no {event} samples.")
    return tables[event].t, dict(tables[event].columns)


def read_usd_events(file: Path) -> tuple[dict[str, Table], bool]:
    """The events of a log by kind, and whether the log is whole; that of a vehicle that lost power ends anywhere.

    Raises:
        BenchError: the file is no such log, damaged or of another version.
    """
    content = regular(file).read_bytes()
    if len(content) < 9 or content[0] != START:
        raise BenchError(f"{file} is not a Crazyflie log: it does not begin with 0xBC.")
    version, kinds = struct.unpack_from("<HH", content, 1)
    if version not in _STAMPS:
        raise BenchError(f"{file} is a Crazyflie log of version {version}: only versions 1 and 2 can be read.")
    stamp, tick = _STAMPS[version]
    whole = zlib.crc32(content[:-4]) == int.from_bytes(content[-4:], "little")
    end = len(content) - 4 if whole else len(content)
    try:
        layouts, at = _layouts(content, kinds)
        starts: dict[int, list[int]] = {code: [] for code in layouts}
        while at < end - stamp.size:
            (code,) = struct.unpack_from("<H", content, at)
            size = stamp.size + layouts[code][1].itemsize
            if at + size <= end:
                starts[code].append(at)
            at += size
        if whole and at != end:
            raise ValueError("its last event is cut short")
    except (struct.error, KeyError, ValueError) as error:
        raise BenchError(
            f"{file} is damaged ({type(error).__name__}: {error}): copy it from the card again."
        ) from error
    tables = {}
    for code, offsets in starts.items():
        name, variables = layouts[code]
        if offsets:
            row = np.dtype([("", "<u2"), ("stamp", f"<u{stamp.size - 2}"), ("values", variables)])
            rows = np.frombuffer(b"".join(content[a : a + row.itemsize] for a in offsets), dtype=row)
            columns = {v: rows["values"][v].astype(float) for v in variables.names or ()}
            tables[name] = Table(rows["stamp"] * tick, columns, source=name)
    return tables, whole


def _layouts(content: bytes, kinds: int) -> tuple[dict[int, Layout], int]:
    """Name and variables of each kind of event, and where the events begin."""
    layouts: dict[int, Layout] = {}
    at = 5

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
        types = {kind for _, _, kind in described}
        if not types <= _TYPES:
            raise ValueError(f"variables of unknown type {sorted(types - _TYPES)}")
        layouts[code] = (name, np.dtype([(variable, f"<{kind}") for variable, _, kind in described]))
    return layouts, at
