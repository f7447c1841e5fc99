"""Dry friction by inverse dynamics: what drives a machine, regressed on the motion that was measured.

Forwards, what an input does is a share of the acceleration. Where a controller holds a machine on its path against
torques that nobody measured, and these accelerate it more than the path asks for, that share seems to be nothing. The
other way round they are noise of the *input*: with a mass m and a friction f_c that are to be found,

    u = m dv/dt − g(x) + f_c sign v + noise,

where g is what else the model says acts. That holds as far as the path was asked for, and not made by what disturbs it,
and only while the machine moves: at rest friction balances whatever there is. So robots are identified:
C. G. Atkeson, C. H. An, J. M. Hollerbach, *Estimation of inertial parameters of manipulator loads and links*, Int. J.
of Robotics Research 5(3), 1986.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from bench.diagnose.by_equation import InverseDynamics
from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Log, LogBatch, Subject, named_drive
from bench.diagnose.regression.parameters import entries, probes, with_values
from bench.diagnose.regression.weak import midpoint_rates
from bench.diagnose.select.catalogue import admissible
from bench.diagnose.select.closed_loop.given_past import idle
from bench.diagnose.select.discovery import Discovery
from bench.diagnose.select.materiality import Weighing
from bench.diagnose.settings import EXTENDING, INVERSE, LINEARISING, MATTERING, RELEASING
from registry.core import EFFECTS
from registry.datasets.reading.cleaning import held, runs
from registry.dynamics import DryEffect, InputEffect, PhysicsModel
from registry.dynamics.model import RATE_OF

Array = np.ndarray


def with_inverse_dynamics(
    found: Discovery, subject: Subject, noise: Noise, catalogue: Sequence[str] | None = None
) -> Discovery:
    """An answer by which the inputs do nothing, with the dry friction that they work against, if there is one.

    A dead zone that swallows nearly all of an input is told from friction by nothing then, and any other effect fits
    the path that was asked for.
    """
    drives = [f for f in found.found if isinstance(f.effect, InputEffect)]
    if not (found.let_go or drives) or not subject.held_out:
        return found
    kinds = [kind for _, kind in admissible(subject, subject.model, catalogue) if issubclass(kind, DryEffect)]
    kind = next((kind for kind in kinds if not kind.screen), None)
    if kind is None:
        return found
    dry = kind.neutral_for(subject.model, {})
    motions = list(dry.motions(subject.model))
    names = subject.model.equation_names()
    groups = [subject.model.state_channels[i].group for i in motions]
    if len(motions) != 1 or not idle(Weighing(subject, noise, found.model), found.model, [names[groups[0]]]):
        return found
    told = inverse_dynamics(subject, noise, dry)
    if told is None:
        return found
    if len(drives) == len(found.found):
        tied = tuple(replace(f, rivals=(*f.rivals, told.effect)) for f in drives)
        return replace(found, found=tied, inverse=told)
    remark = (
        f"{', '.join(f.id for f in found.found)} would fit the path that was asked for, beside a {told.drive} that "
        "seems to do nothing, and so is not named."
    )
    return replace(found, found=(), model=found.calibrated, remarks=(*found.remarks, remark), inverse=told)


def inverse_dynamics(subject: Subject, noise: Noise, dry: DryEffect) -> InverseDynamics | None:
    """The friction that an input works against, and the mass that it moves; None: recordings left out do not agree.

    Args:
        subject: the model and all recordings; what moves is one motion.
        noise: of the measurements.
        dry: friction of one number, which is found; none of it acts yet.
    """
    model = replace(subject.model, effects=(*subject.model.effects, dry))
    (motion,) = dry.motions(model)
    pieces = [_pieces(subject, model, log, motion, noise) for log in subject.logs]
    kept = [p for p in pieces if len(p.effort)]
    if len(kept) < 2:
        return None
    whole = _Pieces.joined(kept)
    if len(whole.effort) < INVERSE.least * np.linalg.matrix_rank(_scaled(whole.columns)[0], RELEASING.flat):
        return None
    numbers, half = _fitted(whole)
    share, reach = _saved(kept)
    if numbers[0] + half[0] <= 0:  # the path is what disturbs the machine
        return None
    if numbers[-1] <= half[-1] or share - reach < INVERSE.most:
        return None
    mass, *_, friction = ((float(x), float(x - h), float(x + h)) for x, h in zip(numbers, half, strict=True))
    return InverseDynamics(
        effect=EFFECTS.name_of(type(dry)),
        drive=named_drive(subject.logs[0], 0),
        friction=friction,
        unit=entries(model, subject.uncertainty)[-1].unit,
        mass=mass,
        saves=share,
        low=share - reach,
        high=share + reach,
    )


@dataclass(frozen=True)
class _Pieces:
    """Means over pieces of one-way motion."""

    effort: Array
    """(P,) acceleration by the input, with the mass as stated, and by all else that is known."""
    columns: Array
    """(P, C): measured acceleration, a constant, the speed, what the model's constants do, dry friction."""
    stretch: Array
    """(P,) which motion from one standstill to the next it is of."""

    @classmethod
    def joined(cls, parts: Sequence["_Pieces"]) -> "_Pieces":
        """One after the other."""
        before = np.cumsum([0, *(p.stretch[-1] + 1 for p in parts)])
        stretches = [p.stretch + b for p, b in zip(parts, before, strict=False)]
        return cls(*(np.concatenate(x) for x in ([p.effort for p in parts], [p.columns for p in parts], stretches)))


