"""Tables, sentences and figures of a study whose effects are known (tests/synthetic_study.py)."""

import io
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.stats
import synthetic_study as synthetic
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from rich.console import Console
from synthetic_records import resealed
from synthetic_study import MLP, PAIRS, WASHOUT

from bench.analysis import tables
from bench.records.record import RunRecord
from bench.reporting import figures, report


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[RunRecord]:
    """Two horizons, three rates; one washout run diverged on p."""
    return synthetic.study(tmp_path_factory.mktemp("study"), {40: 3, 190: 1}, lost=((WASHOUT, 1),))


def row(table: pd.DataFrame, **where: object) -> pd.Series:
    for column, value in where.items():
        table = table[table[column] == value]
    assert len(table) == 1, where
    return table.iloc[0]


def test_the_table_shows_what_the_records_hold(records: list[RunRecord]) -> None:
    table = report.study_table(records)
    assert len(table) == 2 * 3 * 6
    mine = [r for r in records if (r.summary["spec"], r.summary["horizon"]) == (MLP, 40)]
    mine = [r for r in mine if r.summary["outputs"] == ["body_rates.q"]]
    found = row(table, spec=MLP, horizon=40, output="body_rates.q")
    rmsse = np.rad2deg([r.summary["metrics"]["rmsse.body_rates.q"] for r in mine])
    expected = scipy.stats.t.interval(0.95, 2, rmsse.mean(), scipy.stats.sem(rmsse))
    assert (found.unit, found.seeds, found.diverged) == ("deg/s", 3, 0)
    assert found.rmsse == pytest.approx(rmsse.mean())
    assert [found.rmsse_low, found.rmsse_high] == pytest.approx(list(expected))
    steps = pd.concat([r.steps[r.steps.statistic == "mean"] for r in mine])
    assert found["first"] == pytest.approx(steps[steps.step <= 5].value.mean())
    assert found["whole"] == pytest.approx(steps.value.mean())
    assert found["last"] == pytest.approx(steps[steps.step > 20].value.mean())
    assert math.isnan(row(table, spec=MLP, horizon=190, output="body_rates.q").rmsse_low)


def test_diverged_runs_are_counted_and_left_out(records: list[RunRecord], tmp_path: Path) -> None:
    found = row(report.study_table(records), spec=WASHOUT, horizon=40, output="body_rates.p")
    assert (found.seeds, found.diverged) == (2, 1)
    compared = row(
        report.comparisons(records, [(MLP, WASHOUT)]), horizon=40, output="body_rates.p", phase="whole horizon"
    )
    assert (compared.trainings, compared.diverged_a, compared.diverged_b) == (2, 0, 1)
    assert any(f"diverged: 1 of {WASHOUT}" in s for s in report.sentences(records, PAIRS))
    lost = [
        synthetic.record(tmp_path, spec, ("body_rates.p",), 40, 0, diverged=spec == WASHOUT) for spec in (MLP, WASHOUT)
    ]
    assert row(report.study_table(lost), spec=WASHOUT).seeds == 0
    assert "nothing to compare" in " ".join(report.sentences(lost, [(MLP, WASHOUT)]))
    assert "nan" not in report.to_markdown(lost, [(MLP, WASHOUT)], "lost", "bench run").lower()


def test_errors_that_are_not_finite_count_as_diverged(tmp_path: Path) -> None:
    record = synthetic.record(tmp_path, MLP, ("body_rates.p",), 40, 0)
    steps = record.steps.copy()
    steps.loc[steps.step == 40, "value"] = math.inf
    steps.to_parquet(record.folder / "steps.parquet")
    assert row(report.study_table([resealed(record.folder)]), spec=MLP).diverged == 1


