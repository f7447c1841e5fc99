"""One row: who takes part, interleaved, and what came out."""

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from bench.speed import networks, update
from bench.speed.floor import floating_operations, steps_of, ways
from bench.speed.processes import side_by_side
from bench.speed.rows import Row
from bench.speed.timing import Contender, Effort, interleaved


@dataclass(frozen=True)
class Measured:
    """Milliseconds of one step of a row; None: does not exist."""

    row: Row
    naive_ms: float | None = None
    library_ms: float | None = None
    torch_ms: float | None = None
    native_ms: float | None = None
    floor_ms: float | None = None
    more: dict[str, float] = field(default_factory=dict)
    """What a row has beside: "parts_ms" of a hybrid model's two LSTMs alone, "networks_ms" of an update's networks
    alone (of the compiled core), "one_process_ms"."""

    @property
    def ours_ms(self) -> float | None:
        """The native kernel's time, or where there is none the PyTorch one's."""
        return self.torch_ms if self.native_ms is None else self.native_ms

    @property
    def outside(self) -> float | None:
        """Share of a whole update that its networks do not take."""
        alone, ours = self.more.get("networks_ms"), self.ours_ms
        return None if alone is None or ours is None else max(0.0, 1 - alone / ours)

    @property
    def gigaflops(self) -> float | None:
        """Billions of necessary additions and multiplications a second."""
        if self.ours_ms is None:
            return None
        work = floating_operations(self.row.products, self.row.batch, self.row.task != "predict")
        return work * self.row.models * self.row.processes / self.ours_ms / 1e6

    def plain(self) -> dict[str, Any]:
        """As written to JSON."""
        r = self.row
        made: dict[str, Any] = {
            "model": r.model,
            "layers": r.layers,
            "hidden": r.hidden,
            "T": r.horizon,
            "B": r.batch,
            "task": r.task,
            "threads": 1,
            "processes": r.processes,
            "models": r.models,
            "dtype": "float32",
            "initializer": r.initializer or None,
        }
        times = {k: v for k, v in asdict(self).items() if k.endswith("_ms")} | self.more
        rounded = {k: None if v is None else round(v, 4) for k, v in times.items()}
        return made | rounded | ({} if self.outside is None else {"outside_share": round(self.outside, 4)})


def measure(row: Row, effort: Effort) -> Measured:
    """Measure a row on one thread a process.

    CPU time; wall time where several processes share the machine.
    """
    torch.set_num_threads(1)
    kernels = networks.kernels()
    if row.processes > 1:
        times = {k: side_by_side(row, k, effort) for k in kernels}
        best = times[kernels[-1]]
        together = {_field(k): 1e3 * t[1] for k, t in times.items()}
        return Measured(row, more={"one_process_ms": 1e3 * best[0]}, **together)
    contenders: dict[str, Contender] = {}
    own: Callable[[Row], Contender] = update.update if row.task == "step" else networks.ours
    for kernel in kernels:
        contenders[_field(kernel)] = networks.with_kernel(kernel, own(row))
    if row.task == "step":
        if "native" in kernels:
            contenders["networks_ms"] = networks.with_kernel("native", update.networks(row))
    elif row.model == "Hybrid":
        contenders["parts_ms"] = networks.with_kernel(kernels[-1], networks.parts(row))
    else:
        contenders |= {"naive_ms": networks.naive(row), "library_ms": networks.library(row)}
    found = interleaved(contenders | _products(row), effort)
    times_ms = {k: 1e3 * v for k, v in found.items() if k.endswith("_ms")}
    more: dict[str, float] = {k: times_ms.pop(k) for k in ("networks_ms", "parts_ms") if k in times_ms}
    return Measured(row, floor_ms=1e3 * _floor(row, found), more=more, **times_ms)


def _field(kernel: str) -> str:
    return {"pytorch": "torch_ms", "native": "native_ms"}[kernel]


def _products(row: Row) -> dict[str, Contender]:
    """Every different product in every way, by "columns x rows, way"."""
    different = {(p.columns, p.rows): p for p in row.products}
    return {
        f"{k}x{n}, {way}": work
        for (k, n), p in different.items()
        for way, work in ways(p, row.batch, row.task != "predict").items()
    }


def _floor(row: Row, found: dict[str, float]) -> float:
    """Seconds of all products of a step, each layer in the fastest way."""
    total = 0.0
    for p in row.products:
        fastest = min(t for name, t in found.items() if name.startswith(f"{p.columns}x{p.rows}, "))
        total += fastest / steps_of(row.batch) * p.steps
    return total * row.models


def machine() -> dict[str, Any]:
    """What was measured on, and the best that one thread does: a product of two 1024 x 1024 matrices."""
    torch.set_num_threads(1)
    a, out = torch.randn(1024, 1024), torch.empty(1024, 1024)
    seconds = interleaved({"product": lambda: torch.mm(a, a, out=out)}, Effort(rounds=5, fewest=3, shortest=0.05))
    return {
        "cpu": _cpu_name(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "torch": torch.__version__,
        "kernels": networks.kernels(),
        "gigaflops": round(2 * 1024**3 / seconds["product"] / 1e9, 1),
    }


def _cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return next((x.partition(":")[2].strip() for x in lines if x.startswith("model name")), platform.processor())