def _saved(pieces: Sequence[_Pieces]) -> tuple[float, float]:
    """Share of the squares of recordings left out one by one that friction saves, and half of its 95 % interval."""
    squares = np.zeros((len(pieces), 2))
    for i, left_out in enumerate(pieces):
        rest = _Pieces.joined([p for p in pieces if p is not left_out])
        for j, at in enumerate((slice(0, -1), slice(None))):
            missed = left_out.effort - left_out.columns[:, at] @ _fit(rest.columns[:, at], rest.effort)
            squares[i, j] = missed @ missed
    before, gains = squares[:, 0], squares[:, 0] - squares[:, 1]
    share = float(gains.sum() / max(before.sum(), 1e-300))
    scatter = float(((gains - share * before) ** 2).sum()) * len(pieces) / (len(pieces) - 1)
    return share, MATTERING.sure * scatter**0.5 / max(float(before.sum()), 1e-300)


def _pieces(subject: Subject, model: PhysicsModel, log: Log, motion: int, noise: Noise) -> _Pieces:
    """Of one recording."""
    stack = LogBatch.of([log])
    where = entries(model, subject.uncertainty)
    values, steps = probes(where)
    undriven = replace(stack, inputs=torch.zeros_like(stack.inputs))
    driven, alone = (
        midpoint_rates(with_values(model, where, values), s)[:, 0, :, motion].numpy() for s in (stack, undriven)
    )
    answers, own = ((rates[1:] - rates[0]) / steps[:, None] for rates in (driven, alone))
    # What a constant does through the input, as the mass does, the acceleration tells.
    inertial = np.abs(answers - own).max(1) > LINEARISING.probe * np.abs(answers).max(1)
    own[inertial & [e.constant for e in where]] = 0.0
    acceleration, speed = stack.states[0, :, motion].diff().numpy() / log.dt, stack.between[0, :, motion].numpy()
    effort, columns = driven[0], np.stack([acceleration, np.ones(len(speed)), speed, *-own], axis=-1)
    out = list[tuple[Array, Array, int]]()
    length = max(INVERSE.shortest, round(INVERSE.piece * log.pace))
    for i, (a, b) in enumerate(_one_way(log, model, motion, noise)):
        for k in range(a, b - INVERSE.shortest + 1, length):
            at = slice(k, min(b, k + length))
            out.append((effort[at].mean(0), columns[at].mean(0), i))
    return _Pieces(
        np.array([e for e, _, _ in out]),
        np.array([c for _, c, _ in out]).reshape(len(out), columns.shape[1]),
        np.array([i for _, _, i in out], dtype=int),
    )


def _one_way(log: Log, model: PhysicsModel, motion: int, noise: Noise) -> Iterator[tuple[int, int]]:
    """Runs of intervals in which it surely moves one way: faster than noise and than what a sensor reads at rest.

    A machine rests where its position repeats for long; what the speed reads there is nothing.
    """
    speed, valid = log.states[:, motion].numpy(), log.valid.numpy()
    channel = model.state_channels[motion]
    rest = np.zeros(len(speed), bool)
    for i, c in enumerate(model.state_channels):
        if RATE_OF.get(c.group) == channel.group and log.measured[i]:
            for a, b in runs(held(log.states[:, [i]].numpy())):
                rest[a:b] |= b - a >= max(INVERSE.shortest, round(INVERSE.piece * log.pace))
    hidden = max(
        INVERSE.surely * noise.processed[motion],
        float(np.quantile(np.abs(speed[rest]), INVERSE.at_rest)) if rest.any() else 0.0,
    )
    sure = valid & (np.abs(speed) > hidden)
    yield from runs(sure[:-1] & sure[1:] & (speed[:-1] * speed[1:] > 0))


def _scaled(columns: Array) -> tuple[Array, Array]:
    size = np.abs(columns).max(0)
    size = np.where(size > 0, size, 1.0)
    return columns / size, size


def _fit(columns: Array, effort: Array) -> Array:
    """Least squares; of columns that are alike each gets its part."""
    x, size = _scaled(columns)
    found: Array = np.linalg.lstsq(x, effort, rcond=RELEASING.flat)[0] / size
    return found


def _fitted(pieces: _Pieces) -> tuple[Array, Array]:
    """Numbers and halves of their 95 % intervals; what is left of one motion is taken to be alike (cluster-robust)."""
    x, size = _scaled(pieces.columns)
    numbers = _fit(pieces.columns, pieces.effort)
    left = x * (pieces.effort - pieces.columns @ numbers)[:, None]
    sums = np.stack([left[pieces.stretch == k].sum(0) for k in np.unique(pieces.stretch)])
    inverse = np.linalg.pinv(x.T @ x, rcond=RELEASING.flat**2, hermitian=True)
    variance = np.diag(inverse @ sums.T @ sums @ inverse) * len(sums) / max(len(sums) - 1, 1)
    return numbers, EXTENDING.interval * variance**0.5 / size
