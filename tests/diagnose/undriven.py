"""Measurements of undriven systems, simulated with a fine step and white noise."""

import numpy as np
import torch

from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Recording
from registry.core import PHYSICS

FINER = 2


def undriven(system, effects, starts, dt, samples, noise, seed=0):
    """A subject of recordings from ``starts``, the last two held out; ``noise`` relative to each state's spread."""
    model, truth = PHYSICS.get(system)(), PHYSICS.get(system)(effects=tuple(effects))
    rng, logs = np.random.default_rng(seed), []
    nothing = torch.zeros(len(starts), samples * FINER, 0, dtype=torch.float64)
    runs = truth.simulate(torch.tensor(starts, dtype=torch.float64), nothing, dt / FINER).numpy()[:, ::FINER]
    for i, run in enumerate(runs):
        x = run + rng.normal(size=run.shape) * noise * run.std(0)
        made = Recording(
            f"run_{i}", 1 / dt, np.zeros((len(x), 0)), x, (), model.state_channels, np.ones(len(x), dtype=bool)
        )
        logs.append(log_of(made, model, ""))
    names = [log.name for log in logs]
    signals = tuple({c.group for c in model.state_channels})
    return Subject(system, model, tuple(logs), tuple(names[:-2]), tuple(names[-2:]), None, {}, {}, signals)
