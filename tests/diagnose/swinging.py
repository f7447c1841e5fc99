"""Recordings of a mass on a spring that something pushes besides its drive: plain numpy, no code shared."""

import numpy as np
from scipy.linalg import expm

from bench.diagnose.logs.subject import Subject, log_of
from registry.contracts import Channel, Recording
from registry.physics.oscillator import Oscillator

RATE = 100.0
FINE = 4
"""Steps a sample."""
FREQUENCY, AMPLITUDE = 0.8, 0.5
"""Of the hidden force [Hz], [N] on 1 kg."""


def phase_of(seed: int) -> float:
    """Of the hidden force at the first sample of a recording."""
    return float(np.random.default_rng(seed + 7).uniform(-np.pi, np.pi))


def smooth(x: np.ndarray, share: float) -> np.ndarray:
    """Through a first-order low-pass filter that takes over so much of every new sample."""
    out, now = np.empty_like(x), 0.0
    for k, value in enumerate(x):
        now += share * (value - now)
        out[k] = now
    return out


def recording(kind: str, seed: int, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Drive (N,) and state (N, 2), every 10 ms, of 1 kg, 0.5 N s/m and 100 N/m.

    ``kind``: "clean", "wave" (a force A cos(2π f t + φ) besides), "gust" (one that wanders), "sampled" (a drive that is
    livelier than its samples), "resonance" (noise pushes by way of a swing of its own that hardly decays), "rubbing"
    (dry friction of 2 N, and a drive that is a sine of the same frequency in all recordings of a set), "sine" (the
    force besides such a drive), "sines" (it besides a drive of sines, one of them at nearly its frequency).
    """
    rng, count = np.random.default_rng(seed), round(seconds * RATE * FINE)
    t = np.arange(count) / RATE / FINE
    if kind == "sampled":
        drive = smooth(rng.normal(size=count), 0.125) * 30
    else:
        drive = smooth(smooth(rng.normal(size=count), 0.03), 0.03) * 40
    if kind in ("rubbing", "sine"):
        often = np.random.default_rng(seed // 1000).uniform(0.5, 2.5)
        drive = 20 * rng.uniform(0.7, 1.3) * np.sin(2 * np.pi * often * t + rng.uniform(-np.pi, np.pi))
    if kind == "sines":
        drive = np.zeros(count)
        for often in (FREQUENCY * 1.002, 0.45, 2.1):
            drive += 6 * rng.uniform(0.7, 1.3) * np.sin(2 * np.pi * often * t + rng.uniform(-np.pi, np.pi))
    hidden = np.zeros(count)
    if kind in ("wave", "sine", "sines"):
        hidden = AMPLITUDE * np.cos(2 * np.pi * FREQUENCY * t + phase_of(seed))
    if kind == "gust":
        share = 1 / (rng.uniform(0.3, 3) * RATE * FINE)
        hidden = smooth(rng.normal(size=count), share) * 2 / (share / 2) ** 0.5
    if kind == "resonance":
        turn = 2 * np.pi * FREQUENCY / RATE / FINE
        back, kicks = np.exp(complex(-0.05 * turn, turn)), rng.normal(size=count)
        swing = np.zeros(count, complex)
        for k in range(1, count):
            swing[k] = back * swing[k - 1] + kicks[k]
        hidden = AMPLITUDE * swing.real / swing.real.std()
    whole = np.zeros((3, 3))
    whole[:2] = [[0, 1, 0], [-100, -0.5, 1]]
    step = expm(whole / RATE / FINE)[:2]
    x, out = rng.normal(size=2) * [0.05, 0.3], np.empty((count, 2))
    for k in range(count):
        out[k] = x
        rubbing = -2 * np.tanh(x[1] / 0.01) if kind == "rubbing" else 0.0
        x = step @ [*x, drive[k] + hidden[k] + rubbing]
    noise = np.random.default_rng(seed + 10**6).normal(size=out[::FINE].shape) * 1e-3 * out.std(0)
    return drive[::FINE], out[::FINE] + noise


def subject(kind: str, number: int, recordings: int = 6, seconds: float = 20.0) -> Subject:
    """Recordings of a set of that number, the last third of them held out."""
    return recorded("pushed", Oscillator(), [recording(kind, 1000 * number + i, seconds) for i in range(recordings)])


def recorded(name: str, model: Oscillator, runs: list[tuple[np.ndarray, np.ndarray]]) -> Subject:
    """A subject of drives (N,) and states (N, 2), the last third of them held out."""
    logs = []
    for i, (u, x) in enumerate(runs):
        channels = (Channel("force", "N"),)
        made = Recording(f"run_{i}", RATE, u[:, None], x, channels, model.state_channels, np.ones(len(x), bool))
        logs.append(log_of(made, model, "force"))
    names, signals = [log.name for log in logs], ("displacement", "speed", "force")
    kept = len(names) - max(1, len(names) // 3)
    return Subject(name, model, tuple(logs), tuple(names[:kept]), tuple(names[kept:]), None, {}, {}, signals)
