"""Which effects that a model was found to lack are sure and worth a term: what each saves on held-out recordings."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.diagnose.regression.linearise import Candidate
from bench.diagnose.regression.parameters import effect_entries, with_values
from bench.diagnose.select.choose import accepted
from bench.diagnose.select.closed_loop.given_past import foretold
from bench.diagnose.select.discovery import trifle
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.simulated.dry_friction import friction_that_saves
from bench.diagnose.select.step import advanced, settled, without
from bench.diagnose.select.subset import Fit
from bench.diagnose.select.tie import rivals
from bench.diagnose.select.verify import at_bound, by_chance, estimates
from bench.diagnose.settings import CHOOSING
from bench.diagnose.simulate.equation_error import Saving
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel, TorqueEffect


@dataclass(frozen=True, eq=False)
class Choice:
    """The last view's model without some of its effects, fitted."""

    search: Search
    view: View
    dropped: tuple[int, ...] = ()
    """Places of effects in the view's model."""

    @cached_property
    def fit(self) -> Fit:
        """Its numbers."""
        return self.view.subsets.fit(drop=self.dropped)

    @cached_property
    def model(self) -> PhysicsModel:
        """With these numbers; where effects were dropped, which the others may have made good for, fitted anew."""
        model = advanced(self.search, self.view, self.fit).model
        return settled(self.search, model, self.view)[1] if self.dropped else model

    def less(self, place: int) -> PhysicsModel:
        """The model less the effect in one more place."""
        return advanced(self.search, self.view, self.view.subsets.fit(drop=[*self.dropped, place])).model

    def relieves(self, place: int) -> bool:
        """Whether constants lie so far outside what is known of them without the effect that this alone pays for it."""
        less = self.view.subsets.fit(drop=[*self.dropped, place])
        least = self.view.subsets.penalty * (self.fit.parameters - less.parameters) + CHOOSING.doubted
        if less.prior - self.fit.prior < least:
            return False
        view, _ = settled(self.search, self.less(place), self.view)
        return view.subsets.fit().prior - self.fit.prior > least

    def taken_out(self, place: int) -> PhysicsModel:
        """The model without the effect in one more place, all other numbers as they are."""
        return without(self.model, [self._at(place)])

    def _at(self, place: int) -> int:
        """Where the effect in this place of the view's model is in this one."""
        kind = type(self.view.linear.model.effects[place])
        (at,) = (i for i, e in enumerate(self.model.effects) if type(e) is kind)
        return at

    def faded(self, place: int) -> PhysicsModel:
        """The model with half of the effect in this place, all other numbers as they are."""
        at = self._at(place)
        numbers = effect_entries(self.model.effects[at], at)
        return with_values(self.model, numbers, np.array([(e.value + e.neutral) / 2 for e in numbers]))

    def exchanged(self, place: int, start: Candidate) -> PhysicsModel:
        """The model with another effect in place of one, fitted until its numbers move no more, as those here do."""
        key = place, start.id, start.columns
        if key not in self._exchanged:
            fit = self.view.subsets.fit([start], drop=[*self.dropped, place])
            self._exchanged[key] = settled(self.search, advanced(self.search, self.view, fit).model, self.view)[1]
        return self._exchanged[key]

    @cached_property
    def _exchanged(self) -> dict[tuple[int, str, tuple[int, ...]], PhysicsModel]:
        """What was fitted: a rival is asked whether it takes an effect's place, and whether it is a tie."""
        return {}


def worth_naming(
    search: Search, view: View, weighing: Weighing | None
) -> tuple[Choice, tuple[str, ...], tuple[str, ...]]:
    """The effects that a model was found to lack which are sure and worth a term; remarks on those that are not.

    The one that saves least goes first: two that share what they explain would both seem idle.

    Returns:
        The choice, the remarks, and the effects that held-out recordings contradict though the others are sure of them.
    """
    subsets, numbers = view.subsets, estimates(view, view.subsets.fit())
    places = range(len(search.subject.model.effects), len(view.linear.model.effects))
    dropped = {i for i in places if at_bound(numbers, i)}
    remarks: list[str] = []
    contradicted_effects: list[str] = []
    while True:
        gone = view.linear.removed(sorted(dropped))[0]
        chosen = Choice(search, view, tuple(sorted(gone)))
        left = [i for i in places if i not in gone]
        less = {i: subsets.fit(drop=[*gone, i]) for i in left}
        unsure = [i for i in left if not accepted(view, less[i], chosen.fit, drop=[*gone, i])]
        if weighing is None:
            visible = chosen.fit.misfit + CHOOSING.visible * view.floor
            unsure += [i for i in left if less[i].misfit < visible]
            if not unsure:
                return chosen, (), ()
            dropped.add(unsure[0])
            continue
        savings = {i: saved(weighing, chosen, i, chosen.model) for i in left}
        chance = {i for i in left if by_chance(view, chosen.fit, i)}
        idle = [
            i
            for i in left
            if i in unsure
            or _worse(savings[i])
            or not any(s.worth for s in savings[i])
            or i in chance
            or _cancels(weighing, chosen, i, savings[i])
        ]
        if not idle:
            return chosen, tuple(remarks), tuple(contradicted_effects)
        least = min(idle, key=lambda i: max((s.share for s in savings[i]), default=0.0))
        dropped.add(least)
        if least not in unsure:
            name = EFFECTS.name_of(type(view.linear.model.effects[least]))
            if _worse(savings[least]):
                contradicted_effects.append(name)
            else:
                remarks.append(_doubted(name, savings[least], least in chance))


