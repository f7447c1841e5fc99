"""Learn the terms that a model lacks and no catalogue has; each is accepted by recordings that were not fitted."""

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch

from bench.diagnose.learn.candidates import (
    Columns,
    Pair,
    crosses,
    own_columns,
    pairs,
    paths,
    products,
    view_of,
    with_axes,
)
from bench.diagnose.learn.causal import consequences
from bench.diagnose.learn.formulas import Formula, block_of, fitted, option_columns, options, refined, simplest, span_of
from bench.diagnose.learn.held_out import Block, HeldOut
from bench.diagnose.learn.splines import Made, Spline, Splines, chosen, confirmed
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.choose import updated
from bench.diagnose.select.materiality import Saving, Weighing
from bench.diagnose.select.search import Look, Search
from bench.diagnose.select.timing.reading import prepared
from bench.diagnose.settings import LEARNING, SPLINING
from bench.diagnose.simulate.unmeasured import hidden
from registry.dynamics import Effect, PhysicsModel
from registry.dynamics.model import RATE_OF
from registry.effects.learned_term import LearnedTerm
from registry.errors import BenchError
from registry.terms.shapes import SPLINE

E = TypeVar("E", bound=Effect)


def learn(
    subject: Subject,
    model: PhysicsModel,
    noise: Noise | None = None,
    tick: Callable[[str], None] = lambda what: None,
    only: Pair | None = None,
    doubtful: bool = False,
) -> tuple[LearnedTerm, ...]:
    """The terms that ``model`` lacks, estimated in the weak form, as formulas where those are as good as a spline.

    Args:
        subject: measurements; terms are sought in the training recordings and weighed on those held out.
        model: with the effects that it has, its constants calibrated.
        noise: default `noise.noise_of`.
        tick: called with what is being done.
        only: the axis and signals of the one term that is asked for; it is not gated.
        doubtful: whether nothing says that something follows a signal: then a term must save a large share.

    Raises:
        BenchError: states that the terms would follow were not measured, or the signal asked for does not vary.
    """
    subject, noise = prepared(subject, noise, tick)
    if hidden(subject.logs):
        if only is None:
            return ()
        raise BenchError("A term cannot be learned here: not all states of the model were measured.")
    tick("learned terms")
    search = Search(subject, (), tick, noise)
    base = len(model.effects)
    with torch.no_grad():
        look = search.look(with_axes(model), broad=False)
        signals = [paths(model, s) for s in (search.stack, search.noisy) if s is not None]
        seen = _Seen(search, look, base, signals)
        splines = seen.asked(only) if only is not None else seen.sought(_measured(subject, pairs(model)))
        if not splines:
            return ()
        splines = seen.finer(splines)
        tick("formulas")
        splines, terms = seen.as_distinct_formulas(splines)
        if only is not None:
            return terms
        kept = worthy(subject, noise, search, model, terms, doubtful)
        plain = not kept and any(t.shape != SPLINE for t in terms)
        if plain:
            # A formula that bends may be led astray when all numbers are fitted; what was confirmed is its spline.
            terms = seen.as_formulas(splines, plain)
            kept = worthy(subject, noise, search, model, terms, doubtful)
        while 0 < len(kept) < len(terms):  # what a term looks like depends on what stands beside it
            splines = [s for s, t in zip(splines, terms, strict=True) if any(t is k for k in kept)]
            splines, terms = seen.as_distinct_formulas(splines, plain)
            kept = worthy(subject, noise, search, model, terms, doubtful)
        return kept


