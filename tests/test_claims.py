"""Verdicts on evidence whose truth is known, and the claims of the paper themselves."""

import fnmatch
import json
import math
import shlex
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import scipy.stats
import synthetic_study
from conftest import Toy
from synthetic_evidence import concluded, evidence

from bench.analysis.tables import POOLED, comparisons
from bench.claims import claim as claims_file
from bench.claims import family, judge
from bench.claims.claim import KINDS, Claim, _build
from bench.claims.estimate import DIFFERS, NOT_RUN, OPEN, REPRODUCED, Estimate, Kind, settle
from bench.claims.evidence import Evidence
from bench.claims.gathering import gather, left_out
from bench.claims.kinds.counting import Fact
from bench.claims.kinds.levels import _level_limits
from bench.cli import cli
from bench.experiment import study
from registry.core import DATASETS
from registry.errors import BenchError

A, B = "LSTM: 1x50 - MLP: 60x10", "LSTM: 1x50 - Washout: 10"
C, D = "MLFC: 2x50 - MLP: 60x10", "MLFC: 2x50 - Washout: 10"
TAUS = tuple(f"LSTM: 1x50 - Washout: {t}" for t in (5, 10, 20))
BELOW, ABOVE, WITHIN = (0.0, 1.0), (1.0, math.inf), (0.8, 1.25)


def times(**factors: float) -> Any:
    """Errors that are a factor of the usual: by configuration (a, b, c, d) or signal."""
    names = dict(a=A, b=B, c=C, d=D)

    def truth(spec: str, signal: str, step: np.ndarray) -> np.ndarray:
        factor = math.prod(f for k, f in factors.items() if names.get(k, k) in (spec, signal))
        return factor * (1 + step / 40)

    return truth


def shaped(kind: str) -> Any:
    """A curve that rises, or peaks early, or is flat."""
    curves = {
        "rising": lambda t, x: 1 + x,
        "peak": lambda t, x: 0.5 + 8 * x * np.exp(-6 * x),
        "late": lambda t, x: 0.5 + np.exp(-(((x - 0.8) / 0.3) ** 2)),
        "flat": lambda t, x: 1 + 0 * x,
    }
    return lambda spec, signal, step: curves[kind](step, step / step[-1])


def swept(*factors: float) -> Any:
    """A factor for each history of `TAUS`; its early peak alone if ``factors`` are negative."""

    def truth(spec: str, signal: str, step: np.ndarray) -> np.ndarray:
        return factors[TAUS.index(spec)] * (1 + np.exp(-(((step - 0.2 * step[-1]) / (0.1 * step[-1])) ** 2)))

    return truth


