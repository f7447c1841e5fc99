"""What a manoeuvre would tell: the probability that a diagnosis names the right candidate, and expected intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import ndtr, ndtri

from bench.diagnose.logs.subject import Log
from bench.diagnose.manoeuvre.play import Played, Player
from bench.diagnose.manoeuvre.separation import (
    Candidate,
    Distance,
    Windows,
    distance,
    imitated,
    information,
    log_determinant,
    predictions,
)
from bench.diagnose.settings import ASSURING, CHOOSING, FOLDING, VERIFYING


def scores(found: Distance, often: float = 1.0, block: int = 1, beside: int = 0) -> np.ndarray:
    """(W,): by how many standard deviations a diagnosis is expected to tell the rival apart.

    Twice the log likelihood ratio is normal about its mean D with variance 4 D; a diagnosis asks that it exceeds
    `VERIFYING.odds` and `CHOOSING.distinct` times its spread over blocks of some seconds.

    Args:
        found: of W manoeuvres.
        often: repetitions of each.
        block: windows of a block.
        beside: blocks of the recordings at hand, in which the candidates do equally well.
    """
    edges = np.arange(0, found.rest.shape[1], block)
    blocks = np.add.reduceat(found.rest, edges, axis=1)
    total, count = often * found.total, often * blocks.shape[1] + beside
    squares = often * (blocks**2).sum(1) - (often * blocks.sum(1)) ** 2 / count
    spread = np.sqrt(np.maximum(squares, 0.0))
    return np.asarray((total - VERIFYING.odds - CHOOSING.distinct * spread) / (2 * np.sqrt(np.maximum(total, 1.0))))


@dataclass(frozen=True, eq=False)
class Judge:
    """Weighs manoeuvres by what they would tell of candidates (two or more) or of one model's parameters."""

    player: Player
    candidates: tuple[Candidate, ...]
    windows: Windows
    asked: tuple[int, ...] = ()
    """Of one candidate: the numbers whose intervals are to be narrow."""
    often: float = 1.0
    """Repetitions that a search plans for."""

    @torch.inference_mode()
    def weigh(self, asked: np.ndarray) -> np.ndarray:
        """(W,): the larger the better; every candidate flies them, and all others look at what it makes of them."""
        value, over = np.zeros(len(asked)), np.zeros(len(asked))
        for i, true in enumerate(self.candidates):
            played = self.player.play(true.model, asked)
            over = np.maximum(over, played.outside(self.player.limits))
            inside = np.flatnonzero(over <= ASSURING.inside)
            if len(inside):
                value[inside] += self._value(_part(played, inside), i)
        return np.where(over <= ASSURING.inside, value, -1e3 - 1e3 * np.minimum(over, 1e3))

    @torch.inference_mode()
    def inside(self, asked: np.ndarray) -> bool:
        """Whether no candidate leaves the limits in one manoeuvre, (1, R, N, c)."""
        over = (self.player.play(c.model, asked).outside(self.player.limits) for c in self.candidates)
        return bool(all((o <= ASSURING.inside).all() for o in over))

    def _value(self, played: Played, truth: int) -> np.ndarray:
        """(W,) if this candidate is the truth, which ``played`` shows."""
        count, logs = len(played.asked), self.player.logs(played)
        if self.asked:
            slopes = predictions(self.candidates[truth], logs, self.windows)[1]
            known = self.candidates[truth].known
            return log_determinant(information(_by(count, slopes), known, self.often), self.asked)
        seen, total = self.windows.measured(logs), np.zeros(count)
        own = self._own(truth, logs).reshape(count, -1)
        for j, rival in enumerate(self.candidates):
            if j != truth:
                base, slopes = predictions(rival, logs, self.windows)
                away = _by(count, self.windows.whitened(seen, base))
                apart = distance(away, _by(count, slopes), rival.known, self.often).beyond(own)
                total += np.clip(self._scores(apart, self.often), ASSURING.worst, ASSURING.best)
        return total

    def _scores(self, apart: Distance, often: float) -> np.ndarray:
        dt, length = self.player.dt, self.windows.steps * self.player.dt
        block = max(1, round(_block(self.player.samples * dt, self.player.log.second) / length))
        beside = sum(len(log) * dt / _block(len(log) * dt, log.second) for log in self.player.subject.logs)
        recorded = sum(len(log) for log in self.player.subject.logs) / self.windows.steps
        # What leaves so much more than noise does is no rival, in however few blocks it shows.
        loud = VERIFYING.loud * len(self.windows.whitening) * (often * apart.rest.shape[1] + recorded)
        found = scores(apart, often, block, int(beside))
        return np.where(often * apart.total > loud, np.maximum(found, ASSURING.best), found)

    def _own(self, truth: int, logs: Sequence[Log]) -> np.ndarray:
        """(n,): squared errors of the true candidate itself, which noise makes."""
        seen = self.windows.measured(logs)
        ahead = self.windows.predicted(self.candidates[truth].model, logs)
        return np.asarray((self.windows.whitened(seen, ahead) ** 2).sum(-1))

    @torch.inference_mode()
    def chances(self, asked: np.ndarray, often: Sequence[int]) -> tuple[np.ndarray, int | None]:
        """Probability that a diagnosis identifies the true candidate after one manoeuvre, flown so many times.

        Args:
            asked: one manoeuvre, (1, R, N, c).
            often: numbers of repetitions.

        Returns:
            (truths, repetitions): the chance that each candidate, if it is the truth, is told from all others; and the
            first of `ASSURING.tried` repetitions after which their mean is `ASSURING.sure`, None where all are too few.
        """
        flights = [self.player.logs(self.player.play(c.model, asked)) for c in self.candidates]
        known: dict[int, np.ndarray] = {}

        def chance(times: int) -> np.ndarray:
            if times not in known:
                known[times] = np.array([self._chance(i, logs, times) for i, logs in enumerate(flights)])
            return known[times]

        needed = next((n for n in ASSURING.tried if chance(n).mean() >= ASSURING.sure), None)
        return np.stack([chance(n) for n in often], axis=1), needed

    def _chance(self, truth: int, logs: Sequence[Log], times: int) -> float:
        seen, own, lowest = self.windows.measured(logs), self._own(truth, logs)[None], 1.0
        for j, rival in enumerate(self.candidates):
            if j != truth:
                apart = imitated(seen, rival, logs, self.windows, times).beyond(own)
                lowest = min(lowest, float(ndtr(self._scores(apart, times)[0])))
        return lowest

    @torch.inference_mode()
    def widths(self, asked: np.ndarray, often: Sequence[int]) -> np.ndarray:
        """(numbers, repetitions): expected half widths of 95 % intervals of the numbers asked for, SI."""
        c = self.candidates[0]
        logs = self.player.logs(self.player.play(c.model, asked))
        _, slopes = predictions(c, logs, self.windows)
        made = [np.linalg.pinv(information(slopes[None], c.known, n)[0]) for n in often]
        at = list(self.asked)
        return np.stack([ndtri(0.975) * np.sqrt(np.diag(m)[at]) * c.scales[at] for m in made], axis=1)


def _block(seconds: float, second: float) -> float:
    """Length of the blocks that a diagnosis cuts a recording of so many seconds into: five at least."""
    return min(FOLDING.block * second, seconds / 5)


def _by(count: int, x: np.ndarray) -> np.ndarray:
    """(W, n, …) of (W · n, …)."""
    return x.reshape(count, -1, *x.shape[1:])


def _part(played: Played, at: np.ndarray) -> Played:
    runs = played.asked.shape[1]
    rows = (at[:, None] * runs + np.arange(runs)).ravel().tolist()
    return Played(played.asked[at], played.inputs[rows], played.states[rows])
