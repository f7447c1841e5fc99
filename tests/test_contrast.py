"""Contrasts and verdicts on synthetic evidence whose truth is known: coverage, and the rate of wrong verdicts."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.stats

from bench.analysis.contrast import Cell, _prior_freedom, contrast
from bench.claims import family
from bench.claims.estimate import ALIKE, DIFFERS, OPEN, REPRODUCED, ZONE, Estimate, decide, settle
from bench.claims.kinds.tables import Row, ratio
from bench.claims.outlook import outlook

Rng = np.random.Generator


def test_seeds_alone_and_recordings_alone_are_students() -> None:
    rng = np.random.default_rng(0)
    for values in (rng.normal(0.1, 0.2, (7, 1)), rng.normal(0.1, 0.2, (1, 7))):
        found = contrast([(1.0, Cell(values))])
        expected = scipy.stats.ttest_1samp(values.ravel(), 0).confidence_interval(0.95)
        half = found.half_width(0.05)
        assert (found.value - half, found.value + half) == pytest.approx(tuple(expected))


def test_unequal_spreads_of_seeds_are_welchs() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.3, 0.1, (4, 1)), rng.normal(0.0, 0.5, (6, 1))
    found = contrast([(1.0, Cell(a)), (-1.0, Cell(b))])
    expected = scipy.stats.ttest_ind(a.ravel(), b.ravel(), equal_var=False).confidence_interval(0.95)
    assert found.value + found.half_width(0.05) == pytest.approx(expected.high)


def test_the_prior_is_found_again() -> None:
    """Variances drawn from an inverse chi-square distribution, each seen through three seeds."""
    rng = np.random.default_rng(0)
    for freedom in (2.0, 4.0, 20.0):
        true = 0.04 * freedom / rng.chisquare(freedom, 8000)
        seen = true * rng.chisquare(2, 8000) / 2
        assert _prior_freedom([(v, 2) for v in seen]) == pytest.approx(freedom, rel=0.2)


# ------------------------------------------------------------------------------------------------------- coverage


@dataclass(frozen=True)
class World:
    """How trainings and recordings of a study truly spread, in logs."""

    cells: int
    """Configurations times axes."""
    sides: int
    """Axes of each side of the contrast."""
    recordings: int
    of_seeds: Callable[[Rng, int], np.ndarray]
    """Standard deviation of the seeds of every cell."""
    of_recordings: float = 0.05
    alike: float = 0.7
    """Share of the recordings' variance that all axes have in common."""
    seeds: int = 3
    rough: bool = False
    """Seeds of Student's t with 4 degrees of freedom, recordings of a skewed distribution."""
    scatter: float = 0.03

    def draw(self, rng: Rng) -> tuple[list[Cell], list[tuple[float, Cell]]]:
        """All cells of a study, and a contrast of them that is truly 0."""
        shape = (self.cells, self.seeds)
        seeds = rng.standard_t(4, shape) / math.sqrt(2) if self.rough else rng.standard_normal(shape)
        seeds = seeds * self.of_seeds(rng, self.cells)[:, None]
        flights = (rng.exponential(1, s) - 1 if self.rough else rng.standard_normal(s) for s in self._shapes)
        common, own = (self.of_recordings * math.sqrt(p) * f for p, f in zip(self._shares, flights, strict=True))
        values = seeds[:, :, None] + rng.normal(0, self.scatter, (*shape, self.recordings))
        values[: self.sides] += (common + own)[: self.sides, None]
        cells = [Cell(v) for v in values]
        one = 1 / self.sides
        signs = [one] * self.sides + [-one] * (self.sides if self.cells > 1 else 0)
        return cells, list(zip(signs, cells, strict=False))

    @property
    def _shapes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        return (1, self.recordings), (self.cells, self.recordings)

    @property
    def _shares(self) -> tuple[float, float]:
        return self.alike, 1 - self.alike


def equal(rng: Rng, cells: int) -> np.ndarray:
    return np.full(cells, 0.05)


def unequal(rng: Rng, cells: int) -> np.ndarray:
    return 0.04 * np.exp(rng.normal(0, 0.7, cells))


