"""Stated constants that the recordings contradict: let go, so that no other number has to bend for them.

Constants are held by what is stated of them. Where an equation wants one of its own constants far from there (torques
that follow their commands five times less than stated, say), every constant that two equations share gives way in its
place, and what is right in the other equation is lost. Such a constant is known no more, and that is said.
"""

import numpy as np

from bench.diagnose.regression.linearise import WIDE
from bench.diagnose.regression.parameters import FREE
from bench.diagnose.select.search import View
from bench.diagnose.select.subset import Fit

OWN = 0.5
"""Share of the misfit that letting go gains which must lie in equations in which the constant itself acts."""


def contradicted(view: View, fit: Fit) -> str | None:
    """The roughly known constant that is worth letting go: what it gains is more than its wider prior costs (Occam).

    What it gains must lie where it acts: one that would only make room for another is not the one that is wrong.

    Args:
        view: a linearised model.
        fit: of the effects that explain it best.
    """
    own = view.linear.own
    spread = {i: e.scale / abs(e.stated) for i, e in enumerate(own) if e.constant}
    rough = {own[i].name for i, s in spread.items() if WIDE * (1 + 1e-9) < s < FREE}
    best, most = None, 0.0
    before = view.subsets.losses(fit).sum(0)
    for name in sorted(rough):
        places = [i for i, e in enumerate(own) if e.constant and e.name == name]
        free = view.subsets.freed(places, FREE)
        after = free.fit(fit.starts, drop=fit.dropped)
        gained = before - free.losses(after).sum(0)
        acting = np.abs(view.linear.columns[places]).max((0, 1, 2)) > 0
        price = sum(2 * np.log(FREE / spread[i]) for i in places)
        worth = fit.loss - after.loss - price
        if worth > most and gained[acting].sum() > OWN * gained.sum() - price:
            best, most = name, worth
    return best
