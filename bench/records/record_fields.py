"""What the files of a record say, by name: which values can be."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from registry.core import finite

TABLES = ("steps", "curve", "windows")
"""Of a record, each a Parquet file."""
JSON = ("record.json", "config.json", "provenance.json")
FILES = (*JSON, *(f"{t}.parquet" for t in TABLES), "model.safetensors")
KEY = re.compile(r"[0-9a-f]{32,64}")
TEXT = 200
"""Longest name of a signal, configuration or recording."""
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


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda x: x is None or fits(x)


def all_of(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """A list of such things."""
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
    "inputs": all_of(text),
    "outputs": lambda x: all_of(text)(x) and len(x) > 0,
    "context": all_of(text),
    "predicted": count,
    "units": _by_name(text),
    "rate_hz": lambda x: finite(x) and x > 0,
    "horizon": _size,
    "history": _size,
    "seed": count,
    "weights": count,
    "updates": count,
    "best_update": _or_none(count),
    "diverged_at": _or_none(count),
    "metrics": _by_name(_or_none(finite)),
    "windows": _parts(count),
    "recordings": _parts(all_of(text)),
    "environment": _by_name(lambda x: text(x) or finite(x)),
    "files": _files,
}
LATER = ("context", "predicted", "environment")
"""Not in the first records."""
PROVENANCE: dict[str, Callable[[Any], bool]] = {
    "started_ms": lambda x: count(x) and x < LAST_MS,
    "finished_ms": lambda x: count(x) and x < LAST_MS,
    "seconds": finite,
    "device": text,
    "host": _by_name(text),
    "versions": _by_name(text),
    "git": text,
}


def lacking(summary: Mapping[str, Any]) -> str:
    """What a ``record.json`` without a stamp lacks that its readers ask for, or has of another kind; empty: nothing."""
    for name, fits in SUMMARY.items():
        if name not in summary and name not in LATER:
            return f"no {name}"
        if name in summary and not fits(summary[name]):
            return f"no such {name}"
    return ""