def _doubted(name: str, savings: Sequence[Saving], chance: bool) -> str:
    """A remark on an effect that is not named: its recordings disagree, its inputs cancel something, or a trifle."""
    effect = name.replace("_", " ")
    if chance:
        return f"A trace of {effect} shows; recordings disagree about it, and nothing of it is sure of all of them."
    if any(s.worth for s in savings):
        return (
            f"What {effect} saves is nothing once the moments before are known: inputs that cancel what nobody "
            "measured seem to do less than they do."
        )
    return trifle(name, savings)


def _cancels(weighing: Weighing, chosen: Choice, place: int, savings: Sequence[Saving]) -> bool:
    """Whether an effect on all torques only says that inputs cancel what nobody measured.

    Below the bandwidth of a controller they seem to do less than they do. What they do is told by fast motion, *given
    the moments before* (`select.closed_loop.given_past`): there such an effect saves nothing.
    """
    if not isinstance(chosen.view.linear.model.effects[place], TorqueEffect):
        return False
    worth = {s.equation for s in savings if s.worth}
    groups = {e.group.name for e in weighing.equations if e.name in worth}
    return all(foretold(weighing, chosen.less(place), chosen.model, g).saves <= 0 for g in groups)


def _worse(savings: Sequence[Saving]) -> bool:
    """Whether an effect makes held-out recordings worse for sure, in every equation, or loses one of them."""
    return bool(savings) and (all(s.high < 0 for s in savings) or any(s.harms for s in savings))


def rival_that_saves(view: View, weighing: Weighing, chosen: Choice) -> PhysicsModel | None:
    """The model with a rival in place of one of its effects, which surely loses a held-out equation; None: none does.

    Of two effects that few moments tell apart, a search keeps the one with fewer numbers, whatever it leaves. What acts
    on a drive may be dry friction: see `friction_that_saves`.
    """
    places = range(len(weighing.subject.model.effects), len(view.linear.model.effects))
    for place in (i for i in places if i not in chosen.dropped):
        for start in rivals(view, place).values():
            other = chosen.exchanged(place, start)
            possible = all(e.possible_in(other) for e in other.effects)
            if not possible or not weighing.could_rescue(chosen.model, other):
                continue
            rescued = any(s.rescues for s in weighing.savings(chosen.model, other, other))
            if rescued and weighing.refutes(chosen.model, other, other):
                return other
    return friction_that_saves(chosen.search, view, weighing, chosen.model)


def saved(weighing: Weighing | None, chosen: Choice, place: int, extended: PhysicsModel) -> tuple[Saving, ...]:
    """What the effect in this place saves on held-out recordings, the rest fitted anew without it.

    Where constants would lie far outside what is known of them without it, that is no way to do without.

    One that lets more noise of the inputs into a forecast is judged by half of its size as well, where that is worth
    more: its number was found with the noise taken off, and on noisy inputs less of it forecasts best.
    """
    if weighing is None:
        return ()
    less, half = chosen.less(place), chosen.faded(place)
    acts_on = weighing.channels_moved(half, chosen.model)
    savings = weighing.savings(less, chosen.model, extended, acts_on)
    if not any(s.worth for s in savings) and chosen.relieves(place):
        savings = weighing.savings(chosen.taken_out(place), chosen.model, extended, acts_on, calibrated=False)
    if any(s.worth for s in savings) or not weighing.noisier(less, chosen.model):
        return savings
    attenuated = weighing.savings(less, half, extended, acts_on)
    return attenuated if any(s.worth for s in attenuated) else savings