PAIR = {"pairs": [[A, B]], "quantities": ["rates"], "horizons": [40]}
ONE = {"specs": [A], "quantities": ["rates"], "horizons": [40]}
RATIO_OF = {"specs": [A], "quantities": [["velocity", "velocity_forced"]], "horizons": [40]}
FORCED = ("velocity", "velocity_forced")
CASES: list[tuple[str, dict[str, Any], tuple[float, float], dict[str, Evidence]]] = [
    (
        "ratio",
        PAIR,
        BELOW,
        {
            REPRODUCED: evidence(times(a=0.7), (A, B)),
            DIFFERS: evidence(times(a=1.3), (A, B)),
            OPEN: evidence(times(a=0.97), (A, B), noise=0.3),
            "not enough evidence: one seed": evidence(times(a=0.7), (A, B), seeds=1),
            "not enough evidence: one recording": evidence(times(a=0.7), (A, B), recordings=1),
            NOT_RUN: evidence(times(), (A, C)),
        },
    ),
    (
        "alike",
        {**ONE, "specs": [A, B, C]},
        WITHIN,
        {
            REPRODUCED: evidence(times(a=1.03), (A, B, C)),
            DIFFERS: evidence(times(c=1.6), (A, B, C)),
            OPEN: evidence(times(), (A, B, C), noise=0.3),
        },
    ),
    (
        "factor",
        RATIO_OF,
        (16.7, 37.5),
        {
            REPRODUCED: evidence(times(velocity=25), (A,), signals=FORCED),
            DIFFERS: evidence(times(velocity=3), (A,), signals=FORCED),
            OPEN: evidence(times(velocity=17), (A,), signals=FORCED, noise=0.2),
        },
    ),
    (
        "factor",
        {**RATIO_OF, "against": [B]},
        ABOVE,
        {
            REPRODUCED: evidence(
                lambda s, q, t: (30 if s == A else 20) ** (q == "velocity") + 0 * t, (A, B), signals=FORCED
            ),
            DIFFERS: evidence(
                lambda s, q, t: (20 if s == A else 30) ** (q == "velocity") + 0 * t, (A, B), signals=FORCED
            ),
            OPEN: evidence(times(velocity=25), (A, B), signals=FORCED, noise=0.2),
        },
    ),
    (
        "fewer_weights",
        {"a": "LSTM: * - MLP: *", "b": "MLFC: * - MLP: *", "quantities": ["rates"], "horizons": [40]},
        BELOW,
        {
            REPRODUCED: evidence(times(a=0.7), (A, C), weights={A: 500}),
            DIFFERS: evidence(times(a=1.4), (A, C), weights={A: 500}),
            OPEN: evidence(times(a=0.97), (A, C), weights={A: 500}, noise=0.3),
            NOT_RUN: evidence(times(a=0.7), (A, C), weights={A: 2000}),
        },
    ),
    (
        "norms",
        {**ONE, "specs": ["LSTM*", "MLFC*"]},
        WITHIN,
        {
            REPRODUCED: evidence(times(a=0.7), (A, B, C)),
            DIFFERS: evidence(times(a=0.7), (A, B, C), euclid={C: 1.5}),
            OPEN: evidence(times(a=0.7), (A, B, C), seeds=1),
        },
    ),
    (
        "convergence",
        {"pairs": [[A, B]], "horizons": [40]},
        BELOW,
        {
            REPRODUCED: evidence(times(), (A, B), updates={A: 50}),
            DIFFERS: evidence(times(), (A, B), updates={A: 200}),
            OPEN: evidence(times(), (A, B), updates={A: 98}, noise=0.2),
            NOT_RUN: evidence(times(), (A, C)),
        },
    ),
    (
        "level",
        {**ONE, "unit": "rad/s"},
        (0.0, 3.5 * math.pi / 180),
        {
            REPRODUCED: evidence(lambda *x: 2.0 + 0 * x[2], (A,)),
            DIFFERS: evidence(lambda *x: 6.0 + 0 * x[2], (A,)),
            OPEN: evidence(lambda *x: 2.9 + 0 * x[2], (A,), noise=0.2),
        },
    ),
    (
        "quantile",
        {**ONE, "unit": "deg/s"},
        (0.0, 9.0),
        {
            REPRODUCED: evidence(lambda *x: 2.0 + 0 * x[2], (A,)),
            DIFFERS: evidence(lambda *x: 6.0 + 0 * x[2], (A,)),
            OPEN: evidence(lambda *x: 2.0 + 0 * x[2], (A,), seeds=1),
        },
    ),
    (
        "early_peak",
        {**ONE, "horizons": [190]},
        BELOW,
        {
            REPRODUCED: evidence(shaped("peak"), (A,), (190,)),
            DIFFERS: evidence(shaped("rising"), (A,), (190,)),
            OPEN: evidence(shaped("peak"), (A,), (190,), seeds=1),
            "differs: it falls and never rose": evidence(lambda s, q, t: 2 - t / 190, (A,), (190,)),
            "differs: its peak is late": evidence(shaped("late"), (A,), (190,)),
        },
    ),
    (
        "early_peak",
        {**ONE, "horizons": [190], "anywhere": True},
        BELOW,
        {
            REPRODUCED: evidence(shaped("late"), (A,), (190,)),
            DIFFERS: evidence(shaped("rising"), (A,), (190,)),
        },
    ),
    (
        "growth",
        ONE,
        ABOVE,
        {
            REPRODUCED: evidence(shaped("rising"), (A,)),
            DIFFERS: evidence(shaped("peak"), (A,)),
            OPEN: evidence(shaped("rising"), (A,), seeds=1),
        },
    ),
    (
        "history_spread",
        {**ONE, "specs": ["LSTM: * - Washout: *"]},
        (1.25, math.inf),
        {
            REPRODUCED: evidence(swept(1, 1, 1.7), TAUS),
            DIFFERS: evidence(swept(1, 1.02, 1), TAUS),
            OPEN: evidence(swept(1, 1, 1.2), TAUS, noise=0.2),
        },
    ),
    (
        "history_spread",
        {**ONE, "specs": ["LSTM: * - Washout: *"]},
        (1.0, 1.25),
        {
            REPRODUCED: evidence(swept(1, 1.02, 1), TAUS),
            DIFFERS: evidence(swept(1, 1, 1.7), TAUS),
            OPEN: evidence(swept(1, 1, 1.2), TAUS, noise=0.2),
        },
    ),
    (
        "peak_shrinks",
        {**ONE, "specs": ["LSTM: * - Washout: *"]},
        BELOW,
        {
            REPRODUCED: evidence(swept(1, 1, 0.7), TAUS),
            DIFFERS: evidence(swept(1, 1, 1.3), TAUS),
            OPEN: evidence(swept(1, 1, 1), TAUS, noise=0.2),
        },
    ),
    (
        "diverged",
        {"a": B, "b": A},
        (0.05, 1.0),
        {
            REPRODUCED: evidence(times(), (A, B), seeds=30, recordings=1, lost={B: 10}),
            DIFFERS: evidence(times(), (A, B), seeds=120, recordings=1),
            OPEN: evidence(times(), (A, B), seeds=9, recordings=1, lost={B: 1}),
            "reproduced: all against none": evidence(times(), (A, B), seeds=16, recordings=1, lost={B: 16}),
        },
    ),
]


