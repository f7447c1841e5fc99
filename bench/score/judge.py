"""What is right about one answer."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations
from typing import Any

from bench.score.case import Case
from bench.score.chains import changed_constants

INERTIA = ("rotor_gyroscopic_torque", "rotor_reaction_torque")
"""They share a constant: either alone or both is right where the truth is the rotor inertia."""
SHARE = 0.05
"""Of the error, that an effect must make to be asked for."""
NEAR, SLACK = 10, 100
"""Samples by which said rows may miss the spoilt ones, and by how many they may be more."""
ERROR = "error"
"""Verdict that stands for the answer of a diagnosis that raised."""
FAILED = "failed"
"""Key of the sentence that stands for the alternatives' answers where they raised."""
REACHED = 1.15
"""Times the floor that the error of the true model may be; chance moves it by 2 to 4 %."""
LEFT = 0.05
"""Of what was above the floor, that an extended model may leave."""
WORTH = 1.05
"""Times the error of the true model in each output, up to which a forecast is no worse: the rest is a remark."""


def token(effect: str) -> str:
    """The effect's id; the two effects of the rotors' inertia are one."""
    return "rotor_inertia" if effect in INERTIA else effect


@dataclass(frozen=True)
class Estimate:
    """A parameter of a rightly named effect."""

    name: str
    true: float
    value: float
    low: float = math.nan
    high: float = math.nan

    @property
    def error(self) -> float:
        """Relative."""
        return abs(self.value - self.true) / abs(self.true)

    @property
    def covered(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low <= self.true <= self.high


@dataclass(frozen=True)
class Judged:
    """A case, and what was said of it as plain values (`attempt.Answer`, or `alternatives.Said`)."""

    case: Case
    said: Mapping[str, Any]
    shares: Mapping[str, float]
    """Of the error, by true effect."""

    @property
    def verdict(self) -> str:
        """As said; an alternative knows two."""
        return str(self.said.get("verdict") or ("named" if self.named else "nothing"))

    @property
    def named(self) -> dict[str, Any]:
        """Effects that were named, alone or in a tie."""
        return dict(self.said["named"])

    @property
    def truth(self) -> set[str]:
        """Effects that may be named."""
        return {token(e) for e in self.case.names}

    @property
    def required(self) -> set[str]:
        """Effects that must be named."""
        return {token(e) for e in self.case.names if self.shares.get(e, 0.0) >= SHARE}

    def candidates(self, name: str) -> set[str]:
        """Truths that a named effect stands for: itself or, where nothing could tell them apart, its rivals."""
        rivals = self.said.get("rivals", {}).get(name, ())
        if rivals and not self.said["extra"].get("distance", {}).get(name, math.inf) < 1:
            return set()
        return {token(e) for e in (name, *rivals)} & self.truth

    @property
    def exact(self) -> bool:
        """Whether the effects named are the true ones: all that must be, and none that is not there."""
        return self._exact(self.required)

    @property
    def calibrated(self) -> set[str]:
        """Effects that must be named, were not, and were found all the same: as a change of a base constant.

        Constants are calibrated within three of their stated uncertainties before an effect is named. An effect that is
        nothing but other constants is found there if the interval of such a constant, or of its ratio to the one that
        flights do not tell it from, excludes the nominal value, so that the answer says that it is off, and each of
        them has one that holds the true value.
        """
        found = set()
        if self.verdict in ("nothing", "named"):
            for effect, constants in changed_constants(self.case).items():
                right = [[name for name, true in of.items() if self._holds(name, true)] for of in constants]
                off = any(self._is_off(name) for names in right for name in names)
                if effect not in self.named and all(right) and off:
                    found.add(token(effect))
        return found & self.required

    def _holds(self, constant: str, true: float) -> bool:
        """Whether the interval of a constant, as calibrated, holds its true value."""
        _, _, low, high = self.said.get("constants", {}).get(constant, (math.nan,) * 4)
        return bool(low <= true <= high)

    def _is_off(self, constant: str) -> bool:
        """Whether a constant is said to be off: its interval excludes the stated value."""
        stated, _, low, high = self.said["constants"][constant]
        return bool(not low <= stated <= high)

    @property
    def answered(self) -> bool:
        """Whether the set is exact where a constant calibrated to its true value counts as named; not in a tie."""
        return self.exact or (self.case.condition != "tie" and self._exact(self.required - self.calibrated))

    def _exact(self, required: set[str]) -> bool:
        # Both effects of the rotors' inertia stand for one truth.
        by_token = {token(name): self.candidates(name) for name in self.named}
        if len(by_token) > len(self.truth):
            return False
        return any(
            required <= set(order) and all(t in of for t, of in zip(order, by_token.values(), strict=True))
            for order in permutations(self.truth, len(by_token))
        )

    @property
    def first(self) -> bool:
        """Whether the effect named first is a true one, or a calibrated constant says it and none is named."""
        if not self.named:
            return bool(self.calibrated)
        return bool(self.candidates(next(iter(self.named))))

    @property
    def estimates(self) -> list[Estimate]:
        """Parameters of the effects that must be named and were."""
        out = []
        named = {token(name): values for name, values in reversed(self.named.items())}
        named |= self.named
        for effect in self.case.names:
            values = named.get(effect, named.get(token(effect)))
            if values is not None and token(effect) in self.required:
                for name, true in self.case.effects[effect].items():
                    if true == 0 or f"{effect}.{name}" in self.case.undetermined:
                        continue  # it has no relative error, or nothing tells it
                    found = values.get(name, math.nan)
                    found = found if isinstance(found, (list, tuple)) else (found,)
                    out.append(Estimate(f"{effect}.{name}", true, *found))
        return out

    # ------------------------------------------------------------------------------------------- the forecast

    def left(
        self, error: Mapping[str, float], reference: Mapping[str, Mapping[str, float]], least: str = "floor"
    ) -> float:
        """(E − least) / (nominal − least), each pooled over output groups in units of the nominal error; inf: none."""
        floor = self.pooled(reference.get(least, {}), reference)
        above = 1 - floor
        return (self.pooled(error, reference) - floor) / above if above > 0 else math.inf

    @staticmethod
    def pooled(error: Mapping[str, float], reference: Mapping[str, Mapping[str, float]]) -> float:
        """Root mean square over output groups of an error in units of the nominal one; inf: none is known."""
        nominal = reference.get("nominal", {})
        if not error or not nominal:
            return math.inf
        return math.sqrt(sum((error[g] / nominal[g]) ** 2 for g in nominal) / len(nominal))

    @property
    def remaining(self) -> float:
        """What the extended model leaves of the error above the floor; more than 1 is worse than nominal."""
        error = self.said["error"]
        return self.left(error.get("extended", {}), error)

    @property
    def truth_leaves(self) -> float:
        """What the model with the true numbers leaves of the error above the floor; NaN: unknown."""
        true = self.said["error"].get("true", {})
        return self.left(true, self.said["error"]) if true else math.nan

    @property
    def beyond_truth(self) -> float:
        """What the extended model leaves above the error that the true one makes on the same recordings; NaN: unknown.

        The floor is what noise makes on average: where an effect is weak beside it, a few per cent more or less of it
        in the recordings at hand are as large as what is asked for. Where the true numbers do not reach the floor (as
        with a load that swings when the log begins, which no number of the model says) it stays the reference.
        """
        error = self.said["error"]
        true, floor = error.get("true", {}), error.get("floor", {})
        if not true:
            return math.nan
        reached = all(true[g] <= REACHED * floor[g] for g in floor)
        return self.left(error.get("extended", {}), error, "true" if reached else "floor")

    @property
    def enough(self) -> bool:
        """Whether nothing else is worth a name: all that is said is true, and forecasts like the model with all of it.

        A mass that is half a per cent off is no effect where a stronger motor makes good for it, and a torque that
        hardly moves the vehicle is a remark.
        """
        error = self.said["error"]
        mine, true = error.get("extended", {}), error.get("true", {})
        sound = self.verdict in ("nothing", "named") and not self.names_wrongly
        return sound and bool(true) and all(mine.get(g, math.inf) <= WORTH * true[g] < math.inf for g in true)

    # --------------------------------------------------------------------------------- what is not an effect

    @property
    def names_wrongly(self) -> bool:
        """Whether an effect is named, alone or in a tie, that is not there."""
        return bool({token(n) for n in self.named} - self.truth)

    @property
    def signal(self) -> bool:
        """Whether a signal is said that the unknown effect follows."""
        return bool(_groups(self.said["follows"]) & set(self.case.follows))

    @property
    def recording(self) -> bool:
        """Whether the spoilt recordings, and no others, are said to have problems."""
        true = {f[0] for f in self.said["faults"]}
        return bool(true) and {p[0] for p in self.said["problems"]} == true

    @property
    def sensor(self) -> bool:
        """Whether the spoilt signal is said."""
        return self.recording and all(any(_same(p, f) for p in self.said["problems"]) for f in self.said["faults"])

    @property
    def rows(self) -> bool:
        """Whether the spoilt rows of the spoilt signal are said."""
        return self.recording and all(
            any(_same(p, f) and _overlap(p[3], f[3]) for p in self.said["problems"]) for f in self.said["faults"]
        )

    @property
    def shift(self) -> bool:
        """Whether a shifted clock is called a delay or a shift, and the other mentioned, or read so and said."""
        text = " ".join((*self.said["notes"], *(p[4] for p in self.said["problems"])))
        if self.verdict == "data_problem":
            return any(p[2] == "time shift" for p in self.said["problems"]) and "input_delay" in text
        if set(self.named) == {"input_delay"}:
            return "time shift" in text
        return self.verdict == "nothing" and "time shift" in text and "is read so everywhere" in text

    @property
    def right(self) -> bool:
        """Whether the answer as a whole is the one that counts in its condition."""
        condition, verdict = self.case.condition, self.verdict
        if verdict == ERROR:
            return False
        if condition in ("nothing", "gusts"):
            return verdict in self.case.verdicts
        if condition == "unknown":
            return verdict == "unknown_effect" and self.signal
        if condition == "corrupted":
            return verdict == "data_problem" and self.rows
        if condition == "shifted":
            return self.shift
        return self.answered and (condition != "tie" or verdict == "tie")

    @property
    def answer_line(self) -> str:
        """The answer in one line."""
        if self.verdict == ERROR:
            return f"error: {' '.join(self.said['notes'])}"
        parts = []
        for name in self.named:
            rivals = self.said.get("rivals", {}).get(name, ())
            parts.append(f"{name} (or {', '.join(rivals)})" if rivals else name)
        follows = self.said.get("follows", ())
        if self.verdict == "unknown_effect" or (follows and not parts):
            parts.append(f"follows {', '.join(follows)}")
        parts += [f"{p[0]} {p[1]} {p[2]}{'' if p[3] is None else f' rows {p[3][0]}–{p[3][1]}'}" for p in self.problems]
        return f"{self.verdict}: {'; '.join(parts)}" if parts else self.verdict

    @property
    def problems(self) -> list[Any]:
        """Data problems that were said."""
        return list(self.said.get("problems", ()))

    @property
    def truth_line(self) -> str:
        """The truth in one line."""
        if self.case.condition in ("corrupted", "shifted"):
            faults = [f"{f[0]} {f[1]} {f[2]} rows {f[3][0]}–{f[3][1]}" for f in self.said.get("faults", ())]
            return "; ".join(faults[:1]) or self.case.corruption
        if self.case.condition == "nothing":
            return "nothing"
        shares = {e: self.shares.get(e) for e in self.case.effects}
        return ", ".join(e if s is None else f"{e} ({100 * s:.0f} % of the error)" for e, s in shares.items())


def _groups(signals: Iterable[str]) -> set[str]:
    """Signals without their axes."""
    return {s.partition(".")[0] for s in signals}


def _same(problem: Any, fault: Any) -> bool:
    said, true = (("time" if s == "t" else s.partition(".")[0]) for s in (problem[1], fault[1]))
    return bool(problem[0] == fault[0] and said == true)


def _overlap(said: Any, true: Any) -> bool:
    """Whether said rows (first, last) hit the true ones and are not many more; None: all."""
    if said is None:
        return bool(true[0] == 0)
    hit = said[0] <= true[1] + NEAR and said[1] >= true[0] - NEAR
    enough = said[1] - said[0] >= (true[1] - true[0]) / 2 - NEAR
    return bool(hit and enough and said[1] - said[0] <= true[1] - true[0] + SLACK)
