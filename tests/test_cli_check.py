"""`bench check`: what it prints, and exit code 1 when a published number no longer holds."""

import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_study
from conftest import Typed
from scipy.special import stdtrit
from synthetic_evidence import concluded
from test_native import kernel

from bench.claims import published as regression

Bench = Callable[..., tuple[int, str]]
WHERE = Path("washout_vs_mlp/helicopter_twin/study.json")


@pytest.fixture
def bench(typed: Typed) -> Bench:
    """`bench check`: exit code and everything printed."""

    def run(*arguments: Any) -> tuple[int, str]:
        code, out, error = typed("check", *arguments)
        return code, out + error

    return run


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with one study, run here and published."""
    root = tmp_path_factory.mktemp("results")
    records = synthetic_study.study(root / "draft", {40: 3}, axes="pq")
    concluded(records, "bench run washout_vs_mlp", root / "studies" / "x")
    shutil.copytree(root / "studies" / "x", root / "published" / WHERE.parent)
    return root


@pytest.fixture
def results(made: Path, tmp_path: Path) -> Path:
    """A copy of it to spoil."""
    for name in ("studies", "published"):
        shutil.copytree(made / name, tmp_path / name)
    return tmp_path


def edit(file: Path, change: Callable[[dict[str, Any]], None]) -> None:
    content = json.loads(file.read_text())
    for run in content["runs"]:
        change(run)
    file.write_text(json.dumps(content))


def scale(factor: float, seed: int | None = None, rekeyed: str = "") -> Callable[[dict[str, Any]], None]:
    """RMSSE of one configuration times a factor; as a run of another key."""

    def change(run: dict[str, Any]) -> None:
        run["key"] = rekeyed + run["key"][len(rekeyed) :]
        if run["spec"] == synthetic_study.MLP and run["seed"] in (seed, run["seed"] if seed is None else seed):
            run["metrics"] = {k: factor * v for k, v in run["metrics"].items()}

    return change


def test_every_claim_has_a_verdict_and_every_number_holds(bench: Bench, results: Path) -> None:
    target = results / "verdicts.json"
    code, printed = bench("--results", results, "--published", results / "published", "--json", target)
    assert code == 0, printed
    assert max(map(len, printed.splitlines())) <= 100
    verdicts = {r["id"]: r for r in json.loads(target.read_text())["claims"]}
    assert len(verdicts) >= 40
    at_once = verdicts["lstm-at-once"]
    assert (at_once["verdict"], at_once["dataset"], at_once["label"]) == ("reproduced", "twin", "laptop")
    assert at_once["here"] == pytest.approx(0.55, abs=0.05) and at_once["interval"][1] < 1
    assert verdicts["hybrid-velocity-99"]["verdict"] == "not run" and "needs pelican" in printed
    assert verdicts["early-peak"]["command"] == "bench run helicopter_black_box"
    assert "published numbers that were made again hold" in printed


def test_one_claim_is_explained(bench: Bench, results: Path) -> None:
    code, printed = bench("--claim", "lstm-at-once", "--results", results, "--published", results / "published")
    said = " ".join(printed.split())
    assert code == 0
    assert "figure HeliCompare" in said and "t-interval over 10 recordings; 12 trained networks in 4 groups" in said
    assert "mlfc" not in said


def test_a_tampered_number_of_the_same_run_is_found(bench: Bench, results: Path) -> None:
    edit(results / "published" / WHERE, scale(1 + 1e-9, seed=1))
    code, printed = bench("--results", results, "--published", results / "published")
    assert code == 1
    assert printed.count("no longer holds") == 2  # two axes
    assert "seed 1" in printed and "must be equal" in printed


@pytest.mark.parametrize(("factor", "expected"), [(1.005, 0), (1.03, 0), (1.5, 1)])
def test_other_runs_may_differ_as_seeds_do(bench: Bench, results: Path, factor: float, expected: int) -> None:
    """Seeds spread by 3 %, each on every recording by as much again."""
    edit(results / "published" / WHERE, scale(factor, rekeyed="0000"))
    code, printed = bench("--results", results, "--published", results / "published")
    assert code == expected, printed
    assert ("mean of 3 and 3 seeds" in printed) == bool(expected)


def test_without_evidence_nothing_is_claimed(bench: Bench, tmp_path: Path) -> None:
    code, printed = bench("--results", tmp_path, "--published", tmp_path / "none")
    assert code == 0
    assert (
        "0 reproduced, 0 differs, 0 alike, 0 not enough evidence" in printed
        and "None of the published numbers" in printed
    )
    assert "bench run washout_vs_mlp" in printed


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--claim", "lstm-at-onse"), "did you mean lstm-at-once"),
        (("--claims", "nowhere.toml"), "name a file of claims"),
        (("--write",), "belongs to --rerun"),
        (("--rerun", "smoke", "--published", "."), "bench check --rerun smoke --write"),
        (("--json", "file/below", "--published", "."), "cannot be written"),
    ],
)
def test_a_mistake_is_one_sentence(
    arguments: tuple[str, ...], says: str, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(regression, "rerun", list)
    code, printed = bench(*arguments)
    assert code == 2
    assert says in " ".join(printed.split())


def total(factor: float, seeds: tuple[int, ...] = (0, 1, 2)) -> Callable[[dict[str, Any]], None]:
    """The error of all axes times a factor, of some seeds."""

    def change(run: dict[str, Any]) -> None:
        if run["seed"] in seeds:
            run["metrics"]["rmsse.euler_rates"] *= factor

    return change


TOY = (("toy", "euler_rates", "MLFC: 1x4 - MLP: 4x10"), ("toy", "euler_rates", "LSTM: 1x4 - MLP: 4x10"))


def test_a_small_set_is_trained_again(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regression, "RERUN", TOY)
    arguments = ("--rerun", "smoke", "--published", tmp_path)
    assert bench(*arguments, "--write")[0] == 0
    assert bench(*arguments) == (0, "24 of 24 published numbers that were made again hold: 24 same.\n")
    with kernel("pytorch"):  # other keys, other last bits
        code, printed = bench(*arguments)
    assert code == 0 and "8 of 8 published numbers that were made again hold: 8 within spread." in printed
    trained = regression.rerun()
    monkeypatch.setattr(regression, "rerun", lambda: trained)
    file = tmp_path / regression.SMOKE
    edit(file, total(1.000001, seeds=(1,)))
    code, printed = bench(*arguments)
    assert code == 1 and "22 same, 2 moved" in printed and "seed 1, rmsse.euler_rates" in printed
    edit(file, lambda run: run.update(key="0" * 32))
    assert bench(*arguments)[0] == 0  # another processor
    edit(file, total(5.0))
    code, printed = bench(*arguments)
    assert code == 1 and "6 within spread, 2 moved" in printed and "% is allowed" in printed
    edit(file, lambda run: run["metrics"].update({"rmsse.euler_rates": None}))
    assert "2 moved" in bench(*arguments)[1]  # diverged there alone


def test_the_band_is_that_of_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve configurations whose seeds scatter by 2 %: a mean of three is known to some 2 % √(2/3) t."""
    rng, spec = np.random.default_rng(3), "LSTM: 1x{} - MLP: 4x10"
    monkeypatch.setattr(regression, "RERUN", [("toy", "euler_rates", spec.format(i)) for i in range(12)])

    def runs(key: str, factor: float) -> list[dict[str, Any]]:
        return [
            {"dataset": "toy", "spec": spec.format(i), "seed": seed, "key": key,
             "metrics": {"rmsse.euler_rates": factor * float(np.exp(0.02 * rng.normal()))}}
            for i in range(12) for seed in range(3)
        ]  # fmt: skip

    regression.write_smoke(tmp_path, runs("there", 1.0))
    close, far = (regression.check_smoke(tmp_path, runs("here", f)) for f in (1.0, 1.12))
    assert {h.how for h in close} == {"within spread"} and {h.how for h in far} == {"moved"}
    t = float(stdtrit(24, 1 - 0.05 / 24))
    assert close[0].band == pytest.approx(np.expm1(t * 0.02 * np.sqrt(2 / 3)), rel=0.35)


