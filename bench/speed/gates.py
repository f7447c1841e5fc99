"""What the rows must show: the aims of this suite, on one thread of a CPU with AVX-512."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.speed.rows import Row

ONE = {"task": "train", "models": 1, "processes": 1}
Plain = Mapping[str, Any]
"""A row as written to JSON."""


@dataclass(frozen=True)
class Gate:
    """A number of a row, or of two, against its bound."""

    row: dict[str, Any]
    """What picks the row."""
    what: str
    over: str
    under: str
    least: float | None = None
    most: float | None = None
    factor: float = 1.0

    @property
    def name(self) -> str:
        """The row, in words."""
        plain = {**ONE, **self.row}
        names = {"T": "horizon", "B": "batch"}
        return Row(**{names.get(k, k): v for k, v in plain.items()}).name

    @property
    def bound(self) -> str:
        """Such as "at least 90 %"."""
        value, word = (self.least, "at least") if self.most is None else (self.most, "at most")
        assert value is not None
        return f"{word} {self.written(value)}"

    def written(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:.2f}" if self.what.startswith("times") else f"{100 * value:.0f} %"

    def value(self, rows: Iterable[Plain]) -> float | None:
        """From rows as written to JSON; None where they do not hold it."""
        asked = {**ONE, **self.row}
        for row in rows:
            if any(row.get(k) != v for k, v in asked.items()):
                continue
            top, bottom = row.get(self.over), 1.0 if self.under == "share" else row.get(self.under)
            return None if top is None or not bottom else self.factor * top / bottom
        return None

    def limit(self, rows: Iterable[Plain]) -> float | None:
        """`value` if a step took no longer than its products; None where no other implementation is compared with."""
        if not {"naive_ms", "library_ms"} & {self.over, self.under}:
            return None
        return self.value({**row, "native_ms": row.get("floor_ms"), "torch_ms": row.get("floor_ms")} for row in rows)

    def holds(self, value: float) -> bool:
        """Whether a value is within the bound."""
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)


def _lstm(layers: int, hidden: int, horizon: int, batch: int, **more: Any) -> dict[str, Any]:
    return {"model": "LSTM", "layers": layers, "hidden": hidden, "T": horizon, "B": batch, **more}


_FLOOR = ("of its time is products", "floor_ms", "native_ms")
_NAIVE = ("times the reference's speed", "naive_ms", "native_ms")
_LIBRARY = ("of nn.LSTM's time", "native_ms", "library_ms")
_MLFC = {"model": "MLFC", "layers": 2, "hidden": 100, "T": 40, "B": 256}
_STEP = {"task": "step", "initializer": "MLP: 100x10"}

GATES = (
    Gate(_lstm(4, 200, 190, 256), *_FLOOR, least=0.90),
    Gate(_lstm(4, 200, 190, 256), *_NAIVE, least=1.9),
    Gate(_lstm(4, 200, 190, 256), *_LIBRARY, most=0.70),
    Gate(_lstm(7, 200, 190, 256), *_FLOOR, least=0.90),
    Gate(_lstm(1, 50, 40, 64), *_NAIVE, least=8),
    Gate(_lstm(1, 50, 190, 64), *_NAIVE, least=9),
    Gate(_lstm(1, 50, 40, 64), *_LIBRARY, most=0.60),
    Gate(_lstm(1, 50, 190, 64), *_LIBRARY, most=0.60),
    Gate(_lstm(1, 50, 40, 256), *_LIBRARY, most=0.50),
    Gate(_lstm(1, 50, 190, 256), *_LIBRARY, most=0.50),
    Gate(_lstm(2, 50, 190, 256), *_FLOOR, least=0.60),
    Gate(_MLFC, *_NAIVE, least=2),
    Gate(_MLFC, "of nn.RNN's time", "native_ms", "library_ms", most=1),
    Gate(_lstm(2, 50, 40, 64, **_STEP), "spent outside the networks", "outside_share", "share", most=0.15),
    Gate(
        _lstm(2, 50, 40, 64, task="step", initializer="RNN: 50x10"),
        "spent outside the networks",
        "outside_share",
        "share",
        most=0.15,
    ),
    Gate(
        {**_lstm(2, 50, 40, 64, **_STEP), "model": "LSTM TDL"},
        "spent outside the networks",
        "outside_share",
        "share",
        most=0.15,
    ),
    Gate({**_lstm(4, 200, 190, 64), "model": "Hybrid"}, "of its two LSTMs alone", "native_ms", "parts_ms", most=1.15),
    Gate(_lstm(1, 50, 40, 64), "times the reference's speed, PyTorch kernel", "naive_ms", "torch_ms", least=3),
    Gate(_lstm(4, 200, 190, 256), "times the reference's speed, PyTorch kernel", "naive_ms", "torch_ms", least=1.45),
    Gate(_lstm(1, 50, 40, 64, models=8), *_NAIVE, least=12),
    Gate(
        _lstm(1, 50, 40, 64, processes=2),
        "times one process, two at once",
        "one_process_ms",
        "native_ms",
        least=1.75,
        factor=2,
    ),
    Gate(_lstm(1, 50, 190, 256, task="predict"), *_NAIVE, least=2.8),
    Gate(_lstm(1, 50, 190, 256, task="predict"), "times nn.LSTM's speed", "library_ms", "native_ms", least=1.2),
)
