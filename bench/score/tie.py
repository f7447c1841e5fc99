"""Whether effects that a diagnosis holds for indistinguishable are: the fitted models' difference beside the noise."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from bench.diagnose.compare import compare
from bench.diagnose.extend import extend
from bench.diagnose.fit import fit_parameters
from bench.diagnose.logs.noise import Noise, noise_of
from bench.diagnose.logs.subject import Subject
from bench.diagnose.simulate.free_run import default_steps, errors, free_run, groups, starts
from bench.score.case import Case
from bench.score.chains import measured
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel

EVERY = 50
"""Samples between the starts of two free runs."""


def distance(
    case: Case, named: Mapping[str, object], rivals: Mapping[str, Sequence[str]], cache: Path
) -> dict[str, float]:
    """Of each named effect whose tie set holds a true one: the widest difference within the set, over the noise.

    The true effects and, in place of the one in question, each of its rivals are fitted to the training recordings;
    compared are their free runs on the held-out ones, by output group, with the error that noise alone makes.
    """
    wanted = {name: [t for t in case.names if t in (name, *rivals.get(name, ()))] for name in named if rivals.get(name)}
    if not any(wanted.values()):
        return {}
    who, _ = measured(case, cache)
    noise = noise_of(who)
    true = {k: EFFECTS.get(k)(**v) for k, v in case.effects.items() if k in EFFECTS.names()}
    right, _ = fit_parameters(who, replace(who.model, effects=(*who.model.effects, *true.values())), noise)
    floor = compare(who, {"true": right}, noise=noise).lines["floor"]
    level = np.array([line.rmse[-1] for line in floor.values()])
    out = {}
    for name, inside in wanted.items():
        widest = 0.0
        for other in {name, *rivals[name]} - set(inside[:1]) if inside else ():
            base = replace(who.model, effects=(*who.model.effects, *(e for k, e in true.items() if k != inside[0])))
            wrong = extend(who, base, [other], noise=noise).model
            widest = max(widest, float((_difference(who, right, wrong, noise) / level).max()))
        if inside:
            out[name] = widest
    return out


def _difference(who: Subject, one: PhysicsModel, other: PhysicsModel, noise: Noise) -> np.ndarray:
    """Root mean square difference (groups,) of two models' free runs at the last step, on held-out recordings."""
    logs = who.of(who.held_out)
    steps, margin = default_steps(logs), noise.half_width
    at = [starts(log, steps + 2 * margin, EVERY) + margin for log in logs]
    judged = groups(who.model.state_channels, [all(m) for m in zip(*(log.measured for log in logs), strict=True)])
    with torch.no_grad():
        runs = [free_run(model, logs, at, steps) for model in (one, other)]
    squared = errors(runs[0], runs[1], judged)[:, -1]
    return np.asarray(squared.mean(0).sqrt().numpy())
