"""What a record must be when it comes from elsewhere: the reader's own expectations, checked one by one."""

import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from bench.records import stamp
from bench.records.record import STEP_COLUMNS, TABLES, WINDOW_COLUMNS, RunRecord, verify
from registry.errors import BenchError

JSON = ("record.json", "config.json", "provenance.json")
FILES = (*JSON, *(f"{t}.parquet" for t in TABLES), "model.safetensors")
KEY = re.compile(r"[0-9a-f]{32,64}")
ROWS = 1_000_000
"""Most rows of a table."""
TEXT = 200
"""Longest name of a signal, configuration or recording."""
BYTES = {".json": 4 << 20, ".parquet": 32 << 20, ".safetensors": 256 << 20}
"""Largest file, by its ending."""
LAST_MS = 4_102_444_800_000
"""The year 2100."""


def text(x: Any) -> bool:
    """A short line that can be printed."""
    return isinstance(x, str) and len(x) <= TEXT and x.isprintable()


def count(x: Any) -> bool:
    """A whole number that is not negative."""
    return isinstance(x, int) and not isinstance(x, bool) and 0 <= x < 2**53


def _size(x: Any) -> bool:
    return count(x) and 1 <= x <= 100_000


def _number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda x: x is None or fits(x)


def _all(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda x: isinstance(x, list) and len(x) <= 10_000 and all(map(fits, x))


def _by_name(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda x: isinstance(x, dict) and len(x) <= 10_000 and all(map(text, x)) and all(map(fits, x.values()))


def _parts(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda x: _by_name(fits)(x) and set(x) == {"train", "validation", "test"}


def _digest(x: Any) -> bool:
    return isinstance(x, str) and re.fullmatch(r"[0-9a-f]{64}", x) is not None


def _files(x: Any) -> bool:
    return (
        isinstance(x, dict)
        and set(x) == set(FILES) - {"record.json", "provenance.json"}
        and all(map(_digest, x.values()))
    )


SUMMARY: dict[str, Callable[[Any], bool]] = {
    "key": lambda x: isinstance(x, str) and KEY.fullmatch(x) is not None,
    "spec": text,
    "status": lambda x: x in ("finished", "diverged"),
    "dataset": text,
    "dataset_digest": _digest,
    "inputs": _all(text),
    "outputs": lambda x: _all(text)(x) and len(x) > 0,
    "context": _all(text),
    "predicted": count,
    "units": _by_name(text),
    "rate_hz": lambda x: _number(x) and x > 0,
    "horizon": _size,
    "history": _size,
    "seed": count,
    "weights": count,
    "updates": count,
    "best_update": _or_none(count),
    "diverged_at": _or_none(count),
    "metrics": _by_name(_or_none(_number)),
    "windows": _parts(count),
    "recordings": _parts(_all(text)),
    "environment": _by_name(lambda x: text(x) or _number(x)),
    "files": _files,
}
LATER = ("context", "predicted", "environment")
"""Not in the first records."""
PROVENANCE: dict[str, Callable[[Any], bool]] = {
    "started_ms": lambda x: count(x) and x < LAST_MS,
    "finished_ms": lambda x: count(x) and x < LAST_MS,
    "seconds": _number,
    "device": text,
    "host": _by_name(text),
    "versions": _by_name(text),
    "git": text,
}
CURVE_COLUMNS = ("update", "train_loss", "validation_loss")
COLUMNS = {"steps": tuple(STEP_COLUMNS), "curve": CURVE_COLUMNS, "windows": tuple(WINDOW_COLUMNS)}
TEXTS = {"quantity", "norm", "unit", "statistic", "recording", "channel"}
WHOLE = {"step", "update", "window"}


def lacking(summary: Mapping[str, Any]) -> str:
    """What a ``record.json`` without a stamp lacks that its readers ask for, or has of another kind; empty: nothing."""
    for name, fits in SUMMARY.items():
        if name not in summary and name not in LATER:
            return f"no {name}"
        if name in summary and not fits(summary[name]):
            return f"no such {name}"
    return ""


def check(record: RunRecord) -> None:
    """Look at every part of a record.

    Raises:
        BenchError: what is wrong with it, in a sentence.
    """
    where = f"Run {record.folder.name[:12]}"
    for name in FILES:
        path = record.folder / name
        if not path.is_file() or path.is_symlink():
            raise BenchError(f"{where} has no {name}.")
        if path.stat().st_size > BYTES[path.suffix]:
            raise BenchError(f"{where}: {name} is larger than {BYTES[path.suffix] >> 20} MiB.")
    said = {name: _parsed(record.folder / name, f"{where}: {name}") for name in JSON}
    _fields(said["record.json"], SUMMARY, f"{where}: record.json")
    _fields(stamp.plain(said["provenance.json"]), PROVENANCE, f"{where}: provenance.json")
    _configuration(said["config.json"], f"{where}: config.json")
    if said["record.json"]["key"] != record.folder.name:
        raise BenchError(f"{where} is filed under a key that is not its own.")
    altered = verify(record)
    if altered:
        raise BenchError(f"{where}: {altered[0]} is not the file that was recorded.")
    for name in TABLES:
        _table(record.folder / f"{name}.parquet", COLUMNS[name], f"{where}: {name}.parquet")
    summary = record.summary
    if not set(record.steps["step"]) <= set(range(1, summary["horizon"] + 1)):
        raise BenchError(f"{where}: steps.parquet has steps outside 1 .. {summary['horizon']}.")
    if summary["status"] == "finished" and (record.steps.empty or record.windows.empty or not summary["metrics"]):
        raise BenchError(f"{where} is finished and has no errors.")
    if not all(t.is_floating_point() or t.dtype.is_signed for t in record.weights().values()):
        raise BenchError(f"{where}: model.safetensors holds something else than weights.")


def read_json(data: bytes, where: str) -> Any:
    """JSON without NaN, of a depth that can be read.

    Raises:
        BenchError: it is none.
    """

    def refuse(name: str) -> Any:
        raise ValueError(f"{name} is no number")

    try:
        return json.loads(data.decode("utf-8"), parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise BenchError(f"{where} is no JSON ({str(error)[:80]}).") from error


def _parsed(path: Path, where: str) -> dict[str, Any]:
    """JSON with names at its top, unlike `read_json` with whatever numbers: what is said of them is more exact."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise BenchError(f"{where} is damaged ({str(error)[:80]}).") from error


def _fields(content: Mapping[str, Any], wanted: Mapping[str, Callable[[Any], bool]], where: str) -> None:
    for name, fits in wanted.items():
        if name not in content:
            raise BenchError(f"{where} has no {name}.")
        if not fits(content[name]):
            raise BenchError(f"{where}: {name} = {repr(content[name])[:60]} cannot be.")
    extra = sorted(set(content) - set(wanted))
    if extra:
        raise BenchError(f"{where} has {extra[0][:60]!r}, which nobody knows.")


def _configuration(content: Any, where: str, depth: int = 4) -> None:
    """Options: names of numbers, texts, lists of texts and, within, options."""
    if not depth or not isinstance(content, dict) or len(content) > 200 or not all(map(text, content)):
        raise BenchError(f"{where} is no configuration.")
    for value in content.values():
        if isinstance(value, dict):
            _configuration(value, where, depth - 1)
        elif not (value is None or isinstance(value, bool) or _number(value) or _line(value) or _all(_line)(value)):
            raise BenchError(f"{where}: {repr(value)[:60]} is no option.")


def _line(x: Any) -> bool:
    return (isinstance(x, str) and len(x) <= 4096 and x.isprintable()) or _number(x)


def _table(path: Path, columns: tuple[str, ...], where: str) -> None:
    """Columns, their types, the number of rows and the lengths of texts, before anything is unpacked in full."""
    texts = [c for c in columns if c in TEXTS]
    try:
        about = pq.read_metadata(path)
        size = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
        if about.num_rows > ROWS or about.num_row_groups > 1000 or size > 8 * BYTES[".parquet"]:
            raise BenchError(f"{where} is too large.")
        if tuple(about.schema.names) != columns:
            raise BenchError(f"{where} has not the columns {', '.join(columns)}.")
        table = pq.ParquetFile(path, read_dictionary=texts).read()
    except (OSError, ValueError, TypeError, MemoryError, pa.ArrowException) as error:
        raise BenchError(f"{where} is damaged.") from error
    for name in columns:
        values = table.column(name)
        if table.num_rows and not _typed(values, name):
            raise BenchError(f"{where}: {name} is not of its type, or too long.")


def _typed(values: pa.ChunkedArray, name: str) -> bool:
    if values.null_count and name not in ("value", "predicted", "train_loss", "validation_loss"):
        return False
    if name in TEXTS:
        chunks = [c.dictionary for c in values.chunks if pa.types.is_dictionary(c.type)]
        return len(chunks) == len(values.chunks) and all(text(t) for c in chunks for t in c.to_pylist())
    return pa.types.is_integer(values.type) if name in WHOLE else pa.types.is_floating(values.type)
