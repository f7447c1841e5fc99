"""The record of one run: a folder, written whole or not at all, filed under its run key. The truth.

Everything in it but ``provenance.json`` is a function of the run key, bit for bit. Trackers, reports and figures
are rebuilt from records.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors

from bench.records import stamp
from bench.records.record_fields import TABLES, lacking
from registry import atomic_io
from registry.errors import BenchError, near
from registry.regular_file import regular

if TYPE_CHECKING:  # who asks for errors alone need not wait for torch
    from torch import Tensor

T = TypeVar("T")
STEP_COLUMNS = ["quantity", "norm", "unit", "step", "time_s", "statistic", "value"]
SIMULATION = "simulation."
"""Of the names of simulation errors among the metrics: "simulation.level.h@validation", channel and recording."""
WINDOW_COLUMNS = ["window", "recording", "step", "time_s", "channel", "unit", "measured", "predicted"]


@dataclass(frozen=True)
class RunRecord:
    """A finished run on disk; its files are read when they are first asked for."""

    folder: Path

    @cached_property
    def summary(self) -> dict[str, Any]:
        """``record.json``: key, spec, status, dataset, channels, metrics, counts, environment, file digests."""
        return self._read("record.json", self._genuine_summary)

    @cached_property
    def config(self) -> dict[str, Any]:
        """``config.json``: the run's configuration in full."""
        return self._read("config.json", lambda path: dict(json.loads(self._genuine(path).read_text())))

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """``provenance.json``: times, host, versions; not part of the comparison."""
        return stamp.plain(self._read("provenance.json", self._genuine_provenance))

    @cached_property
    def steps(self) -> pd.DataFrame:
        """Error of every prediction step: quantity, norm, unit, step, time_s, statistic, value."""
        return self._read("steps.parquet", lambda path: pd.read_parquet(self._genuine(path)))

    @cached_property
    def curve(self) -> pd.DataFrame:
        """Learning curve: update, train_loss, validation_loss (scaled units)."""
        return self._read("curve.parquet", lambda path: pd.read_parquet(self._genuine(path)))

    @cached_property
    def windows(self) -> pd.DataFrame:
        """Predictions of a few windows: window, recording, step, time_s, channel, unit, measured, predicted."""
        return self._read("windows.parquet", lambda path: pd.read_parquet(self._genuine(path)))

    def weights(self) -> "dict[str, Tensor]":
        """Weights and scalers of the best update."""
        from safetensors.torch import load_file

        return self._read("model.safetensors", lambda path: load_file(self._genuine(path)))

    def _genuine_summary(self, path: Path) -> dict[str, Any]:
        content = path.read_bytes()
        summary = dict(json.loads(content.decode("utf-8")))
        written = self._read("provenance.json", self._genuine_provenance).get(stamp.RECORD)
        if written is None:  # of a time before stamps: at least what is asked of it must be there
            if missing := lacking(summary):
                raise ValueError(missing)
        elif written != hashlib.sha256(content).hexdigest():
            raise ValueError("altered")
        return summary

    def _genuine_provenance(self, path: Path) -> dict[str, Any]:
        content = dict(json.loads(path.read_text(encoding="utf-8")))
        if not stamp.genuine(content):
            raise ValueError("altered")
        return content

    def _genuine(self, path: Path) -> Path:
        """The path of a table or of weights, unless its content is another than was recorded."""
        if self.summary["files"].get(path.name) != sha256(path):
            raise ValueError("altered")
        return path

    def _read(self, name: str, reader: Callable[[Path], T]) -> T:
        path = self.folder / name
        try:
            return reader(regular(path))
        except (
            OSError,
            ValueError,
            TypeError,
            LookupError,
            AttributeError,
            RecursionError,
            pa.ArrowException,
            safetensors.SafetensorError,
        ) as error:
            raise BenchError(
                f"{path} is damaged or missing: the command that made the run makes it again "
                f"(`bench runs prune --results {self.folder.parent.parent}` removes it)."
            ) from error

    @property
    def key(self) -> str:
        """The run key."""
        return str(self.summary["key"])

    @property
    def finished(self) -> bool:
        """False for a run that diverged."""
        return bool(self.summary["status"] == "finished")

    def error(self, quantity: str, norm: str, statistic: str = "mean") -> pd.Series:
        """A per-step curve, indexed by step."""
        t = self.steps
        rows = t[(t.quantity == quantity) & (t.norm == norm) & (t.statistic == statistic)]
        return rows.set_index("step")["value"]


