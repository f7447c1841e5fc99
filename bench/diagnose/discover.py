"""Which effects of the catalogue a model lacks: weak form, whitened, best subsets, judged on recordings not fitted."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.regression.parameters import entries
from bench.diagnose.regression.weak import mean_rates
from bench.diagnose.select import by_simulation
from bench.diagnose.select.choose import accepted, agreed, updated
from bench.diagnose.select.discovery import Discovery, Found, Loser
from bench.diagnose.select.search import Search, View
from bench.diagnose.select.subset import Fit, t_value
from bench.diagnose.select.verify import (
    LEFT,
    estimates,
    left_over,
    neighbour,
    pinned,
    ratios,
    rivals,
    understood,
)
from bench.diagnose.simulate.unmeasured import hidden
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel

FAINT = 0.002
"""Share of what noise leaves that a signal must explain on recordings not fitted; noise alone reaches 0.0001."""


def discover(
    subject: Subject,
    catalogue: Sequence[str] | None = None,
    tick: Callable[[str], None] = lambda what: None,
    noise: Noise | None = None,
) -> Discovery:
    """Find what the model of ``subject`` lacks; where a state is not measured, by fitting simulations.

    Args:
        subject: model and measurements; only its training recordings are looked at.
        catalogue: ids of the effects to choose from; default: all that are registered.
        tick: called with what is being done.
        noise: default `noise.noise_of`.

    Raises:
        BenchError: an unknown id, or recordings too short or too few to learn from.
    """
    if hidden(subject.logs):
        return by_simulation.discover(subject, catalogue, tick)
    search = Search(subject, catalogue, tick, noise)
    base = subject.model
    view, fit, fields = agreed(search.views(search.look(base)))
    model = updated(view, fit)
    calibrated = updated(view, view.subsets.fit())
    rounds = tuple(_round(view, field, chosen) for field, chosen in zip(fields[1:], _chain(fit, fields), strict=False))
    everything = view.subsets.fit().misfit - view.floor
    shortlist = {i for field in fields[1:] for f in field[:8] for i in f.ids}
    known = len(base.effects)
    for _ in range(4):
        tick("what is left")
        views = search.views(search.look(model, shortlist), everything)
        view = min(views, key=lambda v: v.subsets.fit().prior)
        changed = neighbour(view, known)
        fit = view.subsets.fit() if changed is None else changed
        before, model = model, without(updated(view, fit), fit.dropped)
        if not torch.isfinite(mean_rates(model, search.stack)).all():
            model = before  # unstable at this sampling rate
            break
        if changed is None and close(before, model, subject):
            break
    subsets = view.subsets
    fit = subsets.fit()
    traces, total = left_over(view)
    named = list(range(known, len(view.linear.model.effects)))
    numbers = estimates(view, fit)
    named = [i for i in named if not pinned(numbers, i) and accepted(view, subsets.fit(drop=[i]), fit, drop=[i])]
    if total > LEFT * view.floor:
        named = understood(view, named, traces, total)
    gone, _ = view.linear.away([i for i in range(known, len(view.linear.model.effects)) if i not in named])
    named, imitators = [i for i in named if i not in gone], sorted(gone)
    names = [EFFECTS.name_of(type(e)) for e in view.linear.model.effects]
    if imitators:  # and what was exchanged in the last step and is not worth its place
        fit = subsets.fit(drop=imitators)
        traces, total = left_over(view, imitators)
    numbers = estimates(view, fit)
    alike = {i: rivals(view, i) for i in named} if not imitators else dict.fromkeys(named, ())
    model = without(updated(view, fit), imitators)
    found = tuple(
        Found(
            names[i],
            next(e for e in model.effects if EFFECTS.name_of(type(e)) == names[i]),
            tuple(x for x in numbers if x.entry.owner == i),
            subsets.fit(drop=[*imitators, i]).misfit - fit.misfit,
            alike[i],
        )
        for i in named
    )
    return Discovery(
        calibrated,
        model,
        tuple(sorted(found, key=lambda f: -f.gain)),
        rounds,
        tuple(traces) if total > LEFT * view.floor else (),
        tuple(x for x in numbers if x.entry.constant),
        tuple(ratios(view, fit)),
        tuple(names[i] for i in imitators),
        tuple(t for t in traces if t.gain > FAINT),
        search.notes,
    )


def without(model: PhysicsModel, dropped: Sequence[int]) -> PhysicsModel:
    """The model without the effects in these places."""
    return replace(model, effects=tuple(e for i, e in enumerate(model.effects) if i not in dropped))


def close(before: PhysicsModel, after: PhysicsModel, subject: Subject) -> bool:
    """Whether a step moved every number by little against its scale."""
    pairs = zip(entries(before, subject.uncertainty), entries(after, subject.uncertainty), strict=True)
    return all(
        abs(a.value - b.value) <= (0.3 * b.scale if b.constant else 0.05 * abs(b.value)) + 1e-12 for a, b in pairs
    )


def _chain(fit: Fit, fields: list[list[Fit]]) -> list[Fit]:
    """By size, the set of the field that leads to the chosen one."""
    out = []
    for field in fields[1:]:
        inside = [f for f in field if set(f.ids) <= set(fit.ids)]
        out.append(inside[0] if inside else field[0])
    return out


def _round(view: View, field: list[Fit], chosen: Fit) -> tuple[Loser, ...]:
    """The sets of one size, as a reader compares them."""
    subsets = view.subsets
    base = subsets.fit()
    scale = max(base.loss - view.floor, 1.0)
    base_blocks, level = subsets.losses(base).sum(1), subsets.losses(chosen).sum(1)
    out = []
    for f in sorted(field, key=lambda f: -(f is chosen))[:8]:
        blocks = subsets.losses(f).sum(1)
        gains = base_blocks - blocks
        half = 1.96 * float(gains.std(ddof=1)) * len(gains) ** 0.5 if len(gains) > 1 else 0.0
        share = (base.loss - f.loss) / scale
        margin, t = subsets.cost(f) - subsets.cost(chosen), t_value(blocks - level)
        text = "; ".join(
            f"{i}: " + ", ".join(f"{p.name} = {p.value:.3g} {p.unit}" for p in e.parameters() if p.uncertainty > 0)
            for i, e in f.effects(len(subsets.own)).items()
        )
        if f is chosen:
            why = ""
        elif margin < 6.0:
            why = f"explains as much, with {f.parameters} parameters against {chosen.parameters}"
        else:
            rest = max(f.misfit - view.floor, 0.0) / view.floor
            why = f"leaves {rest:.2g} times the noise unexplained (t = {t:.1f} against the best)"
        out.append(Loser(" + ".join(f.ids), share, share - half / scale, share + half / scale, text, why))
    return tuple(out)
