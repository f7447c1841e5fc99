"""A study's page: its numbers are the tables', what it draws is in the records, and names that are markup stay text."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
import synthetic_study as synthetic
from click.testing import CliRunner
from parsed_page import Parsed
from synthetic_records import resealed

from bench.analysis import tables
from bench.cli.commands.report import report_command
from bench.experiment.study import Study
from bench.records.record import RunRecord, write_json
from bench.reporting import report, study_page
from bench.reporting.drawing import Look, Panel, Scale
from bench.reporting.study_page_content import Content
from registry.errors import BenchError

HYBRID, LSTM, WASHOUT = "Hybrid: 1x50 - MLP: 60x10", "LSTM: 1x50 - MLP: 60x10", "LSTM: 2x50 - Washout: 10"
AXES = tuple(f"{group}.{axis}" for group, axes in (("velocity", "xyz"), ("body_rates", "pqr")) for axis in axes)
FORCED = tuple(f"velocity_forced.{axis}" for axis in "xyz")
STUDY = Study(
    name="hybrid",
    title="hybrid against black box",
    question="Is the hybrid better?",
    source="figure HybVsBB",
    default_dataset="twin",
    runs=lambda preset, dataset: [],
    pairs=((LSTM, WASHOUT),),
    contrasts=(("velocity", "velocity_forced"),),
    paper_says="The hybrid halves the error.\nLater the black box is better.",
)
TITLE, COMMAND = "hybrid on twin (laptop)", "bench run hybrid --preset laptop"


class Page(Parsed):
    """With the rows of tables as lists of cells."""

    def __init__(self, source: str) -> None:
        self.rows: list[list[str]] = []
        self.inside = False
        super().__init__(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        super().handle_starttag(tag, attrs)
        if tag == "tr":
            self.rows.append([])
        self.inside = self.inside or tag in ("td", "th")
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self.inside = self.inside and tag not in ("td", "th")

    def handle_data(self, data: str) -> None:
        super().handle_data(data)
        if self.inside:
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[RunRecord]:
    """A hybrid judged also with measured rates, two black boxes of which one run is lost, a baseline; two horizons."""
    runs = tmp_path_factory.mktemp("results") / "runs"
    sizes = {HYBRID: 30_000, LSTM: 20_000, WASHOUT: 40_000, "constant": 0}
    return [
        synthetic.record(
            runs,
            spec,
            AXES + (FORCED if spec == HYBRID else ()),
            horizon,
            seed,
            recordings=8,
            diverged=(spec, horizon, seed) == (WASHOUT, 40, 1),
            weights=weights,
        )
        for horizon in (40, 190)
        for spec, weights in sizes.items()
        for seed in range(2 if weights else 1)
    ]


@pytest.fixture(scope="module")
def source(records: list[RunRecord]) -> str:
    return study_page.render(records, TITLE, STUDY, COMMAND)


def test_numbers_of_the_page_are_those_of_the_tables(records: list[RunRecord], source: str) -> None:
    page = Page(source)
    table = report.study_table(records)
    cells = [[" ".join(c.split()) for c in row] for row in page.rows]
    for horizon in (40, 190):
        for one, two in (("velocity", "body_rates"), ("velocity.x", "velocity.y")):
            for spec in (HYBRID, LSTM, WASHOUT, "constant"):
                at = table[(table.horizon == horizon) & (table.spec == spec)]
                found = [next(at[at.output == q].itertuples()) for q in (one, two)]
                numbers = [[report.with_interval(r), report.number(r.first), report.number(r.last)] for r in found]
                seeds = report.sound_runs(found[0])
                assert [spec, f"{found[0].weights:,}".replace(",", " "), seeds, *numbers[0], *numbers[1]] in cells
    ratios = [r for grid in report.grids(records, STUDY.pairs, STUDY.contrasts) for _, row in grid.rows for r in row]
    assert len(ratios) == 2 * 3 * 9
    assert all(text in page.text for r in ratios for text in report.verdict_cell(r))
    assert all(" ".join(s.split()) in page.text for s in report.sentences(records, STUDY.pairs, STUDY.contrasts))
    assert not re.search(r"\b(nan|inf)\b", source, re.IGNORECASE)


def test_the_page_says_what_was_asked_what_was_lost_and_how_to_make_it_again(source: str) -> None:
    text = Page(source).text
    for said in (
        "Is the hybrid better?",
        "The hybrid halves the error.",
        "Later the black box is better.",
        "figure HybVsBB",
        "14 runs",
        "1 diverged",
        "1 of 14 runs diverged",
        "at update 100",
        "2 train; 8 test: flight0",
        "commit 0123456789ab",
        "torch 2.13.0",
        "machine x86_64",
        "0" * 64,
        "100 Hz",
        "T = 40 steps (0.4 s)",
        "velocity (forced)",
        COMMAND,
    ):
        assert said in text, said


def test_a_smoke_test_gives_no_verdict(tmp_path: Path) -> None:
    """Nor the same column twice where the horizon is as short as its first part."""
    short = [
        synthetic.record(tmp_path / "runs", spec, AXES, 5, seed, recordings=8, weights=100)
        for spec in (LSTM, WASHOUT)
        for seed in range(2)
    ]
    said = "smoke: tries the machinery; says nothing about the paper"
    for title, smoke in (("hybrid on twin (smoke)", True), (TITLE, False)):
        page = study_page.render(short, title, STUDY, COMMAND)
        body = page[page.index("<body") :]
        verdicts = sum(body.count(f'class="{tone}"') for tone in ("better", "worse"))
        assert (said in body) == smoke and (verdicts == 0) == smoke
        heads = [row for row in Page(page).rows if "RMSSE" in row and "first 5" not in row]
        assert heads and all(row == [*row[:3], *["RMSSE", "all 5"] * (len(row[3:]) // 2)] for row in heads)


def test_the_page_needs_nothing_from_outside_and_its_links_lead_somewhere(source: str) -> None:
    page = Page(source)
    assert not {"script", "link", "iframe", "object", "embed", "base", "img"} & set(page.tags)
    assert "http" not in source.replace("http-equiv", "") and "@import" not in source and "url(" not in source
    links = [v[1:] for n, v in page.attributes if n == "href"]
    assert len(links) == 10 and all(sum(n == "id" and v == link for n, v in page.attributes) == 1 for link in links)
    assert len(source) < 1e6


def test_every_axis_has_a_unit(source: str) -> None:
    names = re.findall(r'<text class="name"[^>]*>([^<]*)</text>', source)
    assert len(names) > 60 and all(re.search(r"\[[^\]]+\]$", n) for n in names), set(names)


def hostile(tmp_path: Path, evil: str) -> tuple[str, str]:
    """A page on which every name ends in this, and the name of its last predictor."""
    specs = (f"LSTM: 1x50 - MLP: 60x10{evil}", f"LSTM: 2x50 - Washout: 10{evil}", f"GRU: 1x50 - MLP: 60x10{evil}")
    made = []
    for i, spec in enumerate(specs):
        record = synthetic.record(tmp_path, spec, AXES, 5, 0, diverged=i == 2, weights=1000 * (i + 1))
        summary = dict(record.summary)
        summary |= {name: summary[name] + evil for name in ("dataset", "dataset_digest")}
        summary["inputs"], summary["recordings"] = [f"pilot{evil}"], {f"train{evil}": ["a"], "test": [f"b{evil}"]}
        summary["environment"] = {f"kernel{evil}": evil}
        write_json(record.folder / "record.json", summary)
        windows = record.windows.assign(recording=f"flight{evil}")
        windows.to_parquet(record.folder / "windows.parquet")
        made.append(resealed(record.folder))
    texts = {name: evil for name in ("name", "title", "question", "source", "paper_says")}
    study = dataclasses.replace(STUDY, **texts, pairs=(specs[:2],), contrasts=())  # type: ignore[arg-type]
    return study_page.render(made, f"title {evil}", study, f"bench run {evil}"), specs[2]


def test_markup_in_names_stays_text(tmp_path: Path) -> None:
    evil = '<script>alert(1)</script>" onmouseover="alert(2)'
    source, spec = hostile(tmp_path, evil)
    page = Page(source)
    assert "script" not in page.tags and not [n for n, _ in page.attributes if n.startswith("on")]
    for text in (f"title {evil}", f"bench run {evil}", f"b{evil}", f"flight{evil}, seed 0", spec, f"pilot{evil}"):
        assert " ".join(text.split()) in page.text, text


def test_a_contrast_finds_the_known_ratio_within_each_network(records: list[RunRecord]) -> None:
    found = tables.contrasts(records, STUDY.contrasts)
    assert set(found.spec) == {HYBRID} and len(found) == 2 * 3
    whole = found[(found.horizon == 40) & (found.phase == "whole horizon")].iloc[0]
    forced = [r for r in records if (r.summary["spec"], r.summary["horizon"]) == (HYBRID, 40)]
    by_hand = np.log(
        [tables.by_recording(r, "velocity").mean() / tables.by_recording(r, "velocity_forced").mean() for r in forced]
    )
    assert whole.ratio == pytest.approx(np.exp(by_hand.mean()))
    assert 4 < whole.low < 10 < whole.high < 25 and whole.verdict == "worse" and whole.trainings == 2
    back = tables.contrasts(records, [("velocity_forced", "velocity")])
    assert back.ratio.to_numpy() == pytest.approx(1 / found.ratio.to_numpy())
    text = report.to_markdown(records, STUDY.pairs, "t", "c", within=STUDY.contrasts)
    assert "### T = 40: error of velocity / error of velocity (forced)" in text and "| velocity.x (forced) |" in text
    assert any(
        s.startswith(f"T = 40: velocity against velocity (forced): {HYBRID} overall")
        for s in report.sentences(records, (), STUDY.contrasts)
    )


@pytest.mark.parametrize(
    ("quantity", "name"),
    [
        ("velocity_forced", "velocity (forced)"),
        ("body_rates_uncompensated.p", "body_rates.p (uncompensated)"),
        ("body_rates", "body_rates"),
        ("upper_level.h", "upper_level.h"),
        ("something_else.a", "something_else.a"),
    ],
)
def test_views_are_named_beside_their_signal(quantity: str, name: str) -> None:
    assert tables.named(quantity) == name


def test_the_worst_window_is_the_worst_and_its_worst_axis(records: list[RunRecord]) -> None:
    found = Content(records, TITLE, STUDY, COMMAND).worst_window(LSTM, "velocity", 40)
    assert found is not None  # errors grow with the axis, the seed and fastest in flight3
    assert (found.channel, found.seed, found.recording) == ("velocity.z", 1, "flight3")
    assert np.rad2deg(0.01 * 3 * 2 * np.arange(1, 41)) == pytest.approx(found.predicted - found.measured)


def test_what_is_drawn_stands_where_its_value_is() -> None:
    panel = Panel(Scale(0, 2), Scale(0, 50), "time [s]", "error [m]", width=300, height=200)
    panel.line([0, 1, 2], [0, 25, np.nan], Look("#000000"))
    left, top = panel.left, panel.top
    assert panel.marks[0].startswith(f'<path d="M0.0 {panel.high:.1f}L{panel.wide / 2:.1f} {panel.high / 2:.1f}"')
    svg = panel.svg("a < b")
    assert f'x="{left:.1f}" y="{top:.1f}" width="{panel.wide:.1f}"' in svg and 'aria-label="a &lt; b"' in svg
    ticks = [(float(x), t) for x, t in re.findall(r'<text class="tick" x="([\d.]+)"[^>]*middle">([^<]*)<', svg)]
    assert [x for x, _ in ticks] == pytest.approx([left + panel.wide * float(t) / 2 for _, t in ticks], abs=0.06)


@pytest.mark.parametrize("height", [0.1, 9.8])
def test_labels_of_points_never_cover_one_another(height: float) -> None:
    panel = Panel(Scale(1e3, 1e6, log=True), Scale(0, 10), "weights [count]", "RMSSE [m]", right=200, height=230)
    panel.points([(10.0 ** (3 + i / 4), height + 0.01 * i, 0, 1, "#000000", f"spec {i}") for i in range(11)])
    spots = sorted(float(y) for y in re.findall(r'class="label"[^>]* y="([-\d.]+)"', "".join(panel.outside)))
    assert min(np.diff(spots)) >= 13.9 and -panel.top < spots[0] and spots[-1] < panel.high + panel.bottom


def test_bench_report_finds_the_study_and_writes_its_page(
    records: list[RunRecord], source: str, tmp_path: Path
) -> None:
    results = records[0].folder.parents[1]
    titles = {"hybrid-on-twin-laptop": TITLE, "hybrid-on-twin-smoke": "hybrid on twin (smoke), horizon 5"}
    for slug, title in titles.items():
        folder = results / "studies" / slug
        folder.mkdir(parents=True)
        keys = [r.key for r in records] if "laptop" in slug else ["gone"]
        content = {"title": title, "study": None, "keys": keys, "command": COMMAND, "files": []}
        (folder / "study.json").write_text(json.dumps(content))

    def run(*arguments: str) -> str:
        made = CliRunner().invoke(report_command, [*arguments, "--results", str(results)])
        if made.exception:
            raise made.exception
        return made.output

    out = tmp_path / "page.html"
    run("hybrid", "--preset", "laptop", "--dataset", "twin", "-o", str(out))
    assert out.read_text(encoding="utf-8") == study_page.render(records, TITLE, None, COMMAND)
    assert run("hybrid-on-twin-laptop").strip() == str(results / "studies" / "hybrid-on-twin-laptop" / "report.html")
    for arguments, said in {
        ("hybrid",): "2 finished studies fit: give --dataset, --preset, or one of hybrid-on-twin-laptop; hybrid",
        ("hybrid", "--preset", "smoke"): f"make them again with `{COMMAND}`",
        ("hybrid", "--dataset", "twi"): "start it with `bench run hybrid`",
    }.items():
        with pytest.raises(BenchError, match=re.escape(said)):
            run(*arguments)
