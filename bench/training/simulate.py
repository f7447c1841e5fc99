"""The simulation error of benchmarks: whole test recordings from their first samples and the inputs alone."""

import numpy as np
import torch
from torch import Tensor

from bench.experiment.config import RunConfig
from bench.records.record import SIMULATION
from bench.training.model import Model
from bench.training.split import load
from registry.contracts import Recording
from registry.errors import BenchError


def simulation_errors(model: Model, config: RunConfig, names: tuple[str, ...]) -> dict[str, float | None]:
    """√(mean e²) of each predicted channel over all of a test recording but its history, SI; None: not finite.

    Args:
        model: trained.
        config: resolved; its history is what is measured of a recording.
        names: test recordings.
    """
    recordings = [r for r in load(config.dataset).recordings if r.name in names]
    found: dict[str, float | None] = {}
    for recording, (measured, predicted) in zip(recordings, simulated(model, config, recordings), strict=True):
        errors = np.sqrt(np.square(measured - predicted, dtype=np.float64).mean(0))
        for channel, error in zip(model.predictor.problem.outputs, errors, strict=True):
            found[f"{SIMULATION}{channel.name}@{recording.name}"] = float(error) if np.isfinite(error) else None
    return found


def simulated(model: Model, config: RunConfig, recordings: list[Recording]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Measured and predicted outputs (N − τ, n) of the first stretch of valid samples of each recording, SI.

    The run goes on from piece to piece of the horizon's length by the predictor's state; no sample after the history
    is measured. All run side by side, shorter ones on with inputs of zero, which nobody looks at.

    Raises:
        BenchError: a stretch is not longer than the history.
    """
    tau, p = config.tau, model.predictor
    parts = [[_picked(r, s, tau) for s in (config.inputs, config.outputs, config.context)] for r in recordings]
    u = torch.nn.utils.rnn.pad_sequence([u[tau:] for u, _, _ in parts], batch_first=True)
    u_history = torch.stack([u[:tau] for u, _, _ in parts])
    y_history = torch.stack([torch.cat([y, context], -1)[:tau] for _, y, context in parts])
    pieces = []
    with torch.no_grad():
        state = model.state(p.input_scaler(u_history), p.scale_history(y_history))
        for piece in p.input_scaler(u).split(config.horizon, 1):
            outputs, state = p.rollout(piece, state)
            pieces.append(p.output_scaler.invert(outputs))
    predicted = torch.cat(pieces, 1)
    return [(y[tau:].numpy(), predicted[i, : len(y) - tau].numpy()) for i, (_, y, _) in enumerate(parts)]


def _picked(recording: Recording, signals: tuple[str, ...], tau: int) -> Tensor:
    """Signals (N, c) of the first stretch of valid samples."""
    valid = np.flatnonzero(recording.valid)
    first = int(valid[0]) if len(valid) else 0
    gaps = np.flatnonzero(~recording.valid[first:])
    length = int(gaps[0]) if len(gaps) else len(recording) - first
    if length <= tau:
        raise BenchError(f"{recording.name} has no more than {tau} valid samples in a row: nothing to simulate.")
    return torch.from_numpy(np.ascontiguousarray(recording.pick(signals)[0][first : first + length], np.float32))
