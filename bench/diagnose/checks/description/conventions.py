"""Signs, axes, units, frames and orders: which change of dataset.toml makes signals agree that do not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.diagnose.checks.description.edits import Edit, edits
from bench.diagnose.checks.description.mistake import Mistake, lines
from bench.diagnose.checks.description.recorded import Flight, Reading, Recorded, joined
from bench.diagnose.checks.description.relations import CARRIED, KINEMATIC, Relation, lifting, misfit
from bench.diagnose.checks.description.rotors import pace_of, torque
from bench.diagnose.settings import MENDING, TRYING

Array = np.ndarray

ROTORS = ("rotor_speed", "rotor_command", "pwm")
"""Inputs that are one a rotor."""
_SIDES = {
    "turning": (("attitude",), ("body_rates",)),
    "moving": (("position",), ("velocity",)),
    "tilting": (("attitude",), ("velocity", "position")),
}


@dataclass(frozen=True)
class _Scores:
    """Misfits (flights, axes) by relation; NaN where a flight tells nothing."""

    of: dict[str, Array]

    def middle(self) -> dict[str, Array]:
        """Median over flights (axes,) by relation; 1 where nothing is told."""
        out = {}
        for name, table in self.of.items():
            told = table[np.isfinite(table).all(axis=1)]
            out[name] = np.median(told, axis=0) if len(told) else np.ones(table.shape[1])
        return out

    def total(self) -> float:
        """Sum of the middle misfits."""
        return float(sum(m.sum() for m in self.middle().values()))


def conventions(recorded: Recorded, carried: bool = True) -> list[Mistake]:
    """Mistakes of reading, the plainest first, each with the lines that mend all of them up to it.

    Args:
        recorded: what is read.
        carried: whether rotors carry the vehicle along its z axis.
    """
    first, found = recorded.reading, []
    relations = _relations(recorded, carried)
    if not relations:
        return []
    reading, before = first, _score(recorded.flights, first, relations)
    for _ in range(MENDING.passes):
        step = _best(recorded.flights, reading, relations, before)
        if step is None:
            break
        edit, after, others = step
        found.append(_mistake(recorded, reading, edit, others, before=before, after=after, relations=relations))
        reading, before = edit.reading, after
    for flight in recorded.flights:
        flight.forget()
    return found


def agreeing(recorded: Recorded, carried: bool = True) -> tuple[list[str], list[str]]:
    """What was held against what, in words: where it agrees on every axis, and where these flights leave it open."""
    if not recorded.flights:
        return [], []
    relations = _relations(recorded, carried)
    middle = _score(recorded.flights, recorded.reading, relations).middle()
    alike = [r.name for r in relations if (middle[r.name] < MENDING.wrong).all()]
    said = {**_RESIDUAL, "torque": "the order and the signs of the rotors against the torque"}
    return [said[n] for n in alike], [said[r.name] for r in relations if r.name not in alike]


def _relations(recorded: Recorded, carried: bool) -> list[Relation]:
    reading = recorded.reading
    known = reading.signals
    among = [r for r in KINEMATIC if r.uses(known)]
    if not carried:
        return among
    moving = "attitude" in known and ("velocity" in known or "position" in known)
    among += [r for r in CARRIED if r.uses(known) and (r.name == "hanging") != moving]
    if reading.drive in known:
        if (moving or "specific_force" in known) and reading.drive in ROTORS:
            among.append(lifting(reading.drive))
        if "body_rates" in known and reading.positions:
            among.append(torque(reading.drive, pace_of(recorded.flights, reading)))
    return among


def _score(
    flights: Sequence[Flight],
    reading: Reading,
    relations: Sequence[Relation],
    known: _Scores | None = None,
    changed: Sequence[str] = (),
) -> _Scores:
    """Misfits of all relations; those that use nothing that ``changed`` are as ``known``."""
    out = {}
    for relation in relations:
        if known is not None and not _touches(relation, changed):
            out[relation.name] = known.of[relation.name]
            continue
        rows = []
        for flight in flights:
            names = (*relation.needs, *relation.either, "attitude")
            pair = relation.compare(flight, reading, flight.signals(reading, tuple(dict.fromkeys(names))))
            rows.append(np.full(len(relation.axes), np.nan) if pair is None else misfit(*pair))
        out[relation.name] = np.array(rows)
    return _Scores(out)


def _touches(relation: Relation, changed: Sequence[str]) -> bool:
    through = "attitude" in changed  # it turns vectors of other frames
    return through or any(n in changed for n in (*relation.needs, *relation.either))


def _best(
    flights: Sequence[Flight], reading: Reading, relations: Sequence[Relation], before: _Scores
) -> tuple[Edit, _Scores, list[Edit]] | None:
    """The change after which most agrees, and others that do as well."""
    wrong = [r for r in relations if (before.middle()[r.name] > (MENDING.sure if r.exact else MENDING.wrong)).any()]
    if not wrong:
        return None
    signals = list(dict.fromkeys(n for r in wrong for n in (*r.needs, *r.either)))
    among = [e for e in edits(reading, signals) if not _breaks(e, reading, relations, before)]
    tried: list[tuple[float, int, Edit, _Scores]] = []
    for edit in _promising(flights, reading, relations, among):
        after = _score(flights, edit.reading, relations, before, edit.signals)
        if _plain(relations, before, after):
            tried.append((after.total() + edit.cost, len(tried), edit, after))
    if not tried:
        return None
    tried.sort(key=lambda t: t[:2])
    least, _, edit, after = tried[0]
    others = [
        e
        for total, _, e, scores in tried[1:]
        if total < least + MENDING.alike
        and (e.kind, e.signals) != (edit.kind, edit.signals)
        and abs(scores.total() - after.total()) > MENDING.same
    ]
    return edit, after, others


def _breaks(edit: Edit, reading: Reading, relations: Sequence[Relation], before: _Scores) -> bool:
    """Whether it changes one of two signals that agree beyond doubt, and not the other."""
    for relation in relations:
        if relation.name == "tilting" and edit.kind == "frame" and edit.signals == ("velocity",):
            continue  # a vehicle that keeps its heading hardly shows it in its tilt
        if relation.name in _SIDES and (before.middle()[relation.name] < MENDING.sure).all():
            one, other = ([n for n in side if n in reading.signals][:1] for side in _SIDES[relation.name])
            if any(n in edit.signals for n in one) != any(n in edit.signals for n in other):
                return True
    return False


def _promising(
    flights: Sequence[Flight], reading: Reading, relations: Sequence[Relation], among: Sequence[Edit]
) -> list[Edit]:
    """Those that do best on a few seconds of a few recordings: hundreds are tried."""
    step = max(1, len(flights) // TRYING.recordings)
    probe = [joined([f.part(TRYING.seconds) for f in flights[::step][: TRYING.recordings]])]
    before = _score(probe, reading, relations)
    level = before.total()
    totals = [
        (_score(probe, e.reading, relations, before, e.signals).total() + e.cost, i, e) for i, e in enumerate(among)
    ]
    return [e for total, _, e in sorted(totals, key=lambda t: t[:2])[: TRYING.kept] if total < level - MENDING.sure / 2]


def _plain(relations: Sequence[Relation], before: _Scores, after: _Scores) -> bool:
    """Whether what did not agree does now, in most recordings, and what agreed still does."""
    old, new, mended = before.middle(), after.middle(), False
    for relation in relations:
        was, now = old[relation.name], new[relation.name]
        agreed = was < MENDING.wrong
        if relation.firm and not agreed.all():
            agreed[:] = False  # of a vector that does not agree some axes may, by chance
        if (agreed & (now > was + MENDING.worse)).any():
            return False
        a, b = before.of[relation.name], after.of[relation.name]
        told = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
        if not told.any():
            continue
        enough = MENDING.agreeing if relation.firm else MENDING.agreeing_loosely
        fallen = (was > MENDING.wrong) & (was - now > MENDING.fall) & (now < enough)
        often = ((a[told] - b[told]) > MENDING.fall / 2).mean(axis=0) >= MENDING.recordings
        mended |= bool((fallen & often).any())
        if relation.exact:
            cleared = (was > MENDING.sure) & (now < MENDING.cleared * was) & (now < MENDING.sure)
            mended |= bool((cleared & ((b[told] < a[told] / 2).mean(axis=0) >= MENDING.recordings)).any())
    return mended


# ------------------------------------------------------------------------------------------------------- in words


def _mistake(
    recorded: Recorded,
    reading: Reading,
    edit: Edit,
    others: Sequence[Edit],
    before: _Scores,
    after: _Scores,
    relations: Sequence[Relation],
) -> Mistake:
    old, new = before.middle(), after.middle()
    falls = [(float((old[r.name] - new[r.name]).max()), r) for r in relations]
    _, most = max(falls, key=lambda f: f[0])
    axis = int((old[most.name] - new[most.name]).argmax())
    was, now = (float(x[most.name][axis]) for x in (old, new))
    table = before.of[most.name][:, axis] - after.of[most.name][:, axis]
    recordings = tuple(
        f.name for f, d in zip(recorded.flights, table, strict=True) if d > min(MENDING.fall, was - now) / 2
    )
    subject = _called(edit)
    # A misfit beyond one is as good as none: the signal would better be left out.
    fall = 1 - now / min(was, 1.0) if most.firm else 1 - (1 - (1 - min(now, 1.0)) ** 2) / 1.0
    detail = (
        f"{subject} looks like {edit.what}: the residual of {_RESIDUAL[most.name]} ({most.axes[axis]}) falls by "
        f"{max(0.0, fall):.0%}, in {len(recordings)} of {len(recorded.flights)} recordings."
    )
    if others:
        told = list(dict.fromkeys(f"{_called(e)} {e.what}" for e in others))[:2]
        detail += f" Or, as these data have it: {'; '.join(told)}."
    return Mistake(edit.kind, edit.signals[0], recordings, detail, lines(reading, edit.reading), reading=edit.reading)


_RESIDUAL = {
    "turning": "the attitude against the body rates",
    "moving": "the position against the velocity",
    "tilting": "the acceleration against the tilt",
    "weighing": "the accelerometer against the motion",
    "hanging": "the accelerometer against the weight",
    "lifting": "the thrust",
    "torque": "the torque",
}


def _called(edit: Edit) -> str:
    if edit.kind.startswith("rotor"):
        return edit.kind
    names = " and ".join((", ".join(edit.signals[:-1]), edit.signals[-1])) if len(edit.signals) > 1 else edit.signals[0]
    return f"the {edit.kind.removeprefix('swapped ')} of {names}"
