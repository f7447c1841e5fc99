"""The best manoeuvre of a family, by differential evolution: a whole generation is simulated side by side.

Storn and Price, "Differential evolution", Journal of Global Optimization 11 (1997), as SciPy has it.
"""

from collections.abc import Callable

import numpy as np
import scipy  # its parts are imported when they are used: scipy.optimize takes longer than most of what is here

from bench.diagnose.manoeuvre.discrimination import Judge
from bench.diagnose.settings import COMPOSING


def best(
    judge: Judge, others: np.ndarray, tick: Callable[[float], None] = lambda share: None, seed: int = 0
) -> np.ndarray:
    """The best manoeuvre (1, R, N, c).

    Args:
        judge: weighs manoeuvres.
        others: (V, R, N, c) that are weighed as well, such as the stock ones.
        tick: called with the share of the work that is done.
        seed: of the search.
    """
    player, done = judge.player, [0]

    def loss(z: np.ndarray) -> np.ndarray:
        done[0] += 1
        tick(done[0] / (COMPOSING.generations + 2))
        return -judge.weigh(player.asked(z.T))

    found = scipy.optimize.differential_evolution(
        loss,
        [(0.0, 1.0)] * player.size,
        init=_first(player.size, seed),
        maxiter=COMPOSING.generations,
        tol=0.0,
        mutation=(0.4, 0.9),
        recombination=0.7,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=seed,
    )
    among = np.concatenate([player.asked(found.x[None]), others])
    return among[[int(np.argmax(judge.weigh(among)))]]


def _first(size: int, seed: int) -> np.ndarray:
    """(M, size) to begin with: `COMPOSING.population` of them."""
    return np.random.default_rng(seed).uniform(size=(COMPOSING.population, size))