def test_known_effects_are_found(records: list[RunRecord]) -> None:
    found = report.comparisons(records, [(MLP, WASHOUT)])
    step = np.arange(1, 6)
    truth = synthetic.level(MLP, step).mean() / synthetic.level(WASHOUT, step).mean()
    for rate in "pqr":
        first = row(found, horizon=40, output=f"body_rates.{rate}", phase="first 5 steps")
        assert first.low < truth < first.high
        assert first.verdict == "better"
    last = row(found, horizon=190, output=tables.POOLED, phase="last 20 steps")
    assert last.alike
    assert last.trainings == 3
    alone = row(found, horizon=190, output="body_rates.p", phase="first 5 steps")
    assert (alone.trainings, alone.verdict) == (1, "cannot tell")
    back = report.comparisons(records, [(WASHOUT, MLP)])
    assert back.ratio.to_numpy() == pytest.approx(1 / found.ratio.to_numpy())


def test_pairing_removes_the_spread_over_recordings(records: list[RunRecord]) -> None:
    """Recordings differ by 30 %, the models' ratio on them by 4 %: only a paired interval is this narrow."""
    found = report.comparisons(records, PAIRS)
    pooled = found[(found.horizon == 40) & (found.output == tables.POOLED)]
    assert (np.log(pooled.high / pooled.low) < 0.2).all()
    assert set(pooled.recordings) == {10}


def test_a_baseline_meets_every_seed(records: list[RunRecord]) -> None:
    found = row(
        report.comparisons(records, [(MLP, "linear")]), horizon=40, output="body_rates.q", phase="whole horizon"
    )
    assert (found.trainings, found.verdict) == (3, "better")
    beside = [s for s in report.sentences(records, PAIRS) if "beside the baseline `linear`" in s]
    assert len(beside) == 2
    assert MLP in beside[0]
    one = [r for r in records if (r.summary["seed"], r.summary["outputs"]) == (0, ["body_rates.q"])]
    said = " ".join(report.sentences(one, PAIRS))
    assert "times the error of `linear`, from one seed: run more with --seeds" in said


def test_three_axes_of_one_model_are_one_signal_and_not_three_trainings(tmp_path: Path) -> None:
    outputs = tuple(f"body_rates.{axis}" for axis in "pqr")
    records = [synthetic.record(tmp_path, s, outputs, 40, seed) for s in (MLP, WASHOUT) for seed in range(2)]
    assert list(dict.fromkeys(report.study_table(records).output)) == ["body_rates", *outputs]
    found = report.comparisons(records, [(MLP, WASHOUT)])
    assert tables.POOLED not in set(found.output)
    assert set(found.trainings) == {2}
    assert "body_rates: " in report.sentences(records, [(MLP, WASHOUT)])[0]


def test_a_horizon_too_short_for_two_ends_has_one_phase() -> None:
    assert list(tables.phases(5)) == ["whole horizon"]
    assert list(tables.phases(20)) == ["first 5 steps", "whole horizon"]
    assert list(tables.phases(40)) == ["first 5 steps", "whole horizon", "last 20 steps"]


def test_the_terminal_shows_everything_in_100_columns(records: list[RunRecord]) -> None:
    out = Console(file=io.StringIO(), width=100)
    report.render_terminal(records, PAIRS, out)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    assert max(map(len, text.splitlines())) <= 100
    assert "…" not in text  # nothing cut off
    assert "[deg/s]" in text and "2 of 3" in text and "better; sees" in text
    for spec in tables.specs(records):
        assert sum(f" {spec} " in line for line in text.splitlines() if line.startswith("│")) == 6


def test_on_a_narrow_terminal_names_give_way_and_numbers_stay(records: list[RunRecord]) -> None:
    out = Console(file=io.StringIO(), width=64)
    report.render_terminal(records, PAIRS, out)
    text = out.file.getvalue().partition("RMSSE: ")[0]  # type: ignore[attr-defined]
    assert max(map(len, text.splitlines())) <= 64 and "…" not in text
    for row in report.study_table(records).itertuples():
        assert report.number(row.first) in text and report.with_interval(row) in text


