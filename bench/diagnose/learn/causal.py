"""Whether what a term follows is a cause: a vehicle that leans against a gust has a lean that goes with the force.

The force is then there before the lean is, so that the signal of a moment later explains more of what is left than the
signal of now. A term acts now. Of a machine's own rate this says nothing: less what it is now, which the model's own
damping tells, its later value is the very change that is to be explained, whatever makes it. Time follows nothing.
"""

from collections.abc import Sequence

import numpy as np

from bench.diagnose.learn.candidates import own_columns, view_of
from bench.diagnose.learn.held_out import HeldOut
from bench.diagnose.learn.splines import Spline, Splines
from bench.diagnose.select.search import Look, Search
from bench.diagnose.settings import LEARNING


def consequences(
    search: Search, look: Look, base: int, splines: Sequence[Spline], signals: Sequence[dict[str, np.ndarray]]
) -> list[Spline]:
    """The terms that follow what comes after them.

    Args:
        search: of the subject.
        look: at the model with constants along every axis.
        base: number of its effects without those.
        splines: the terms.
        signals: what they follow, as measured and, where inputs are noisy, with more noise.
    """
    stack = search.stack
    leads = [max(1, round(lead * stack.logs[0].pace)) for lead in LEARNING.leads]
    tried = [s.made for s in splines]
    first = len(tried)
    may_follow = [{*s.pair.signals} - {s.pair.axis, "time"} for s in splines]
    for s, names in zip(splines, may_follow, strict=True):
        for lead in leads:
            later = [{n: _advanced(x, lead) if n in names else x for n, x in of.items()} for of in signals]
            tried.append(Splines(later).of(s.pair, len(s.made.knots), bool(s.made.waves)) or s.made)
    view, places = view_of(search, look, base, [m.columns for m in tried])
    fits = HeldOut(view, own_columns(view, base, upright=True))
    blocks = [m.blocks(at) for m, at in zip(tried, places, strict=True)]
    alone = [some[fits.best(some, ())[0]] for some in blocks[:first]]
    out = []
    for i, s in enumerate(splines):
        if not may_follow[i]:
            continue
        beside = [b for j, b in enumerate(alone) if j != i]
        without, now = float(fits.losses(beside).sum()), float(fits.best(blocks[i], beside)[1].sum())
        at = range(first + i * len(leads), first + (i + 1) * len(leads))
        later_losses = [float(fits.best(blocks[k], beside)[1].sum()) for k in at]
        if now - min(later_losses) > LEARNING.better * (without - now):
            out.append(s)
    return out


def _advanced(x: np.ndarray, samples: int) -> np.ndarray:
    """A signal (L, N) as it is ``samples`` later; the last value stays."""
    return np.concatenate([x[:, samples:], np.repeat(x[:, -1:], min(samples, x.shape[1]), axis=1)], axis=1)