def verdict(kind: Kind, found: Evidence, accept: tuple[float, float]) -> str:
    return settle(kind.measure(found), accept, 0.05, kind.relative).verdict


@pytest.mark.parametrize(("kind", "judge", "accept", "truths"), CASES, ids=[c[0] for c in CASES])
def test_every_kind_finds_the_truth(
    kind: str, judge: dict[str, Any], accept: tuple[float, float], truths: dict[str, Evidence]
) -> None:
    made: Kind = _build(KINDS[kind], judge, "test")
    found = {expected: verdict(made, seen, accept) for expected, seen in truths.items()}
    assert found == {expected: expected.partition(":")[0] for expected in truths}


def test_every_kind_has_a_case() -> None:
    assert {k for k, kind in KINDS.items() if issubclass(kind, Kind)} == {c[0] for c in CASES}


@pytest.mark.parametrize(("kind", "accept"), [("early_peak", BELOW), ("growth", ABOVE)])
def test_no_shape_is_found_in_noise(kind: str, accept: tuple[float, float]) -> None:
    """Every network and every recording has bumps of its own, nowhere in common.

    A peak that is looked for in the very curve that it is judged on would be found in all of them.
    """
    made: Kind = _build(KINDS[kind], {**ONE, "horizons": [120]}, "test")
    rng = np.random.default_rng(0)

    def bumps() -> np.ndarray:
        return np.exp(0.5 * np.sin(2 * np.pi * (np.arange(120) / 60 + rng.uniform())))

    found = []
    for draw in range(12):
        seen = evidence(lambda *_: bumps(), (A,), (120,), seeds=3, recordings=10, draw=draw)
        of_recording = {f"mean@flight{r}": bumps() for r in range(10)}
        for curves in seen.curves.values():
            for statistic in curves.keys() & of_recording.keys():
                curves[statistic] = curves[statistic] * of_recording[statistic]
        found.append(verdict(made, seen, accept))
    assert found.count(REPRODUCED) <= 2


