"""Stated constants that the recordings contradict: let go, so that no other number has to bend for them.

Constants are held by what is stated of them. Where an equation wants one of its own constants far from there (torques
that follow their commands five times less than stated, say), every constant that two equations share gives way in its
place, and what is right in the other equation is lost. Such a constant is known no more, and that is said.
"""

import math

from bench.diagnose.select.search import View
from bench.diagnose.select.subset import Fit
from bench.diagnose.settings import CALIBRATING, LINEARISING


def contradicted(view: View, fit: Fit) -> str | None:
    """The roughly known constant whose letting go gains most, if that is more than its wider prior costs (Occam).

    Args:
        view: a linearised model.
        fit: of the effects that explain it best.
    """
    spread = {i: e.scale / abs(e.stated) for i, e in enumerate(view.linear.own) if e.constant}
    rough = {view.linear.own[i].name for i, s in spread.items() if LINEARISING.wide * (1 + 1e-9) < s < CALIBRATING.free}
    best, most = None, 0.0
    for name in sorted(rough):
        places = [i for i in spread if view.linear.own[i].name == name]
        free = view.subsets.freed(places, CALIBRATING.free).fit(fit.starts, drop=fit.dropped)
        gained = fit.loss - free.loss - sum(2 * math.log(CALIBRATING.free / spread[i]) for i in places)
        if gained > most:
            best, most = name, gained
    return best
