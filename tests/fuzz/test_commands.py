"""Anything as an argument, option or environment variable of a command: it answers, or says in one line why not."""

import os
from importlib.util import find_spec
from pathlib import Path
from unittest import mock

import pytest
from faults.test_foreign_code import spring
from faults.test_kills import study
from fuzz.inputs import WORDS, answers, cases, one_sentence
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.execution import engine
from bench.reporting import study_outputs
from registry.errors import BenchError

LINES = [w for w in WORDS if "\x00" not in w]
VALUE = st.one_of(
    st.sampled_from(LINES),
    st.text(st.characters(exclude_characters="\x00", exclude_categories=("Cs",)), max_size=12),
    st.integers(-(10**25), 10**25).map(str),
    st.floats().map(repr),
)
COMMANDS = (
    "list {}",
    "show {}",
    "data check {}",
    "data inspect {}",
    "data inspect {DATA} --set {}={}",
    "data init {DATA} --system {}",
    "data import {} -o new",
    "data import {DATA}/r0.csv -o new --rate {}",
    "runs list --results {}",
    "runs list --results {RESULTS} --dataset {}",
    "runs show {} --results {RESULTS}",
    "runs diff {} {} --results {RESULTS}",
    "runs errors --study {} --results {RESULTS}",
    "runs errors {KEY} --at {} --results {RESULTS}",
    "report {} --results {RESULTS}",
    "report {} --dataset {} --results {RESULTS} -o {}",
    "export {} -o {} --results {RESULTS}",
    "import {} --results {RESULTS}",
    "predict {} --input {} --results {RESULTS}",
    "predict {KEY} --input {DATA}/r0.csv -o {} --results {RESULTS}",
    "check --claim {}",
    "run {} --dry-run",
    "run constant --dry-run --dataset {}",
    "run constant --dry-run --dataset {DATA} --outputs {}",
    "run constant --dry-run --dataset {DATA} --outputs speed -T {}",
    "run constant --dry-run --dataset {DATA} --outputs speed --set {}={}",
    "run constant --dry-run --dataset {DATA} --outputs speed --set training.updates={}",
    "run constant --dry-run --dataset {DATA} --outputs speed --physics {}",
    "run constant --dataset {DATA} --outputs speed --cluster {} --dry-run",
    "sweep {} --dry-run",
    "sweep constant --dataset {DATA} --outputs speed --search {}={} --dry-run",
    "sweep constant --dataset {DATA} --outputs speed --seed {} --trials {} --dry-run",
    "compare {}",
    "compare {DATA} --system {}",
    "compare {DATA} --model {}",
    "compare {DATA} --horizon {} --json {}",
    "discover {DATA} --catalogue {} --without {}",
    "extend {DATA} --add {}",
    "design {DATA} --between {} --limit {} --seconds {}",
    "locate {DATA} --set {}={} --model {}",
    "diagnose {DATA} --vehicle {} --without {}",
    "diagnose {DATA} --ignore-problem {} --exclude {}",
    "diagnose {DATA} --exclude {} --workers {}",
    "design {DATA} --model {} --system {}",
    "extend {DATA} --add {} --model {}",
    "data check {DATA} --system {}",
    "data import {DATA}/r0.csv -o new --vehicle {}",
    "export-model {} --to numpy --rate {}",
    "export-model {} --to onnx --out {} --results {RESULTS}",
    "check --claims {} --published {}",
    "check --results {} --json {}",
    "settle --budget {}",
    "ui --results {} --port {}",
    "sync --results {}",
    "sync --results {RESULTS} --tracking {}",
    "run constant --dataset {DATA} --outputs {} --tracking {} --dry-run",
    "sweep constant --dataset {DATA} --outputs speed --name {} --objective {} --dry-run",
    "score-discovery --case {} --fraction {}",
    "speed --quick --only {} --json {}/{}",
    *(() if find_spec("distributed") else ("cluster start --port {}",)),  # which serves where it can
    "{}",
)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A folder of data and one of results, and where the commands are typed."""
    here = tmp_path_factory.mktemp("commands")
    (here / "data").mkdir()
    spring(here / "data")
    runs = here / "results" / "runs"
    records = engine.execute(engine.plan(study(1), runs), runs)
    study_outputs.write_outputs(
        Console(quiet=True), records, "s", None, "bench run s", here / "results" / "studies" / "s"
    )
    return {"DATA": str(here / "data"), "RESULTS": str(here / "results"), "KEY": records[0].key[:8], "HERE": str(here)}


@cases(150)
@given(command=st.sampled_from(COMMANDS), values=st.lists(VALUE, min_size=3, max_size=3))
def test_anything_on_the_command_line(
    place: dict[str, str], command: str, values: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place["HERE"])
    given_ones = iter(values)
    words = [_filled(word, place, given_ones) for word in command.split()]
    one_sentence(lambda: answers(words))
    assert not (Path(place["HERE"]) / "diagnosis").exists()


def _filled(word: str, place: dict[str, str], values: "object") -> str:
    for name, value in place.items():
        word = word.replace("{" + name + "}", value)
    while "{}" in word:
        before, after = word.split("{}", 1)
        word = before + next(values).replace("{}", "") + after  # type: ignore[call-overload]
    return word


@cases(40)
@given(
    name=st.sampled_from(["XDG_CACHE_HOME", "BENCH_DATA", "BENCH_KERNEL", "BENCH_DEVICE", "CXX", "COLUMNS", "HOME"]),
    value=st.one_of(st.sampled_from([w for w in LINES if w.isascii()]), st.just("x" * 100_000), st.just(" ")),
    command=st.sampled_from(["data inspect nanodrone", "runs list --results {RESULTS}", "list", "data check {DATA}"]),
)
def test_anything_in_the_environment(place: dict[str, str], name: str, value: str, command: str) -> None:
    with mock.patch.dict(os.environ, {"BENCH_DATA": "", name: value}):
        one_sentence(lambda: answers([_filled(w, place, iter(())) for w in command.split()]))


NAMED = [("data", "inspect"), ("compare",), ("diagnose",), ("runs", "show"), ("runs", "errors", "--study"), ("import",)]


@pytest.mark.parametrize("words", [*NAMED, ("compare", ".", "--system"), ("predict", "--input", "x", "--results", ".")])
def test_a_name_that_no_path_can_have(words: tuple[str, ...]) -> None:
    with pytest.raises(BenchError, match=r"There is no|does not exist|cannot be read"):
        answers([*words, "[" * 3000 + (".py:C" if "--system" in words else "")])