def two_kinds(rng: Rng, cells: int) -> np.ndarray:
    """Every fourth configuration is ten times as noisy."""
    return np.where(rng.uniform(size=cells) < 0.25, 0.2, 0.02)


WORLDS = {
    "equal seeds, many flights": World(18, 3, 16, equal),
    "equal seeds, two cells of twelve": World(12, 1, 16, equal),
    "unequal seeds, few flights": World(18, 3, 4, unequal),
    "unequal seeds, small study": World(4, 1, 16, unequal),
    "two kinds of configurations": World(12, 1, 4, two_kinds),
    "axes as one, flights dominate": World(18, 3, 4, unequal, of_recordings=0.15, alike=1.0),
    "axes apart, flights dominate": World(18, 3, 6, equal, of_recordings=0.15, alike=0.0),
    "ours is the noisy one of four": World(4, 1, 16, lambda rng, cells: np.array([0.2, 0.02, 0.02, 0.02])),
    "two seeds": World(8, 1, 16, unequal, seeds=2),
    "rough seeds": World(18, 3, 6, unequal, rough=True),
    "rough flights": World(18, 3, 6, unequal, rough=True, of_recordings=0.15),
    "one cell, nothing to borrow": World(1, 1, 16, equal),
}


def coverage(world: World, studies: int) -> float:
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(studies):
        cells, weighted = world.draw(rng)
        found = contrast(weighted, cells)
        held += abs(found.value) <= found.half_width(0.05)
    return held / studies


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_intervals_hold_the_truth_in_95_of_100_studies(world: World) -> None:
    assert 0.93 <= coverage(world, 6000) <= 0.97


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_intervals_hold_the_truth_as_far_as_few_draws_tell(world: World) -> None:
    error = math.sqrt(0.95 * 0.05 / 400)
    assert 0.93 - 2 * error <= coverage(world, 400) <= 0.97 + 2 * error


def test_other_configurations_narrow_an_interval_where_seeds_spread_alike() -> None:
    rng = np.random.default_rng(0)
    widths = np.array(
        [
            [contrast(weighted, around).half_width(0.05) for around in ((), cells)]
            for cells, weighted in (WORLDS["equal seeds, two cells of twelve"].draw(rng) for _ in range(200))
        ]
    )
    assert np.median(widths[:, 1]) < 0.9 * np.median(widths[:, 0])


# ------------------------------------------------------------------------------------------------- whole procedure

BANDS = {"better": (0.0, 1.0), "worse": (1.0, math.inf), "same": ZONE}
TRUTHS = (0.55, 0.799, 0.9, 1.0, 1.0, 1.04, 1.2, 1.251, 1.6)
"""Many of them where a verdict is most easily wrong."""


def true(verdict: str, ratios: tuple[float, ...], accept: tuple[float, float]) -> bool:
    """Whether a verdict on a claim that all ratios lie in a band holds; at 1 neither is better."""

    def strictly(r: float, band: tuple[float, float]) -> bool:
        return band[0] < r < band[1]

    if verdict == REPRODUCED:
        return all(strictly(r, accept) for r in ratios)
    if verdict == DIFFERS:
        return any(r < accept[0] or r > accept[1] for r in ratios)
    return any(strictly(r, ZONE) for r in ratios) and all(strictly(r, ZONE) or strictly(r, accept) for r in ratios)


Truth = tuple[tuple[float, ...], tuple[float, float]]
"""Ratios that a claim is about, and its band."""


@dataclass
class Drawn:
    """A study with its claims, to be looked at with any number of its seeds."""

    cells: list[Cell]
    first: int
    """Seeds at the first look."""
    claims: list[tuple[Truth, list[tuple[int, int]]]]
    """What is asked, and the cells of each of its numbers."""

    def questions(self, seeds: int) -> list[tuple[family.Question, Truth]]:
        cells = [Cell(c.values[:seeds]) for c in self.cells]
        flights = tuple(map(str, range(cells[0].values.shape[1])))
        found = []
        for (ratios, accept), pairs in self.claims:
            estimates = []
            for value, (i, j) in zip(ratios, pairs, strict=True):
                shifted = Row(Cell(cells[i].values + math.log(value)), flights)
                around = [c for c in cells if c is not cells[i]]
                estimates += ratio("", [(shifted, [Row(cells[j], flights)])], around)
            found.append((family.Question(estimates, accept, True, self.first, seeds), (ratios, accept)))
        return found


