"""The linear filter that measured states went through, as data show it or as their owner states it."""

from dataclasses import dataclass, replace

import numpy as np

from bench.diagnose.logs.filters import savitzky_golay
from bench.diagnose.settings import HEARING
from registry.errors import BenchError, near

KINDS = ("none", "savgol", "mean")


@dataclass(frozen=True)
class Smoothing:
    """A symmetric moving filter over ``window`` samples.

    Velocities and rates are mostly not measured but read from the same local polynomial as the pose: ``derived``.
    """

    kind: str = "none"
    window: int = 1
    order: int = 0
    """Of the local polynomial (savgol)."""
    derived: bool = False
    differenced: bool = False
    """Whether they are central differences of the smoothed pose instead (a moving mean has no other slope)."""
    stride: int = 1
    """Samples of which one was kept after the filter."""
    straight: bool = False
    """Whether what drives is a straight line from sample to sample, so that rates at a sample are read from the four
    intervals about it; else from the two beside it, which is right where an input that holds steps there."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise BenchError(f"smoothing: kind = {self.kind!r}: {near(str(self.kind), KINDS)}")
        if self.kind != "none" and (self.window < 3 or self.window % 2 == 0):
            raise BenchError(f"smoothing: window = {self.window!r} must be an odd number of samples, 3 or more.")
        if self.window > HEARING.longest_window:
            raise BenchError(
                f"smoothing: window = {self.window!r:.60} is longer than {HEARING.longest_window} samples: "
                "no filter is."
            )
        if self.kind == "savgol" and self.order > HEARING.highest_order:
            raise BenchError(
                f"smoothing: order = {self.order!r:.60} is no local polynomial: give {HEARING.highest_order} at most."
            )
        if self.kind == "savgol" and not 0 < self.order < self.window:
            raise BenchError(f"smoothing: order = {self.order!r} must lie between 1 and window − 1.")

    def kernel(self) -> np.ndarray:
        """Weights (w,) with which increments of the true signal enter those of the smoothed one; they sum to 1.

        Where samples were left out, weights on the increments from one that was kept to the next.
        """
        return _coarser(self._own_kernel(), self.stride)

    def _own_kernel(self) -> np.ndarray:
        """Weights on increments of all samples.

        A signal that is the derivative of a smoothed one is an average of true increments too: the derivative
        weights d_j on the pose are, summed by parts, weights on its mean velocity over the sampling intervals.
        """
        if self.kind == "none":
            # A derived signal is at least a central difference of its pose.
            return np.array([0.25, 0.5, 0.25]) if self.derived else np.ones(1)
        mean = self.kind == "mean"
        own = np.full(self.window, 1 / self.window) if mean else savitzky_golay(self.window, self.order)
        if not self.derived:
            return np.asarray(own)
        if mean or self.differenced:
            weights = np.convolve(own, [0.5, 0.5])
        else:
            slopes = savitzky_golay(self.window, self.order, slope=True)
            weights = np.cumsum(slopes[::-1])[:-1]
        return np.convolve(weights, np.array([-1, 13, 13, -1]) / 24 if self.straight else [0.5, 0.5])

    def coarser(self, stride: int) -> "Smoothing":
        """The same filter where only every ``stride``-th sample is kept; none where too few of these feel it."""
        if stride == 1 or self.kind == "none":
            return self
        felt = self.resampled(stride).kind != "none"
        return replace(self, stride=self.stride * stride) if felt else Smoothing()

    def resampled(self, apart: float) -> "Smoothing":
        """About the same filter of samples so many times as far apart, as if it was they that went through it."""
        if self.kind == "none":
            return self
        window = 2 * round((self.window / apart - 1) / 2) + 1
        return replace(self, window=window) if window > max(self.order, 1) else Smoothing()

    def __str__(self) -> str:
        """As a report says it."""
        what = {
            "none": "no smoothing",
            "mean": f"a moving mean over {self.window} samples",
            "savgol": f"Savitzky–Golay over {self.window} samples, order {self.order}",
        }[self.kind]
        read = ", rates are central differences of the pose" if self.differenced else ", rates read from the pose"
        return what + (read if self.derived else "")


def _coarser(kernel: np.ndarray, stride: int) -> np.ndarray:
    """Weights (v,) on the means over ``stride`` samples that do what a symmetric ``kernel`` (w,) does on all.

    Each sample's weight goes to the six means about it as the polynomial through these says (Lagrange), so that moments
    up to the fifth are kept: of a slope of a local cubic the fourth is the first that is not zero.
    """
    if stride == 1:
        return kernel
    at = (np.arange(len(kernel)) - len(kernel) // 2) / stride
    nodes = np.floor(at).astype(int)[:, None] + np.arange(-2, 4)
    same = np.eye(6, dtype=bool)
    others = np.where(same, 1.0, (at[:, None] - nodes)[:, None, :] / (nodes[:, :, None] - nodes[:, None, :] + same))
    reach = int(at[-1]) + 3
    out = np.zeros(2 * reach + 1)
    np.add.at(out, nodes + reach, kernel[:, None] * others.prod(axis=2))
    return np.trim_zeros((out + out[::-1]) / 2)


@dataclass(frozen=True)
class Slope:
    """Where a state comes from that was not measured: it is the rate of another one."""

    of: int
    """Place of that among the model's states."""
    smoothing: Smoothing
    """The local polynomial whose slope it is; ``derived``."""


def stated(processing: dict[str, object]) -> Smoothing | None:
    """The filter that a description's [processing] states, or None.

    Raises:
        BenchError: a filter of an unknown kind or impossible size.
    """
    table = processing.get("smoothing")
    if table is None:
        return None
    if not isinstance(table, dict) or set(table) - {"kind", "window", "order"}:
        raise BenchError('[processing] smoothing must be written {kind = "savgol", window = 9, order = 3}.')
    window, order = table.get("window", 1), table.get("order", 3)
    if type(window) is not int or type(order) is not int:
        raise BenchError("[processing] smoothing: window and order are whole numbers of samples.")
    return Smoothing(str(table.get("kind", "savgol")), window, order, derived=True)