@dataclass(frozen=True, eq=False)
class _Seen:
    """The training recordings, linearised about the model with a constant along every axis."""

    search: Search
    look: Look
    base: int
    """Number of effects of the model without these constants."""
    signals: Sequence[dict[str, np.ndarray]]
    """What terms can follow: as measured and, where inputs are noisy, with more noise."""

    def fits(self, columns: Sequence[Columns], upright: bool = False) -> tuple[HeldOut, list[np.ndarray]]:
        """Fits of columns, and the places of each; ``upright``: beside what a constant thrust and weight explain."""
        view, places = view_of(self.search, self.look, self.base, columns)
        return HeldOut(view, own_columns(view, self.base, upright), within=not upright), places

    def made(self, some: Sequence[Pair], waves: bool = False, fine: bool = False) -> list[Made]:
        """The splines of pairs whose signals vary.

        Args:
            some: the pairs.
            waves: whether waves stand beside the splines of what says where a system is.
            fine: whether these have as many knots as the shortest wave needs.
        """
        poses, splines, found = poses_of(self.look.linear.model), Splines(self.signals), []
        for pair in some:
            wavy = waves and len(pair.signals) == 1 and _of_a_pose(pair, poses)
            found.append(splines.of(pair, _knots(pair, poses, fine), wavy))
        return [m for m in found if m is not None]

    def asked(self, only: Pair) -> list[Spline]:
        """The one term that was asked for."""
        made = self.made([only])
        if not made:
            raise BenchError(f"{only.signals[0]} hardly varies in these recordings: nothing can follow it.")
        fits, places = self.fits([made[0].columns])
        return [Spline(only, made[0], fits.best(made[0].blocks(places[0]), ())[0])]

    def sought(self, offered: Sequence[Pair]) -> list[Spline]:
        """The terms that recordings left out of the fit confirm, of what acts now; of nothing else, short waves."""
        poses = poses_of(self.look.linear.model)
        of_poses = [p for p in offered if _of_a_pose(p, poses)]
        waves = len(of_poses) <= LEARNING.few_waves
        return self._coarse(offered, waves) or self._acting(of_poses, waves=True, fine=True)

    def _coarse(self, offered: Sequence[Pair], waves: bool) -> list[Spline]:
        """With the knots that most shapes need."""
        if len(offered) ** 2 <= LEARNING.few:
            return self._acting([*offered, *products(offered)], waves)
        splines = self._acting(offered, waves)
        crossed = self._crossed(offered, splines)
        if not splines and not crossed:
            return []
        found = [s.pair for s in splines]
        axes = {p.axis for p in (*found, *crossed)}
        alone = [p for p in offered if p.axis in axes]
        return self._acting([*alone, *dict.fromkeys((*products(alone, found), *crossed))], waves)

    def _crossed(self, offered: Sequence[Pair], splines: Sequence[Spline]) -> list[Pair]:
        """Products of two signals that recordings left out confirm, though neither signal may matter by itself."""
        both = crosses(offered)
        if not both:
            return []
        signals = self.signals
        made = [Columns(p, tuple((of[p.signals[0]] * of[p.signals[1]])[None] for of in signals)) for p in both]
        fits, places = self.fits([*made, *(s.made.columns for s in splines)], upright=True)
        beside = [s.block(at) for s, at in zip(splines, places[len(both) :], strict=True)]
        now = fits.losses(beside)
        gains = [now - fits.losses([*beside, Block(at)]) for at in places[: len(both)]]
        least = SPLINING.gain * fits.rows
        order = sorted(range(len(both)), key=lambda i: -float(gains[i].sum()))
        best = [both[i] for i in order if confirmed(gains[i], least)][: SPLINING.first]
        return [Pair(p.axis, names) for p in best for names in (p.signals, p.signals[::-1])]

    def _acting(self, offered: Sequence[Pair], waves: bool = False, fine: bool = False) -> list[Spline]:
        splines: list[Spline] = []
        for _ in range(LEARNING.tries):
            made = self.made(offered, waves, fine)
            if not made:
                return []
            fits, places = self.fits([m.columns for m in made], upright=True)
            splines = chosen(fits, made, places)
            if not splines:
                return []
            later = {s.pair for s in consequences(self.search, self.look, self.base, splines, self.signals)}
            if not later:
                return splines
            splines = [s for s in splines if s.pair not in later]
            offered = [p for p in offered if p not in later]
        return splines

    def finer(self, splines: Sequence[Spline]) -> list[Spline]:
        """Splines, those of more knots that recordings left out gain by: what is narrow falls between few."""
        made, plain = Splines(self.signals), len(SPLINING.penalties)
        fine = [made.of(s.pair, SPLINING.knots_of_a_wave) if s.which < plain else None for s in splines]
        fits, places = self.fits([m.columns for m in (*(s.made for s in splines), *filter(None, fine))], upright=True)
        rest, out = iter(places[len(splines) :]), list(splines)
        blocks = [s.block(at) for s, at in zip(splines, places[: len(splines)], strict=True)]
        for i, more in enumerate(fine):
            if more is None:
                continue
            own, beside = more.splines(next(rest)), blocks[:i] + blocks[i + 1 :]
            which, losses = fits.best(own, beside)
            if confirmed(fits.losses(blocks) - losses, SPLINING.gain * fits.rows):
                out[i], blocks[i] = Spline(splines[i].pair, more, which), own[which]
        return out

    def as_distinct_formulas(
        self, splines: list[Spline], plain: bool = False
    ) -> tuple[list[Spline], tuple[LearnedTerm, ...]]:
        """Splines, and each as a formula, without those that turn out to say the same as another one.

        A product of which the first factor is constant is a function of the second; beside another function of that the
        two would share one force between them, and may grow without bound.
        """
        while True:
            terms = self.as_formulas(splines, plain)
            said = [(t.axis, t.signals) for t in terms]
            again = {i for i, s in enumerate(splines) if s.pair.signals != said[i][1] and said.count(said[i]) > 1}
            if not again:
                return splines, terms
            splines = [s for i, s in enumerate(splines) if i not in again]

    def as_formulas(self, splines: Sequence[Spline], plain: bool = False) -> tuple[LearnedTerm, ...]:
        """Every spline as the simplest formula that is not worse, or as it is; ``plain``: all as they are."""
        signals, poses = self.signals, poses_of(self.look.linear.model)
        some = [[] if plain else options(signals[0][s.pair.signals[0]], _of_a_pose(s.pair, poses)) for s in splines]
        found: list[Formula | None] = [None] * len(splines)
        which = [s.which for s in splines]
        terms: list[LearnedTerm] = []
        for _ in range(LEARNING.rounds):
            columns = [s.made.columns for s in splines]
            columns += [option_columns(s.pair, tried, signals) for s, tried in zip(splines, some, strict=True) if tried]
            fits, places = self.fits(columns)
            smooth, rest = places[: len(splines)], iter(places[len(splines) :])
            formulas = [next(rest) if tried else np.empty(0, dtype=int) for tried in some]
            blocks = [
                s.made.blocks(smooth[i])[which[i]]
                if (f := found[i]) is None
                else block_of(f.shape, some[i], formulas[i])
                for i, s in enumerate(splines)
            ]
            terms = []
            for i, s in enumerate(splines):
                beside = [b for j, b in enumerate(blocks) if j != i]
                which[i], losses = fits.best(s.made.splines(smooth[i]), beside)
                best = fitted(fits, some[i], formulas[i], beside, signals[0][s.pair.signals[0]])
                formula = found[i] = simplest(best, losses, fits.losses(beside))
                some[i] = refined(best)
                if formula is None:
                    blocks[i] = s.made.splines(smooth[i])[which[i]]
                    values = tuple(map(float, s.made.turn @ fits.fit([*beside, blocks[i]])[-1]))
                    span = span_of(signals[0][s.pair.signals[0]])
                    terms.append(LearnedTerm(s.pair.axis, s.pair.signals, SPLINE, values, s.made.knots, span))
                else:
                    blocks[i] = formula.block
                    terms.append(_term(s.pair, formula.shape, formula.values, signals[0]))
        return tuple(terms)