def page(
    rng: Rng, worlds: list[World], ratios: tuple[float, ...], bands: tuple[str, ...], numbers: int, seeds: int = 0
) -> list[Drawn]:
    """Five studies, four to eight claims each, on the same trainings and flights, of 1 to so many numbers each."""
    studies = []
    for world in rng.permutation(np.array(worlds, dtype=object))[:5]:
        cells, _ = replace(world, seeds=max(world.seeds, seeds)).draw(rng)
        claims = []
        for _ in range(int(rng.integers(4, 9))):
            chosen = tuple(float(r) for r in rng.choice(ratios, int(rng.integers(1, numbers + 1))))
            pairs = [tuple(map(int, rng.permutation(len(cells))[:2])) for _ in chosen]
            claims.append(((chosen, BANDS[str(rng.choice(bands))]), pairs))
        studies.append(Drawn(cells, world.seeds, claims))
    return studies


Asked = list[tuple[family.Question, Truth]]


def verdicts(asked: list[Asked]) -> list[list[str]]:
    """Of every claim of every study, as one family."""
    alpha = family.level([question for each in asked for question, _ in each])
    return [[decide(q.found, q.accept, q.level(alpha), q.relative)[0] for q, _ in each] for each in asked]


def wrong(asked: list[Asked]) -> tuple[float, float]:
    """Share of the verdicts on a page that are wrong, and share of its claims that got one."""
    given = [v for each in verdicts(asked) for v in each]
    truths = [truth for each in asked for _, truth in each]
    settled = [true(v, *truth) for v, truth in zip(given, truths, strict=True) if v != OPEN]
    return settled.count(False) / max(1, len(settled)), len(settled) / len(given)


def first_look(studies: list[Drawn]) -> list[Asked]:
    return [s.questions(s.first) for s in studies]


def seeds_until_settled(studies: list[Drawn], most: int) -> list[Asked]:
    """Seeds are added to each study in turn until none of its claims is open, all claims being judged at every look."""
    asked = first_look(studies)
    for i, drawn in enumerate(studies):
        for seeds in range(drawn.first + 1, most + 1):
            if OPEN not in verdicts(asked)[i]:
                break
            asked[i] = drawn.questions(seeds)
    return asked


def test_of_the_verdicts_given_at_most_5_in_100_are_wrong() -> None:
    rng = np.random.default_rng(0)
    worlds = [w for w in WORLDS.values() if w.cells > 1]
    shares = np.array([wrong(first_look(page(rng, worlds, TRUTHS, tuple(BANDS), 2))) for _ in range(60)])
    assert shares[:, 0].mean() <= 0.05
    assert shares[:, 1].mean() > 0.4


def test_seeds_added_until_a_verdict_is_there_make_no_more_of_them_wrong() -> None:
    rng = np.random.default_rng(0)
    worlds = [w for w in WORLDS.values() if w.cells > 1]
    shares = []
    for _ in range(10):
        studies = page(rng, worlds, TRUTHS, tuple(BANDS), 2, seeds=8)
        shares.append((*wrong(first_look(studies)), *wrong(seeds_until_settled(studies, 8))))
    _, before, mistaken, after = np.mean(shares, axis=0)
    assert mistaken <= 0.05
    assert after > before + 0.08


def noisy_pages(count: int, seeds: int = 0) -> list[list[Drawn]]:
    """No better, no worse, and too much scatter to say so: every verdict of direction is wrong."""
    rng = np.random.default_rng(0)
    noisy = [replace(w, of_recordings=0.6, scatter=0.3) for w in WORLDS.values() if w.cells > 1]
    return [page(rng, noisy, (1.0,), ("better", "worse"), 1, seeds) for _ in range(count)]


