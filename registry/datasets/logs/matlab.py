"""MATLAB files of logs: structs with a time, nested or in arrays, plain variables, Simulink's structures with time.

Versions 5 to 7 and 7.3; only numbers, texts, structs and cells are read.
"""

import re
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from registry.datasets.folder.columns import time_column
from registry.datasets.folder.description import SECONDS
from registry.datasets.folder.draft import time_unit
from registry.datasets.logs.table import Table
from registry.errors import BenchError
from registry.regular_file import regular
from registry.units import unit_of

LARGEST = 2**30
"""Bytes of the numbers in a file, unpacked: 10 h of 40 signals at 100 Hz take half of it."""
DEEPEST = 6
"""Structs within each other."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_COMPRESSED = 15
"""The type of an element that is packed by zlib, in versions 5 to 7."""
_OPAQUE = (
    "holds a timetable or another object, which MATLAB writes in a form of its own: there, T = timetable2table(TT); "
    "T.(1) = seconds(T.(1) - T.(1)(1)); s = table2struct(T, ToScalar=true); save('log.mat', '-struct', 's')"
)
Node = Any
"""A number array, a text, a list of nodes (cells, arrays of structs) or a dictionary of them by name (a struct)."""


def read_matlab(file: Path, rate: float | None = None) -> dict[str, list[Table]]:
    """The tables of each recording in a file: one, or one for each element of an array of structs.

    Args:
        file: of MATLAB.
        rate: sample rate [Hz] of what has no time.

    Raises:
        BenchError: the file is damaged, too large unpacked, or holds nothing with a time.
    """
    with regular(file).open("rb") as stream:
        head = stream.read(512 + len(_HDF5))
    try:
        root = _v73(file) if _HDF5 in (head[:8], head[512:]) else _v5(file)
    except BenchError:
        raise
    except Exception as error:  # damaged files bring out every kind of error in the parsers
        raise BenchError(f"{file} is damaged or not a MATLAB file ({error}): save it again.") from error
    arrays = {name: node for name, node in root.items() if isinstance(node, list) and _all_structs(node)}
    found = {
        f"{file.stem}_{name}_{i}": list(_tables(node, name, 0))
        for name, nodes in arrays.items()
        for i, node in enumerate(nodes, start=1)
    }
    rest = {n: node for n, node in root.items() if n not in arrays}
    found[file.stem] = list(_tables(rest, "", 0))
    if rate is not None and not any(found.values()):
        found[file.stem] = list(_tables(_timed(rest, rate), "", 0))
    recordings = {name: tables for name, tables in found.items() if tables}
    if not recordings:
        if any(isinstance(node, str) and node == _OPAQUE for node in root.values()):
            raise BenchError(f"{file} {_OPAQUE}.")
        raise BenchError(
            f"{file} holds no struct or variable named time, t or tout beside others of its length: add one, or say "
            "with --rate at how many Hz the others were sampled."
        )
    return recordings


def _timed(node: Mapping[str, Node], rate: float) -> dict[str, Node]:
    """A struct, and those in it, with a time [s] for the arrays of the length that most have."""
    out = {n: _timed(inner, rate) if isinstance(inner, dict) else inner for n, inner in node.items()}
    arrays = (x for x in out.values() if isinstance(x, np.ndarray) and x.dtype.kind in "fiub" and x.ndim == 2)
    lengths = Counter(max(x.shape) for x in arrays if max(x.shape) > 2)
    if lengths:
        out["time"] = np.arange(lengths.most_common(1)[0][0])[:, None] / rate
    return out


def _tables(node: Mapping[str, Node], name: str, depth: int) -> Iterator[Table]:
    """Those of a struct: its own, if it holds a time, and those of the structs in it that hold one."""
    if depth > DEEPEST:
        return
    time = time_column([n for n in node if _vector(node[n])]) or ("tout" if _vector(node.get("tout")) else None)
    within = {n: inner for n, inner in node.items() if isinstance(inner, dict) and n != "units"}
    if time is not None:
        t = np.asarray(node[time], dtype=float).reshape(-1)
        columns, units = dict(_columns(node, "", len(t), depth, time)), _units(node, time)
        unit_text = units.pop(time, "")
        steps = np.diff(t[np.isfinite(t)])
        unit = unit_text if unit_text in SECONDS else time_unit(time, float(np.median(steps)) if len(steps) else 0.0)
        if columns:
            stated = {c: u for c in columns for n, u in units.items() if c == n or re.fullmatch(rf"{n}_\w", c)}
            yield Table(t * SECONDS[unit], columns, stated, source=name or "variables")
    for inner, struct in within.items():
        if time is None or _has_time(struct):
            yield from _tables(struct, inner, depth + 1)


def _columns(
    node: Mapping[str, Node], prefix: str, count: int, depth: int, time: str = ""
) -> Iterator[tuple[str, np.ndarray]]:
    """The columns (count,) of a struct by name, and of those in it that have no time of their own."""
    for name, value in node.items():
        label = f"{prefix}{name}"
        if isinstance(value, np.ndarray) and name != time:
            yield from _split(label, value, count)
        elif name == "signals" and (signals := value if isinstance(value, list) else [value]):
            for i, signal in enumerate(s for s in signals if isinstance(s, dict)):
                own = signal.get("label")
                values = signal.get("values")
                if isinstance(values, np.ndarray):
                    yield from _split(own if isinstance(own, str) and own else f"signal{i + 1}", values, count)
        elif isinstance(value, dict) and depth < DEEPEST and name != "units" and not _has_time(value):
            yield from _columns(value, f"{label}.", count, depth + 1)


def _split(name: str, values: np.ndarray, count: int) -> Iterator[tuple[str, np.ndarray]]:
    """The columns of an array whose one side has the length of the time."""
    if values.dtype.kind not in "fiub" or values.ndim != 2 or count not in values.shape or 0 in values.shape:
        return
    table = (values if values.shape[0] == count else values.T).astype(float)
    endings = [""] if table.shape[1] == 1 else ["_x", "_y", "_z"] if table.shape[1] == 3 else []
    for i in range(table.shape[1]):
        yield name + (endings[i] if endings else f"{i + 1}"), table[:, i]


def _units(node: Mapping[str, Node], time: str) -> dict[str, str]:
    """Of a field "units": a struct by the names of the others, or a cell of texts in their order without the time."""
    stated = node.get("units")
    if isinstance(stated, dict):
        pairs = list(stated.items())
    elif isinstance(stated, list):
        pairs = list(zip([n for n in node if n not in (time, "units")], stated, strict=False))
    else:
        return {}
    return {n: unit for n, text in pairs if isinstance(text, str) and (unit := unit_of(text))}


def _vector(node: Node) -> bool:
    """Whether it can be the times of samples: a row or column of three numbers or more."""
    return (
        isinstance(node, np.ndarray)
        and node.ndim == 2
        and min(node.shape) == 1
        and node.size > 2
        and (node.dtype.kind in "fiu")
    )


def _has_time(node: Mapping[str, Node]) -> bool:
    return time_column([n for n in node if _vector(node[n])]) is not None


def _all_structs(nodes: list[Node]) -> bool:
    return bool(nodes) and all(isinstance(node, dict) and _has_time(node) for node in nodes)


def _v5(file: Path) -> dict[str, Node]:
    content = file.read_bytes()
    _refuse_bomb(file, content)
    read = scipy.io.loadmat(str(file), struct_as_record=True, chars_as_strings=True)
    return {name: _of_v5(value, 0) for name, value in read.items() if not name.startswith("__") and name != "None"} | (
        {"": _OPAQUE} if "__function_workspace__" in read else {}
    )


def _of_v5(value: Any, depth: int) -> Node:
    if not isinstance(value, np.ndarray) or depth > DEEPEST:
        return None
    if value.dtype.names and value.dtype.kind == "V":
        structs = [{n: _of_v5(item[n], depth + 1) for n in value.dtype.names} for item in value.reshape(-1, order="F")]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype == object:
        return [_of_v5(item, depth + 1) for item in value.reshape(-1, order="F")]
    if value.dtype.kind == "U":
        return str(value.reshape(-1)[0]) if value.size else ""
    return value


def _refuse_bomb(file: Path, content: bytes) -> None:
    """Raise where the packed elements of a file would fill the memory."""
    at, unpacked = 128, 0
    while at + 8 <= len(content):
        kind, size = (int.from_bytes(content[a : a + 4], "little") for a in (at, at + 4))
        if kind == _COMPRESSED:
            packer = zlib.decompressobj()
            rest = content[at + 8 : at + 8 + size]
            while rest and not packer.eof:
                unpacked += len(packer.decompress(rest, 2**20))
                rest = packer.unconsumed_tail
                if unpacked > LARGEST:
                    raise BenchError(
                        f"{file} holds more than {LARGEST >> 20} MiB of numbers: cut it into several files."
                    )
        at += 8 + size


def _v73(file: Path) -> dict[str, Node]:
    with h5py.File(file, "r") as content:
        room = [LARGEST]
        return {name: _of_v73(file, content, node, 0, room) for name, node in content.items() if name[0] != "#"}


def _of_v73(file: Path, content: h5py.File, node: Any, depth: int, room: list[int]) -> Node:
    """``room``: how many bytes may still be read."""
    if depth > DEEPEST:
        return None
    kind = node.attrs.get("MATLAB_class", b"")
    if "MATLAB_object_decode" in node.attrs:
        return _OPAQUE
    if isinstance(node, h5py.Group):
        fields = {n: _of_v73(file, content, inner, depth + 1, room) for n, inner in node.items()}
        return _array_of_structs(fields, node)
    if not isinstance(node, h5py.Dataset) or node.shape is None:
        return None
    room[0] -= max(node.size, 1) * max(node.dtype.itemsize, 1)
    if room[0] < 0:
        raise BenchError(f"{file} holds more than {LARGEST >> 20} MiB of numbers: cut it into several files.")
    if node.dtype == h5py.ref_dtype:
        return [_of_v73(file, content, content[r], depth + 1, room) for r in np.asarray(node).reshape(-1) if r]
    values = np.asarray(node)
    if kind == b"char":
        return "".join(chr(int(c)) for c in values.reshape(-1)[:200])
    # MATLAB stores matrices column by column, so they come out transposed.
    return values.T if values.dtype.kind in "fiub" and values.ndim == 2 else None


def _array_of_structs(fields: dict[str, Node], node: Any) -> Node:
    """The fields of one struct, or where each is a row of references, as many structs as they have."""
    refers = [n for n in node if isinstance(node[n], h5py.Dataset) and node[n].dtype == h5py.ref_dtype]
    cells = [n for n in refers if node[n].attrs.get("MATLAB_class", b"") != b"cell"]
    counts = {len(fields[n]) for n in cells}
    if not cells or len(cells) < len(fields) or len(counts) != 1:
        return fields
    return [{n: fields[n][i] for n in cells} for i in range(counts.pop())]