@pytest.mark.slow
def test_the_published_small_set_is_found_again(bench: Bench) -> None:
    assert bench("--rerun", "smoke")[0] == 0


OTHERS = {
    "pytorch": {"BENCH_KERNEL": "pytorch"},
    "older": {"BENCH_ARCH": "x86-64-v2", "ATEN_CPU_CAPABILITY": "default", "MKL_ENABLE_INSTRUCTIONS": "SSE4_2"},
    "avx2": {"BENCH_ARCH": "x86-64-v3", "ATEN_CPU_CAPABILITY": "avx2", "MKL_ENABLE_INSTRUCTIONS": "AVX2"},
    "other BLAS": {"OPENBLAS_CORETYPE": "Prescott"},
    "older numpy": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"},
}
"""What another processor or compiler would change, by environment."""
OTHER_TWINS = ("other BLAS", "older numpy")
"""What changes the last bits of simulated flights too."""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="these are instruction sets of x86")
@pytest.mark.parametrize("other", OTHERS)
def test_another_processor_is_compared_within_the_spread_of_seeds(other: str, tmp_path: Path) -> None:
    environment = os.environ | OTHERS[other] | ({"XDG_CACHE_HOME": str(tmp_path)} if other in OTHER_TWINS else {})
    command = [sys.executable, "-m", "bench", "check", "--rerun", "smoke"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "44 of 44 published numbers that were made again hold: 44 within spread." in done.stdout


def test_the_page_says_what_the_json_says(bench: Bench, results: Path) -> None:
    page, plain = results / "claims.md", results / "claims.json"
    where = ("--published", results / "published", "--results", results)
    assert bench("--markdown", page, "--json", plain, *where)[0] == 0
    claims = json.loads(plain.read_text())["claims"]
    rows = [r.split(" | ") for r in page.read_text().splitlines() if r.startswith("| ")][2:]
    assert [re.split("[,;]", r[4].replace("*", ""))[0] for r in rows] == [c["verdict"] for c in claims]
    texts = [r[0].removeprefix("| ").partition(" *")[0] for r in rows]
    assert [t for t in texts if t] == list(dict.fromkeys(c["text"] for c in claims))
