"""Whether what was taken off inputs as noise moves the system: then it was none.

A sensor's noise moves nothing. What a drive does between the commands that were logged does: where a controller gives
two commands a sample, every second one is unknown, and what it asked for looks like white noise beside the others.
"""

import numpy as np
import torch

from bench.diagnose.logs.sample import shortened
from bench.diagnose.logs.subject import LogBatch, Subject
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.settings import SEARCHING, VERIFYING


def share_acting(before: Subject, after: Subject) -> tuple[float, float]:
    """How much of what was taken off the inputs the states answer, with its standard error; of noise 0, of motion 1.

    What the nominal model makes of it in each interval is sought in what the model leaves with what is read, in the
    same interval and in those beside it, since clocks may differ; both as changes from one interval to the next, in
    which slow effects that are missing have no part. Channels count as what is left of each lets them.

    Args:
        before: with the inputs as they were measured.
        after: with the inputs as they are read; the model is the same.

    Returns:
        The share, and infinity as its error where no channel tells.
    """
    measured, read = (LogBatch.of(shortened(of.logs, SEARCHING.longest)) for of in (before, after))
    rates = [mean_rates(after.model, stack) * read.dt for stack in (measured, read)]
    taken = (rates[0] - rates[1]).diff(dim=1).numpy()
    left = (torch.from_numpy(read.paths).diff(dim=1) - rates[1]).diff(dim=1).numpy()
    good = (read.good[:, :-1] & read.good[:, 1:]).numpy()
    whole = good[:, :-2] & good[:, 1:-1] & good[:, 2:]
    gram, moment = np.zeros((3, 3)), np.zeros(3)
    for c in read.measured:
        x = np.stack([taken[:, :-2, c], taken[:, 1:-1, c], taken[:, 2:, c]], axis=-1)[whole]
        y = left[:, 1:-1, c][whole]
        if len(x) <= 3 or not np.isfinite(x).all() or not np.abs(x).max() > 0:
            continue
        variance = float(np.mean((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))
        if variance > 0:
            gram, moment = gram + x.T @ x / variance, moment + x.T @ y / variance
    if not gram.any():
        return 0.0, np.inf
    inverse = np.linalg.pinv(gram, hermitian=True)
    return float((inverse @ moment).sum()), max(float(inverse.sum()), 0.0) ** 0.5


def acts(share: float, error: float) -> bool:
    """Whether a share of one is plainly more likely than none."""
    return 2 * share - 1 > VERIFYING.odds * error**2