def poses_of(model: PhysicsModel) -> set[str]:
    """Groups of signals that say where a system is: those whose rate of change is another state."""
    return {"height", *RATE_OF, *(c.group for c in model.state_channels)} - set(model.equation_names())


def _of_a_pose(pair: Pair, poses: Container[str]) -> bool:
    """Whether its first signal says where the system is."""
    return pair.signals[0].partition(".")[0] in poses


def _knots(pair: Pair, poses: Container[str], fine: bool) -> int:
    """Knots of its splines: more where the first signal says where the system is."""
    if not _of_a_pose(pair, poses):
        return SPLINING.knots
    return SPLINING.knots_of_a_wave if fine else SPLINING.knots_of_a_pose


def _measured(subject: Subject, offered: Sequence[Pair]) -> list[Pair]:
    """The pairs whose signals were measured, and whose axes move what was."""
    model, measured = subject.model, [all(m) for m in zip(*(log.measured for log in subject.logs), strict=True)]
    unseen = {c.name for c, seen in zip(model.state_channels, measured, strict=True) if not seen}
    groups = {name.rpartition(".")[0] for name in unseen}
    needs = {"height": "position", "airspeed": "velocity", "body_velocity": "velocity", "roll": "attitude"}
    needs |= {"pitch": "attitude"}

    def seen(pair: Pair) -> bool:
        names = {s.partition(".")[0] for s in pair.signals}
        return pair.axis not in unseen and not {needs.get(n, n) for n in names} & (groups | unseen)

    return [p for p in offered if seen(p)]


