"""Named entries, registered by decorator or by entry point.

An entry is a frozen dataclass: its fields are the options of the thing it names. The dataclass gives
command-line help, the run key, the tracked parameters and the default search space.
"""

import dataclasses
import importlib
import math
import sys
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from registry import outline
from registry.errors import BenchError, near

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

T = TypeVar("T")


def entry_points(group: str) -> "EntryPoints":
    """What installed packages add to a group; what reads that takes a quarter of `bench --help`, which needs none."""
    from importlib import metadata

    return metadata.entry_points(group=group)


def option(
    default: Any,
    help: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    log: bool = False,
    choices: tuple[Any, ...] = (),
    search: bool | tuple[float, float] = False,
    source: str = "",
) -> Any:
    """A dataclass field that explains itself.

    ``low``/``high`` (inclusive) and ``choices`` are enforced by `check_options`. ``search`` makes the field part of
    the default search space of a sweep: the range worth searching, on a logarithmic scale when ``log``, or with True
    all of ``choices``.
    """
    meta = {
        "help": help,
        "unit": unit,
        "low": low,
        "high": high,
        "log": log,
        "choices": choices,
        "search": search,
        "source": source,
    }
    return field(default=default, metadata=meta)


def check_options(entry: Any, label: str) -> None:
    """Raise `BenchError` when a field of the dataclass instance is of the wrong type or out of its range."""
    for f in dataclasses.fields(entry):
        value, meta = getattr(entry, f.name), f.metadata
        kind = type(f.default) if f.default is not MISSING and f.default is not None else None
        right = kind is None or isinstance(value, int if kind is int else (int, float) if kind is float else kind)
        if not right or (isinstance(value, bool) and kind is not bool and kind is not None):
            raise BenchError(f"{label}.{f.name} must be of type {kind.__name__ if kind else '?'}, not {value!r}.")
        if isinstance(value, float) and not math.isfinite(value):
            raise BenchError(f"{label}.{f.name} = {value!r} must be a finite number.")
        choices, low, high = meta.get("choices") or (), meta.get("low"), meta.get("high")
        if choices and value not in choices:
            raise BenchError(f"{label}.{f.name} = {value!r}: choose one of {', '.join(map(str, choices))}.")
        too_low, too_high = low is not None and not value >= low, high is not None and not value <= high
        if too_low or too_high:
            span = (
                f"from {low} to {high}"
                if low is not None and high is not None
                else (f"at least {low}" if low is not None else f"at most {high}")
            )
            raise BenchError(f"{label}.{f.name} = {value!r} must be {span} {meta.get('unit', '')}".rstrip() + ".")


@dataclass(eq=False)
class Registry:
    """The entries of one kind, by name. Built-in modules and entry points are loaded at the first look-up."""

    kind: str
    """Singular, as in "predictor"."""
    package: str
    """The package whose modules hold the built-in entries, those in its rooms with them."""
    _entries: dict[str, type] = field(default_factory=dict)
    _loaded: bool = False

    @property
    def group(self) -> str:
        """The entry-point group through which third parties add entries."""
        return "multistep_bench." + self.package.rsplit(".", 1)[-1]

    def register(self, name: str) -> Callable[[type[T]], type[T]]:
        """Class decorator: file the dataclass under ``name``. A name already taken is an error."""

        def add(entry: type[T]) -> type[T]:
            if not dataclasses.is_dataclass(entry):
                raise TypeError(f"{self.kind} {name!r}: decorate a frozen dataclass (its fields are the options)")
            taken = self._entries.get(name)
            if taken is not None:
                raise BenchError(
                    f"The {self.kind} name {name!r} is taken by {taken.__module__}.{taken.__qualname__}; "
                    f"{entry.__module__}.{entry.__qualname__} needs another name."
                )
            if not (entry.__doc__ or "").strip():
                raise TypeError(f"{self.kind} {name!r} needs a docstring: its first line is shown by `bench list`")
            self._entries[name] = entry
            return entry

        return add

    def _load(self) -> None:
        if self._loaded:
            return
        self._loaded = True
        for module in outline.modules(self.package):
            importlib.import_module(module.name)
        for point in entry_points(group=self.group):
            try:
                point.load()
            except BenchError:
                raise
            except Exception as error:
                raise BenchError(
                    f"The {self.kind} plug-in {point.name!r} ({point.value}) fails to import: {error}."
                ) from error

    def get(self, name: str) -> type[Any]:
        """The entry called ``name`` (case matters only between two names that differ by case alone).

        Raises:
            BenchError: no such entry; the message lists the near names.
        """
        self.check(name)
        self._load()
        if name in self._entries:
            return self._entries[name]
        same = [n for n in self._entries if n.lower() == name.lower()]
        if len(same) == 1:
            return self._entries[same[0]]
        raise BenchError(f"There is no {self.kind} {name!r}: {near(name, self._entries)}")

    def check(self, name: str) -> None:
        """Raise `BenchError` where no entry is called ``name``, with the near names; only plug-ins are imported."""
        if not self._loaded and entry_points(group=self.group):
            self._load()  # a plug-in may file more than its source tells
        known = self._entries if self._loaded else self.outline()
        if name.lower() not in map(str.lower, known):
            raise BenchError(f"There is no {self.kind} {name!r}: {near(name, known)}")

    def knows(self, entry: type) -> bool:
        """Whether an entry class is registered."""
        self._load()
        return any(known is entry for known in self._entries.values())

    def name_of(self, entry: type) -> str:
        """The name an entry class is registered under."""
        self._load()
        for name, known in self._entries.items():
            if known is entry:
                return name
        raise BenchError(f"{entry.__qualname__} is not a registered {self.kind}.")

    def names(self) -> list[str]:
        """All names, sorted."""
        self._load()
        return sorted(self._entries)

    def outline(self) -> dict[str, str]:
        """Name → `summary` of every entry, by name; read from the sources as long as nothing is loaded.

        Raises:
            BenchError: a plug-in whose source does not tell what it files fails to import.
        """
        if not self._loaded:
            kind = self.package.rpartition(".")[2].upper()
            found = {n: _first_line(e) for n, e in self._entries.items()}
            for source in outline.package_sources(self.package):
                found |= outline.registered(source, kind)
            for point in entry_points(group=self.group):
                source = outline.source_of(point.module) or ""
                read = outline.registered(source, kind)
                if not read or len(read) != source.count(".register("):  # only importing it tells all that it files
                    self._load()
                    break
                found |= read
            else:
                return dict(sorted(found.items()))
        return {name: self.summary(name) for name in self.names()}

    def summary(self, name: str) -> str:
        """One line about an entry: the first line of its docstring."""
        return _first_line(self.get(name))


def _first_line(entry: type) -> str:
    return (entry.__doc__ or "").strip().splitlines()[0]


PREDICTORS = Registry("predictor", "registry.predictors")
INITIALIZERS = Registry("initializer", "registry.initializers")
DATASETS = Registry("dataset", "registry.datasets")
PHYSICS = Registry("physics model", "registry.physics")
EFFECTS = Registry("effect", "registry.effects")
REGISTRIES = {
    "predictors": PREDICTORS,
    "initializers": INITIALIZERS,
    "datasets": DATASETS,
    "physics": PHYSICS,
    "effects": EFFECTS,
}


def finite(value: Any) -> bool:
    """Whether it is a number, and a finite one; an integer beyond all floats is none."""
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return False
    return math.isfinite(value) if isinstance(value, float) else abs(value) <= sys.float_info.max
