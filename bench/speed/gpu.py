"""An update on a GPU beside one CPU thread: from which size on networks are better trained there."""

import time
from dataclasses import dataclass

import torch

from bench.experiment.device import CHOICE, wide
from bench.speed.networks import choosing
from bench.speed.rows import Row
from bench.speed.timing import Contender, Effort, interleaved
from bench.speed.update import update
from registry.errors import BenchError


def _row(model: str, layers: int, hidden: int, batch: int) -> Row:
    return Row(model, layers, hidden, 40, batch, task="step", initializer="MLP: 100x10")


ROWS = (
    _row("LSTM", 1, 50, 64),
    _row("LSTM", 4, 100, 64),
    _row("LSTM", 1, 200, 64),
    _row("LSTM", 4, 200, 64),
    _row("LSTM", 4, 200, 256),
    _row("LSTM", 1, 400, 64),
    _row("MLFC", 4, 200, 64),
)


@dataclass(frozen=True)
class OnBoth:
    """Milliseconds of an update of `bench run` [wall time]."""

    row: Row
    cpu_ms: float
    gpu_ms: float

    @property
    def taken(self) -> str:
        """Where such a network trains unless the user says otherwise."""
        return "GPU" if wide(self.row.hidden, self.row.batch) else "CPU"


def name() -> str:
    """Of the GPU.

    Raises:
        BenchError: there is none.
    """
    if not torch.cuda.is_available():
        raise BenchError("--gpu: torch finds no GPU here. Leave it out to measure the CPU.")
    return torch.cuda.get_device_name()


def measure(row: Row, effort: Effort) -> OnBoth:
    """Both in turns, the CPU on one thread."""
    torch.set_num_threads(1)
    with choosing(CHOICE, "cpu"):
        on_cpu = update(row)
    with choosing(CHOICE, "cuda"):
        on_gpu = _waited(update(row))
    taken = interleaved({"cpu": on_cpu, "gpu": on_gpu}, effort, time.perf_counter)
    return OnBoth(row, 1e3 * taken["cpu"], 1e3 * taken["gpu"])


def _waited(work: Contender) -> Contender:
    """The work until the GPU has done it."""

    def step() -> None:
        work()
        torch.cuda.synchronize()

    return step