def test_the_page_has_every_row_and_its_sentences(records: list[RunRecord]) -> None:
    page = report.to_markdown(records, PAIRS, "a study", "bench run x", figure="steps.png")
    assert page.startswith("# A study\n") and "`bench run x`" in page and "](steps.png)" in page
    grids = [line for line in page.splitlines() if line.startswith("| ")]
    assert sum("deg/s" in line for line in grids) == 36
    widths = {line.count(" | ") for line in grids if "deg/s" in line}
    assert widths == {7}
    assert all(f"- {s}" in page for s in report.sentences(records, PAIRS))
    assert "nan" not in page.lower()


def drawn(monkeypatch: pytest.MonkeyPatch, draw: object, *arguments: object) -> Figure:
    kept: list[Figure] = []
    save = figures._save
    monkeypatch.setattr(figures, "_save", lambda figure, path: (kept.append(figure), save(figure, path))[1])
    files = draw(*arguments)  # type: ignore[operator]
    assert [f.suffix for f in files] == [".png", ".svg"] and all(f.stat().st_size > 5000 for f in files)
    return kept[0]


def test_the_figure_draws_the_mean_over_seeds(
    records: list[RunRecord], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = drawn(monkeypatch, figures.per_step_figure, records, tmp_path / "steps.png")
    assert len(figure.axes) == 2 * 3
    axes = figure.axes[1]
    assert axes.get_title() == "body rates q, T = 40" and figure.axes[0].get_ylabel() == "mean |error| [deg/s]"
    runs = [r for r in records if (r.summary["horizon"], r.summary["outputs"]) == (40, ["body_rates.q"])]
    for line, spec in zip([x for x in axes.get_lines() if len(x.get_xdata())], tables.specs(records), strict=True):
        mean = np.mean([r.error("body_rates.q", "axis") for r in runs if r.summary["spec"] == spec], axis=0)
        assert np.asarray(line.get_ydata()) == pytest.approx(mean)
        if spec != "constant":
            assert np.asarray(line.get_xdata())[-1] == pytest.approx(0.4)
    looks = {(to_hex(x.get_color()), str(x._unscaled_dash_pattern)) for x in axes.get_lines()[:4]}  # type: ignore[attr-defined]
    assert len({c for c, _ in looks}) == len({d for _, d in looks}) == 4
    networks = max(np.max(x.get_ydata()) for x in axes.get_lines()[:4])
    assert networks < axes.get_ylim()[1] < 1.3 * networks
    legend = figure.legends[0]
    labels = [t.get_text() for t in legend.get_texts()]
    assert "constant (leaves the axis)" in labels and f"{WASHOUT} (1 diverged)" in labels
    box = legend.get_window_extent()
    assert not any(box.overlaps(a.get_tightbbox()) for a in figure.axes)


def test_a_figure_repeats_byte_for_byte(records: list[RunRecord], tmp_path: Path) -> None:
    few = [r for r in records if r.summary["horizon"] == 190]
    one, two = (figures.per_step_figure(few, tmp_path / name) for name in ("one.png", "two.png"))
    assert [f.read_bytes() for f in one] == [f.read_bytes() for f in two]


@pytest.mark.parametrize(("horizon", "boxes"), [(40, 40), (190, 38), (5, 5)])
def test_boxes_stand_where_their_steps_are(
    horizon: int, boxes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = synthetic.record(tmp_path, MLP, ("body_rates.p",), horizon, 0)
    (axes,) = drawn(monkeypatch, figures.box_figure, record, tmp_path / "box.png").axes
    assert len(axes.patches) == boxes
    upper = record.error("body_rates.p", "axis", "q75")
    last = axes.patches[-1].get_path().get_extents()
    assert last.y1 == pytest.approx(upper.iloc[-1])
    assert (last.x0 + last.x1) / 2 == pytest.approx(horizon / synthetic.RATE)
