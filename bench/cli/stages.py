"""How far a diagnosis is: its stages, weighted by what each costs."""

import time
from dataclasses import dataclass, field

Stages = dict[str, tuple[float, int]]
"""By name, in order: seconds of the stage, and how many things it says that it does."""

DIAGNOSE: Stages = {
    "check the data": (0.7, 1),
    "noise": (0.3, 1),
    "input timing": (4.3, 24),  # with the first look at every effect of the catalogue
    "what is left": (2.2, 24),
    "weigh": (1.9, 1),
    "extend": (0.5, 1),
    "shooting": (0.5, 4),
    "compare recordings": (0.1, 1),
    "locate": (1.5, 1),
}
"""Of `bench diagnose` on six flights of 30 s: seconds of one core. What else is learned takes longer than that says."""
DISCOVER: Stages = {name: DIAGNOSE[name] for name in ("input timing", "what is left", "weigh")}
COMPARE: Stages = {"shooting": (0.6, 4), "free runs": (0.4, 1)}
LOCATE: Stages = {"shooting": (0.6, 4), "locate": (0.4, 1)}
EARLY = 0.1
"""Share of the work before which its pace says little."""
UNFORESEEN = ("calibrate", "learned terms", "what swings")
"""Stages that take as long as the data want: nothing is said of the time left from there on."""


@dataclass
class StageProgress:
    """Where the work is on its way through the stages."""

    stages: Stages
    started: float = field(default_factory=lambda: time.monotonic())
    _stage: int = -1
    _said: int = 0
    """Things that were said in this stage."""
    _at: float = 0.0
    """Seconds after the start at which the last thing was said."""
    _most: float = 0.0
    """The largest share that was told."""
    _lost: bool = False

    def begin(self, what: str) -> None:
        """A stage begins, or one more thing in it."""
        self._at = self.elapsed
        self._lost = self._lost or what in UNFORESEEN
        place = [*self.stages].index(what) if what in self.stages else -1
        if place > self._stage:
            self._stage, self._said = place, 0
        else:
            self._said += 1

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.started

    @property
    def share(self) -> float | None:
        """Of the work that is done; None: unknown. Between two things that are said it goes on at the pace so far.

        It does not pass the end of a stage before the next one begins, and never goes back.
        """
        if self._lost or self._stage < 0:
            return None
        costs = [seconds for seconds, _ in self.stages.values()]
        before, here = sum(costs[: self._stage]), costs[self._stage]
        part = min(1.0, self._said / [count for _, count in self.stages.values()][self._stage])
        done, end = (before + part * here) / sum(costs), (before + here) / sum(costs)
        at_this_pace = min(end, done * self.elapsed / self._at) if done and self._at else done
        self._most = max(self._most, at_this_pace)
        return self._most

    @property
    def left(self) -> float | None:
        """Seconds left at the pace so far; None: not known yet."""
        share = self.share
        return self.elapsed * (1 / share - 1) if share and share >= EARLY else None
