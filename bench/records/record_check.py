"""What a record must be when it comes from elsewhere: the reader's own expectations, checked one by one."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from bench.records import stamp
from bench.records.record import STEP_COLUMNS, WINDOW_COLUMNS, RunRecord, verify
from bench.records.record_fields import FILES, JSON, PROVENANCE, SUMMARY, TABLES, all_of, text
from registry.core import finite
from registry.errors import BenchError

ROWS = 1_000_000
"""Most rows of a table."""
BYTES = {".json": 4 << 20, ".parquet": 32 << 20, ".safetensors": 256 << 20}
"""Largest file, by its ending."""

CURVE_COLUMNS = ("update", "train_loss", "validation_loss")
COLUMNS = {"steps": tuple(STEP_COLUMNS), "curve": CURVE_COLUMNS, "windows": tuple(WINDOW_COLUMNS)}
TEXTS = {"quantity", "norm", "unit", "statistic", "recording", "channel"}
WHOLE = {"step", "update", "window"}


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
    parsed = {name: _parsed(record.folder / name, f"{where}: {name}") for name in JSON}
    _fields(parsed["record.json"], SUMMARY, f"{where}: record.json")
    _fields(stamp.plain(parsed["provenance.json"]), PROVENANCE, f"{where}: provenance.json")
    _configuration(parsed["config.json"], f"{where}: config.json")
    if parsed["record.json"]["key"] != record.folder.name:
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
            raise BenchError(f"{where}: {name} = {repr(content[name])[:60]} is not valid.")
    extra = sorted(set(content) - set(wanted))
    if extra:
        raise BenchError(f"{where} has an unknown key, {extra[0][:60]!r}.")


def _configuration(content: Any, where: str, depth: int = 4) -> None:
    """Options: names of numbers, texts, lists of texts and, within, options."""
    if not depth or not isinstance(content, dict) or len(content) > 200 or not all(map(text, content)):
        raise BenchError(f"{where} is no configuration.")
    for value in content.values():
        if isinstance(value, dict):
            _configuration(value, where, depth - 1)
        elif not (value is None or isinstance(value, bool) or finite(value) or _line(value) or all_of(_line)(value)):
            raise BenchError(f"{where}: {repr(value)[:60]} is no option.")


def _line(x: Any) -> bool:
    return (isinstance(x, str) and len(x) <= 4096 and x.isprintable()) or finite(x)


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
