"""The thresholds of the network that tells how much a model leaves to find."""

from dataclasses import dataclass

from bench.diagnose.settings.threshold import Basis, threshold


@dataclass(frozen=True)
class Ceiling:
    """The network around the last model, and what is said of it."""

    points: int = threshold(
        256,
        "samples of a horizon that a network sees, at most; of a longer one evenly spread ones",
        Basis.EFFORT,
        "count",
    )
    history: int = threshold(64, "samples of the history that it sees, at most", Basis.EFFORT, "count")
    short: float = threshold(
        0.1,
        "length of the runs whose deviations the history shows, as a share of the horizon: long enough to stand out of "
        "noise, short enough to be local",
        Basis.JUDGED,
    )
    windows: int = threshold(4000, "free runs of training recordings to learn from, about", Basis.EFFORT, "count")
    confirming: int = threshold(
        500, "free runs that stop a training and tell how far it is to be believed, about", Basis.EFFORT, "count"
    )
    fold: int = threshold(
        5,
        "every so many-th training recording is kept from learning, for these; of fewer each one's end",
        Basis.CONVENTION,
    )
    end: float = threshold(0.2, "share of a recording that is its end", Basis.CONVENTION)
    end_horizons: float = threshold(1.5, "and its least length, in horizons", Basis.JUDGED)
    seeds: int = threshold(3, "networks, from the seeds 0, 1, 2; their mean is the prediction", Basis.EFFORT, "count")
    hidden: int = threshold(32, "cells of a network, and of the one that reads the history", Basis.EFFORT, "count")
    updates: int = threshold(
        2000, "updates of the weights at most: about two minutes for all networks on one core", Basis.EFFORT, "count"
    )
    patience: int = threshold(
        8, "hundreds of updates without gain on the confirming runs that end a training", Basis.EFFORT, "count"
    )
    weight_decay: float = threshold(0.01, "decoupled weight decay", Basis.CONVENTION)
    start: float = threshold(
        0.1,
        "of the typical deviation at the end, what counts as typical at the start at least, where noise is most of it",
        Basis.JUDGED,
    )
    far: float = threshold(10.0, "standard deviations beyond which a signal is shown as that", Basis.CONVENTION, "σ")
    little: float = threshold(
        0.8,
        "error above the floor that the network leaves, relative to the model's, from which little is left to learn, "
        "and below which something is missing",
        Basis.JUDGED,
    )