def sha256(path: Path) -> str:
    """Hex digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write canonical JSON."""
    path.write_text(stamp.canonical(content))


def write(
    runs: Path,
    summary: dict[str, Any],
    config: Mapping[str, Any],
    tables: Mapping[str, pd.DataFrame],
    weights: "Mapping[str, Tensor]",
    provenance: Mapping[str, Any],
) -> RunRecord:
    """Write a record into ``runs/<key>``: into a temporary folder first, flushed to the disk, then renamed.

    Raises:
        BenchError: the results folder cannot be written (read-only, disk full); nothing is left behind.
    """
    from safetensors.torch import save_file

    final = runs / summary["key"]
    if whole(runs, final.name):
        return RunRecord(final)
    try:
        runs.mkdir(parents=True, exist_ok=True)
        with atomic_io.drafting(runs, ".draft-") as draft:
            for name in TABLES:
                pq.write_table(pa.Table.from_pandas(tables[name], preserve_index=False), draft / f"{name}.parquet")
            tensors = {name: value.detach().contiguous() for name, value in weights.items()}
            save_file(tensors, draft / "model.safetensors")
            write_json(draft / "config.json", config)
            files = {p.name: sha256(p) for p in sorted(draft.iterdir())}
            write_json(draft / "record.json", {**summary, "files": files})
            write_json(draft / "provenance.json", stamp.stamped(provenance, (draft / "record.json").read_bytes()))
            for path in [*draft.iterdir(), draft]:
                atomic_io.flush(path)
            if final.exists() and not whole(runs, final.name):  # damaged from outside
                os.rename(final, runs / f".damaged-{final.name}-{os.getpid()}")
            atomic_io.move(draft, final)
    except (OSError, safetensors.SafetensorError) as error:
        if whole(runs, final.name):  # another process finished the same run first
            return RunRecord(final)
        raise BenchError(
            f"The results folder {runs} cannot be written: {getattr(error, 'strerror', None) or error}."
        ) from error
    return RunRecord(final)


def exists(runs: Path, key: str) -> bool:
    """Whether there is a record of this key, which may have been damaged since."""
    return (runs / key / "record.json").is_file()


def whole(runs: Path, key: str) -> bool:
    """Whether there is a record of this key, every file as it was written."""
    return exists(runs, key) and not verify(RunRecord(runs / key))


def all_records(runs: Path) -> Iterator[RunRecord]:
    """Every record in the folder, by key."""
    if runs.is_dir():
        for path in sorted(runs.iterdir()):
            if not path.name.startswith(".") and (path / "record.json").is_file():
                yield RunRecord(path)


def find(runs: Path, prefix: str) -> RunRecord:
    """The record whose key begins with ``prefix`` (or the record folder of that path).

    Raises:
        BenchError: none, or more than one.
    """
    if (Path(prefix) / "record.json").is_file():
        return RunRecord(Path(prefix))
    found = [r for r in all_records(runs) if r.folder.name.startswith(prefix)]
    if len(found) == 1:
        return found[0]
    if found:
        raise BenchError(f"{len(found)} runs begin with {prefix!r}: give more characters of the key.")
    known = [r.folder.name[:12] for r in all_records(runs)]
    raise BenchError(f"No run in {runs} begins with {prefix!r}: {near(prefix, known[:10])}")


def verify(record: RunRecord) -> list[str]:
    """Names of files that do not have the content they were recorded with."""
    for name in ("provenance", "summary"):
        try:
            getattr(record, name)
        except BenchError:
            return ["provenance.json" if name == "provenance" else "record.json"]

    def same(name: str, digest: str) -> bool:
        path = record.folder / name
        try:
            return sha256(regular(path)) == digest
        except (OSError, BenchError):
            return False

    return [name for name, digest in record.summary["files"].items() if not same(name, digest)]


def differences(a: RunRecord, b: RunRecord) -> list[str]:
    """Files, provenance aside, in which two records are not bit-equal."""
    names = {p.name for r in (a, b) for p in r.folder.iterdir()} - {"provenance.json"}

    def content(record: RunRecord, name: str) -> bytes | None:
        path = record.folder / name
        return path.read_bytes() if path.is_file() else None

    return sorted(n for n in names if content(a, n) != content(b, n))