def test_where_nothing_differs_a_page_has_a_wrong_verdict_in_5_of_100_cases() -> None:
    shares = [wrong(first_look(studies))[0] for studies in noisy_pages(150)]
    assert np.mean(shares) <= 0.05 + 2 * math.sqrt(0.05 * 0.95 / 150)


@pytest.mark.slow
def test_where_nothing_differs_seeds_added_make_no_more_pages_wrong() -> None:
    shares = [wrong(seeds_until_settled(studies, 8))[0] for studies in noisy_pages(150, seeds=8)]
    assert np.mean(shares) <= 0.05 + 2 * math.sqrt(0.05 * 0.95 / 150)


# ------------------------------------------------------------------------------------------------- verdicts, outlook


def numbers(rng: Rng, *ratios: float, spread: float, seeds: int = 3, flights: int = 8) -> list[Estimate]:
    names = tuple(map(str, range(flights)))
    return [
        e
        for r in ratios
        for e in ratio("", [(Row(Cell(rng.normal(math.log(r), spread, (seeds, flights))), names), ())])
    ]


@pytest.mark.parametrize(
    ("ratios", "spread", "accept", "expected"),
    [
        ((0.5,), 0.02, "better", REPRODUCED),
        ((1.5,), 0.02, "better", DIFFERS),
        ((1.0,), 0.05, "better", ALIKE),
        ((1.0,), 0.05, "worse", ALIKE),
        ((1.0,), 0.05, "same", REPRODUCED),
        ((1.0,), 0.50, "better", OPEN),
        ((0.5, 1.0), 0.05, "better", ALIKE),
        ((1.5, 1.0), 0.05, "better", DIFFERS),
        ((1.5, 1.0), 0.05, "worse", ALIKE),
    ],
)
def test_a_small_difference_settles_a_claim_of_direction(
    ratios: tuple[float, ...], spread: float, accept: str, expected: str
) -> None:
    found = numbers(np.random.default_rng(3), *ratios, spread=spread)
    assert settle(found, BANDS[accept], relative=True).verdict == expected
    if expected == ALIKE:  # a band of a number that is no ratio knows no such thing
        assert settle(found, BANDS[accept], relative=False).verdict == OPEN


def test_what_settles_a_claim_is_as_many_seeds_as_it_says() -> None:
    """Drawn anew with that many, a claim is settled about as often as not; with those it had, seldom."""
    rng = np.random.default_rng(0)
    flat = World(1, 1, 40, lambda rng, cells: np.full(cells, 0.3), of_recordings=0.0, scatter=0.02)

    def question(seeds: int) -> family.Question:
        cell = replace(flat, seeds=seeds).draw(rng)[0][0]
        found = ratio("", [(Row(Cell(cell.values + math.log(0.7)), tuple(map(str, range(40)))), ())])
        return family.Question(found, (0.0, 1.0), True)

    said = [seeds for q in (question(4) for _ in range(60)) if (seeds := outlook(q, 0.05)[1])]
    typical = int(np.median(said))
    settled = [np.mean([settle(*question(n)[:2]).verdict == REPRODUCED for _ in range(100)]) for n in (4, typical)]
    assert 4 < typical <= 10 and settled[0] < settled[1] and 0.3 <= settled[1] <= 0.9


def test_what_seeds_cannot_settle_recordings_can() -> None:
    names = tuple(map(str, range(6)))
    cells = Cell(np.tile(math.log(0.9) + 0.2 * np.array([-1, 1, -1, 1, -1, 1]), (3, 1)) + np.arange(3)[:, None] / 1e3)
    found = ratio("", [(Row(cells, names), ())])
    said, seeds = outlook(family.Question(found, (0.0, 1.0), True), 0.05)
    assert seeds == 0 and said.startswith("no number of seeds, but about")
    touching = outlook(family.Question(found, (math.exp(cells.values.mean()), math.inf), True), 0.05)
    assert touching[0].startswith("nothing at this size")