def _term(pair: Pair, shape: str, values: tuple[float, ...], signals: dict[str, np.ndarray]) -> LearnedTerm:
    """A formula of a pair; a constant follows no signal, and times a second one is linear in that."""
    follows = pair.signals
    if shape == "constant":
        follows, shape = (pair.signals[1:], "linear") if len(pair.signals) > 1 else ((), shape)
    return LearnedTerm(pair.axis, follows, shape, values, (), span_of(signals[(follows or pair.signals)[0]]))


def worthy(
    subject: Subject,
    noise: Noise,
    search: Search,
    model: PhysicsModel,
    terms: Sequence[E],
    doubtful: bool,
) -> tuple[E, ...]:
    """The terms that save enough, for sure, on held-out recordings; the least goes first.

    Args:
        subject: measurements.
        noise: of them.
        search: of the subject.
        model: without the terms.
        terms: to choose from.
        doubtful: whether a term must save a large share.
    """
    if not subject.held_out:
        return tuple(terms)
    weighing, kept = Weighing(subject, noise, model), list(terms)
    while kept:
        full = refitted(search, replace(model, effects=(*model.effects, *kept)))
        savings = []
        for i in range(len(kept)):
            others = [t for j, t in enumerate(kept) if j != i]
            rest = refitted(search, replace(model, effects=(*model.effects, *others)))
            savings.append(weighing.savings(rest, full, full))
        idle = [
            i
            for i, s in enumerate(savings)
            if not any(_worth(one, doubtful) for one in s) or any(one.harms for one in s)
        ]
        if not idle:
            break
        kept.pop(min(idle, key=lambda i: max(one.share for one in savings[i])))
    return tuple(kept)


def refitted(search: Search, model: PhysicsModel) -> PhysicsModel:
    """The model with all its numbers fitted together in the weak form: without a term they stood in for it."""
    for _ in range(LEARNING.steps):
        view = min(search.views(search.own(model, settled=True)), key=lambda v: v.subsets.fit().prior)
        model = updated(view, view.subsets.fit())
    return model


def _worth(saving: Saving, doubtful: bool) -> bool:
    """Whether a term is worth it, and where that is doubtful large."""
    return saving.worth and (not doubtful or saving.share >= LEARNING.large)