def test_a_training_that_meets_several_others_counts_once() -> None:
    """As many opponents as one likes, themselves without scatter, say no more than the trainings they meet."""
    once: Kind = _build(KINDS["ratio"], PAIR, "test")
    thrice: Kind = _build(KINDS["ratio"], {**PAIR, "pairs": [[A, B], [A, C], [A, D]]}, "test")
    seen = evidence(times(), (A, B, C, D), seeds=3, noise=0.2)
    for (key, _, _), curves in seen.curves.items():
        if not key.startswith(A):  # the same errors for all seeds of all opponents
            curves.update({s: c for s, c in seen.curves[f"{B}|40|0", "body_rates", "paper"].items() if s in curves})
    (one,), (three,) = (kind.measure(seen) for kind in (once, thrice))
    assert (three.value, three.low, three.high) == pytest.approx((one.value, one.low, one.high))


def test_two_trainings_do_not_bound_the_next() -> None:
    """Limits of a level hold the truth as often as they say, where seeds differ by 10 %."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        seeds, recordings = (np.exp(rng.normal(0, 0.1, n)) for n in (2, 20))
        low, high = _level_limits(np.multiply.outer(np.outer(seeds, recordings), np.linspace(1, 2, 9)), np.max, 0.95)
        held += low <= 2 * math.exp(0.01) <= high
    assert held >= 180


def test_a_ratio_is_that_of_the_study_table(tmp_path: Path) -> None:
    records = synthetic_study.study(tmp_path / "runs", {40: 3}, axes="pq")
    concluded(records, "bench run washout_vs_mlp", tmp_path / "studies" / "x")
    (found,) = gather(tmp_path / "published", tmp_path / "studies")
    assert len(found.runs) == len(records)
    table = comparisons(records, synthetic_study.PAIRS)
    for phase, words in {"first": "first 5 steps", "whole": "whole horizon", "last": "last 20 steps"}.items():
        (row,) = table[
            (table.a == synthetic_study.MLP) & (table.phase == words) & (table.output == POOLED)
        ].itertuples()
        kind: Kind = _build(KINDS["ratio"], {**PAIR, "phase": phase}, "test")
        (made,) = kind.measure(found)
        assert made.value == pytest.approx(row.ratio, rel=1e-3)
        assert 0.4 < math.log(made.high / made.low) / math.log(row.high / row.low) < 1.6  # axes are strata here


def test_a_training_that_diverged_takes_no_other_with_it(tmp_path: Path) -> None:
    records = synthetic_study.study(tmp_path / "runs", {40: 3}, axes="pq", lost=((synthetic_study.MLP, 1),))
    concluded(records, "bench run washout_vs_mlp", tmp_path / "studies" / "x")
    (found,) = gather(tmp_path / "published", tmp_path / "studies")
    assert not found.runs[[r.key for r in found.runs].index(records[7].key)].metrics
    kind: Kind = _build(KINDS["ratio"], PAIR, "test")
    (made,) = kind.measure(found)
    assert "11 trained networks in 4 groups" in made.basis and made.seeds == 2


def test_smoke_tests_and_altered_studies_are_no_evidence(tmp_path: Path) -> None:
    records = synthetic_study.study(tmp_path / "runs", {40: 1}, axes="p")
    asked = (" --preset smoke", " --set training.updates=3", " --physics=model.toml", " -T10")
    for i, more in enumerate(asked):
        concluded(records, f"bench run washout_vs_mlp{more}", tmp_path / "studies" / str(i))
    assert gather(tmp_path / "none", tmp_path / "studies") == []
    said = left_out(tmp_path / "studies")
    assert len(said) == 4 and "--set" in said[1] and "preset smoke" in said[0]
    concluded(records, "bench run washout_vs_mlp --preset=paper --seeds 9", tmp_path / "studies" / "paper")
    assert [e.preset for e in gather(tmp_path / "none", tmp_path / "studies")] == ["paper"]


# ----------------------------------------------------------------------------------------------- many claims at once


def judging(p: float) -> Estimate:
    """A number that lies below 1 at every α from p on."""
    return Estimate("x", 0.5, lambda alpha, *_: (0.4, 0.9 if alpha >= p else 2.0))


def test_the_family_is_that_of_benjamini_and_hochberg() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        p = rng.uniform(0, 1, 6) ** 4
        asked: list[family.Question] = [family.Question([judging(x)], BELOW, True) for x in p]
        alpha = family.level(asked)
        found = [family.judged(q, alpha, 6).verdict == REPRODUCED for q in asked]
        assert found == (scipy.stats.false_discovery_control(p) <= 0.05).tolist()


def test_what_stands_alone_but_not_among_many_says_so() -> None:
    asked: list[family.Question] = [family.Question([judging(p)], BELOW, True) for p in (0.04, 0.9, 0.9, 0.9, 0.9)]
    found = family.judged(asked[0], family.level(asked), 5)
    assert found.verdict == OPEN and "not as one of 5" in found.basis and found.high == 0.9


def test_one_of_several_numbers_outside_needs_a_stricter_interval() -> None:
    """Among 20 numbers that all hold, one interval at 95 % lies outside by chance."""
    found = [
        Estimate(str(i), 1.0, lambda alpha, *_, i=i: (1.01 if alpha > 0.02 and i == 3 else 0.9, 1.5)) for i in range(20)
    ]
    assert settle(found, BELOW, 0.05).verdict == OPEN


# ------------------------------------------------------------------------------------------------ the paper's claims


CLAIMS = claims_file.read()


def test_the_claims_that_the_paper_makes_are_there() -> None:
    claims = CLAIMS.claims
    assert len(claims) >= 40
    assert {c.study for c in claims} - {""} == set(study.studies()) - {"nanodrone_benchmark", "nonlinear_benchmarks"}, (
        "which is not the paper's"
    )
    for c in claims:
        assert c.text.endswith(".") and c.source, c.id
        assert (c.published is None) or (c.scope == "dataset"), c.id
    notes = " ".join(c.note for c in claims)
    for said in ("1,388,410", "5.85 m/s and 3.91", "τ+1"):
        assert said in notes


def test_an_installed_package_reads_the_checkout_that_one_stands_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = claims_file.checkout()
    monkeypatch.setattr(claims_file, "__file__", str(tmp_path / "site-packages" / "bench" / "claims" / "claim.py"))
    monkeypatch.chdir(there)
    assert claims_file.checkout() == Path() and claims_file.read().claims
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BenchError, match="work in the checkout"):
        claims_file.read()


@cache
def declared(name: str, preset: str) -> tuple[frozenset[str], frozenset[int]]:
    """Configurations and horizons of a study."""
    found = study.get(name)
    made = found.runs(preset, DATASETS.get(found.default_dataset)())
    return frozenset(r.spec for r in made), frozenset(r.horizon for r in made)


@pytest.mark.parametrize("preset", ["laptop", "paper"])
def test_every_pattern_of_a_claim_is_run_by_its_study(preset: str) -> None:
    for c in CLAIMS.claims:
        if c.study:
            specs, horizons = declared(c.study, preset)
            for pattern in judge.patterns(c):
                matched = fnmatch.filter(specs, pattern)
                assert matched, (c.id, pattern)
                if preset == "paper" and c.study != "initialization_length":
                    assert set(matched) <= CLAIMS.paper_specs, (c.id, matched)
            assert set(getattr(c.kind, "horizons", ())) <= horizons, c.id


def test_every_command_parses() -> None:
    rows = judge.judge(CLAIMS, [], facts=False)
    assert [r.claim.id for r in rows] == [c.id for c in CLAIMS.claims]
    assert {r.judgement.verdict for r in rows} == {NOT_RUN}
    for row in rows:
        words = shlex.split(row.command)
        assert words[0] == "bench"
        command: Any = cli
        rest = words[1:]
        while isinstance(command, click.Group):
            command, rest = command.get_command(click.Context(command), rest[0]), rest[1:]
        command.make_context("bench", rest)


def _claims(made: Claim) -> claims_file.Claims:
    return claims_file.Claims((made,), frozenset())


def test_a_dataset_bound_claim_is_not_judged_on_other_data() -> None:
    kind = _build(KINDS["level"], {**ONE, "unit": "deg/s"}, "test")
    made = Claim("x", "X.", "s", "dataset", kind, (0.0, 3.5), needs="pelican", study="quadrotor_black_box")
    seen = replace(evidence(lambda *x: 2.0 + 0 * x[2], (A,)), study="quadrotor_black_box", dataset="pelican_twin")
    (row,) = judge.judge(_claims(made), [seen])
    assert (row.judgement.verdict, row.judgement.basis) == (NOT_RUN, "needs pelican")
    assert row.beside.startswith("pelican_twin: 2.")
    (row,) = judge.judge(_claims(made), [replace(seen, dataset="pelican")])
    assert row.judgement.verdict == REPRODUCED
    assert row.label == "laptop, at reduced size"


@pytest.mark.parametrize(
    ("kind", "values", "here"),
    [
        ("samples", {}, 2000),
        ("hours", {}, 20 / 3600),
        ("maxima", {"names": ["euler_rates.roll"], "values": [2.0]}, None),
    ],
)
def test_facts_are_counted_in_the_recordings(kind: str, values: dict[str, Any], here: float | None) -> None:
    loaded = Toy().load()
    fact: Fact = _build(KINDS[kind], values, "test")
    (found,) = fact.count(loaded)
    if here is None:
        here = max(np.abs(r.outputs[:, 0]).max() for r in loaded.recordings) / 2
    assert found.value == pytest.approx(here)
    made = Claim("x", "X.", "s", "dataset", fact, (0.99 * here, 1.01 * here), needs="toy")
    (row,) = judge.judge(_claims(made), [])
    assert row.judgement.verdict == REPRODUCED
    (row,) = judge.judge(_claims(replace(made, accept=(2 * here, 3 * here))), [])
    assert row.judgement.verdict == DIFFERS


GOOD = """
[[claim]]
id = "x"
text = "X."
source = "s"
scope = "comparative"
study = "washout_vs_mlp"
judge = {kind = "diverged", a = "x", b = "y"}
accept = [0.0, 1.0]
"""


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('kind = "diverged"', 'kind = "divreged"', "did you mean diverged"),
        ('a = "x", ', "", "a is missing"),
        ('a = "x"', "a = 3", "wrong type"),
        ("accept", "accpet", "did you mean accept"),
        ("[0.0, 1.0]", "[1.0, 0.0]", "lowest, highest"),
        ('scope = "comparative"', 'scope = "dataset"', "needs"),
        ('study = "washout_vs_mlp"', "", "study"),
        ("[[claim]]", "[[claim]", "cannot be read"),
        ("[[claim]]", "[[claims]]", "holds no"),
        ("", GOOD, "two claims"),
    ],
)
def test_a_mistake_in_the_claims_is_one_sentence(old: str, new: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "claims.toml"
    file.write_text(GOOD)
    assert claims_file.read(file).claims[0].id == "x"
    file.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(BenchError, match=says):
        claims_file.read(file)


def test_a_damaged_study_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    for text in ("{", json.dumps({"study": "s", "command": "bench run s", "runs": [{"key": 1}]})):
        (tmp_path / "x" / "study.json").write_text(text)
        with pytest.raises(BenchError, match="damaged"):
            gather(tmp_path, tmp_path / "none")
