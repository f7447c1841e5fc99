"""What every measured data set needs: spikes, held samples, gaps, delays, take-off and landing.

Signals are (N, c), one column a channel; masks are bool. Nothing here knows a vehicle.
"""

import numpy as np
import scipy  # its parts are imported when they are used: scipy.signal takes longer than all else here


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Start and end (exclusive) of every run of True in ``mask`` (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def spikes(x: np.ndarray, limit: float, window: int = 7) -> np.ndarray:
    """Samples (N,) of which any channel is further than ``limit`` from the median of the ``window`` around it.

    A spike of up to (window − 1) / 2 samples is found; a step that stays is not one.
    """
    return (np.abs(x - scipy.ndimage.median_filter(x, size=(window, 1), mode="mirror")) > limit).any(axis=1)


def held(x: np.ndarray) -> np.ndarray:
    """Samples (N,) in which no channel differs from the sample before."""
    return np.concatenate([[False], (np.diff(x, axis=0) == 0).all(axis=1)])


def fill(x: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """``x`` (N, c) with straight lines through the samples ``bad`` (N,); constant at the ends."""
    k = np.arange(len(x))
    return np.stack([np.interp(k, k[~bad], column[~bad]) for column in x.T], axis=1)


def resample(t: np.ndarray, x: np.ndarray, grid: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples of ``x`` on a uniform grid, linear between the measured ones.

    Args:
        t: (N,) times of the measured samples, strictly increasing [s].
        x: (N, c).
        grid: (M,) times wanted [s].
        longest: two measured samples further apart than this enclose a gap [s].

    Returns:
        (M, c), and (M,) False inside gaps and outside ``t``.
    """
    after = np.clip(np.searchsorted(t, grid), 1, len(t) - 1)
    inside = (grid >= t[0] - 1e-9) & (grid <= t[-1] + 1e-9)
    # A grid point that falls on a measured sample is valid on either side of a gap.
    on_sample = np.minimum(np.abs(grid - t[after - 1]), np.abs(grid - t[after])) < 1e-9
    valid = inside & ((t[after] - t[after - 1] <= longest) | on_sample)
    return np.stack([np.interp(grid, t, column) for column in x.T], axis=1), valid


def smooth(x: np.ndarray, window: int) -> np.ndarray:
    """Local quadratic over ``window`` samples (odd), (N, c); 0: as it is. It looks (window − 1) / 2 samples ahead."""
    return scipy.signal.savgol_filter(x, window, 2, axis=0) if window else x


def widen(mask: np.ndarray, samples: int) -> np.ndarray:
    """``mask`` (N,) with each run of True longer by ``samples`` at either end."""
    return scipy.ndimage.binary_dilation(mask, iterations=samples) if samples and mask.any() else mask


def delay(
    cause: np.ndarray, effect: np.ndarray, widest: int = 10, beside: np.ndarray | None = None
) -> tuple[float, float]:
    """By how many samples (a fraction too) ``effect`` (N, c) comes after ``cause`` (N, c), and how well they agree.

    Returns:
        Delay [samples], within ±``widest``, and the correlation there (−1 to 1): the `peak` of `agreements`.
    """
    return peak(agreements(cause, effect, widest, beside))


def peak(score: np.ndarray) -> tuple[float, float]:
    """The lag [samples] at which `agreements` (2 w + 1,) are highest, by a parabola through three, and the top one."""
    widest = len(score) // 2
    best = int(np.clip(np.argmax(score), 1, 2 * widest - 1))
    before, top, after = score[best - 1 : best + 2].tolist()
    bend = before - 2 * top + after
    return best - widest + (0.5 * (before - after) / bend if bend < 0 else 0.0), top


def agreements(cause: np.ndarray, effect: np.ndarray, widest: int = 10, beside: np.ndarray | None = None) -> np.ndarray:
    """Correlation (2 ``widest`` + 1,), mean over channels, of ``effect`` (N, c) with ``cause`` so many samples before.

    From −``widest`` to ``widest``; with ``beside`` (N, c) the partial correlation: what goes with this other cause of
    the effect, which acts at once, is taken out of both, channel by channel.
    """
    n = len(cause)
    middle = slice(widest, n - widest)
    other = np.zeros((n - 2 * widest, cause.shape[1])) if beside is None else _level(beside[middle])
    power = (other * other).sum(axis=0)

    def apart(x: np.ndarray) -> np.ndarray:
        x = _level(x)
        return np.asarray(x - other * ((other * x).sum(axis=0) / np.where(power > 0, power, 1.0)))

    a = apart(effect[middle])
    score = []
    for k in range(-widest, widest + 1):
        b = apart(cause[widest - k : n - widest - k])
        norm = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
        score.append(float(np.mean((a * b).sum(axis=0) / np.where(norm > 0, norm, 1.0))))
    return np.array(score)


def _level(x: np.ndarray) -> np.ndarray:
    return np.asarray(x - x.mean(axis=0))


def airborne(height: np.ndarray, above: float, margin: int) -> np.ndarray:
    """Samples (N,) in the air: above a height [m], at least ``margin`` samples from the ground and from the ends."""
    low = np.concatenate([[True], height <= above, [True]])
    return ~widen(low, margin)[1:-1]


def extent(mask: np.ndarray) -> slice:
    """From the first True of ``mask`` (N,) to the last; empty where there is none."""
    at = np.flatnonzero(mask)
    return slice(int(at[0]), int(at[-1]) + 1) if len(at) else slice(0, 0)
