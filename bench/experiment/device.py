"""Where networks train: on the CPU, or on a GPU where there is one and a network is wide enough for it.

The environment variable ``BENCH_DEVICE`` chooses: auto (default), cpu, cuda.
"""

import os

import torch

from bench.experiment.config import RunConfig
from registry.errors import BenchError, near
from registry.kernels.native import library

CHOICE = "BENCH_DEVICE"
"""The environment variable."""
WIDE = 2_000_000
"""Cells of a layer squared, times windows of a batch, from which a GPU is taken. One time step of a layer costs a GPU
some twenty launches of 5 µs, and a CPU core 48 H² B operations at 10¹¹ a second. `bench speed --gpu` measures it.
"""
_CHOICES = ("auto", "cpu", "cuda")


def device(config: RunConfig) -> torch.device:
    """The device that a run trains on; baselines that are solved for, not trained, stay on the CPU.

    Raises:
        BenchError: ``BENCH_DEVICE`` is none of its values, or is cuda where there is no GPU.
    """
    choice = os.environ.get(CHOICE, "auto")
    if choice not in _CHOICES:
        raise BenchError(f"BENCH_DEVICE={choice!r} is no device: {near(choice, _CHOICES)}")
    there = choice != "cpu" and torch.cuda.is_available()
    if choice == "cuda" and not there:
        raise BenchError("BENCH_DEVICE=cuda, but torch finds no GPU here: unset it to train on the CPU.")
    taken = choice == "cuda" or wide(getattr(config.predictor, "hidden", 0), config.training.batch)
    return torch.device("cuda" if there and taken and config.predictor.training == "gradient" else "cpu")


def wide(hidden: int, batch: int) -> bool:
    """Whether layers of so many cells are worth a GPU with batches of so many windows."""
    return hidden**2 * batch >= WIDE


def kernel(config: RunConfig) -> str:
    """What trains a run and its bits depend on: a kernel of the CPU, or "pytorch 2, NVIDIA H200"."""
    if device(config).type == "cpu":
        return library.name()
    return f"pytorch {library.PYTORCH_NUMERICS}, {torch.cuda.get_device_name()}"
