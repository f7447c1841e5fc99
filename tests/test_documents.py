"""What the documents say is true."""

import re
import sys
import types
from pathlib import Path
from typing import Any

import pytest
import torch
from diagnose.undriven import undriven

from registry.contracts import Problem
from registry.core import DATASETS, EFFECTS, PREDICTORS

ROOT = Path(__file__).parent.parent


def test_the_predictor_of_the_contributing_guide_works(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = [
        c for c in re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S) if "drift" in c
    ]
    body = [line for line in code.split("class DriftPredictor")[1].splitlines() if line.strip()]
    assert len(body) <= 32  # two classes, about twenty lines of substance
    PREDICTORS.names()
    monkeypatch.setattr(PREDICTORS, "_entries", dict(PREDICTORS._entries))
    exec(compile(code, "drift.py", "exec"), {"__name__": "drift"})
    predictor = PREDICTORS.get("drift")(fade=0.5).build(Problem.plain(1, 1, 3, 10))
    state = predictor.fill(torch.zeros(1, 10, 1), torch.arange(10.0).reshape(1, 10, 1))
    assert predictor(torch.zeros(1, 3, 1), state).flatten().tolist() == [9.5, 9.75, 9.875]


def test_the_study_of_the_contributing_guide_is_one() -> None:
    (code,) = [
        c for c in re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S) if "Study(" in c
    ]
    found: dict[str, Any] = {}
    exec(compile(code, "gru_vs_lstm.py", "exec"), found)
    made = found["STUDY"].runs("laptop", DATASETS.get("helicopter_twin")())
    assert [(r.spec, r.seed) for r in made] == [
        *(("GRU: 1x50 - MLP: 60x10", s) for s in range(3)),
        *(("LSTM: 1x50 - MLP: 60x10", s) for s in range(3)),
        ("linear", 0),
    ]


def test_ci_runs_the_test_command_of_the_readme() -> None:
    command = re.search(r"^\((python3 -m venv .*)\) 2>&1", (ROOT / ".ci/run").read_text(), re.M)
    assert command and command[1] in (ROOT / "README.md").read_text()


def test_commands_of_the_readme_exist() -> None:
    from bench.cli import cli

    context = cli.make_context("bench", [], resilient_parsing=True)
    for line in re.findall(r"^(?:\.venv/bin/)?bench (.+)$", (ROOT / "README.md").read_text(), re.M):
        name = line.split()[0]
        assert cli.get_command(context, name) is not None, line


def test_the_effect_of_the_contributing_guide_conforms(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    effect, proof = (c for c in re.findall(r"```python\n(.*?)```", text, re.S) if "Tether" in c)
    assert len([line for line in effect.split("@EFFECTS")[1].splitlines() if line.strip()]) <= 20
    EFFECTS.names()  # loads them: what is restored afterwards is all of them
    monkeypatch.setattr(EFFECTS, "_entries", dict(EFFECTS._entries))
    module = types.ModuleType("tether")
    monkeypatch.setitem(sys.modules, "tether", module)
    exec(compile(effect + proof, "tether.py", "exec"), module.__dict__)
    conformance = module.TestTether()
    for name in dir(conformance):
        if name.startswith("test_"):
            getattr(conformance, name)()


def test_the_five_lines_of_the_readme_run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert len(code.split("\n\n")) <= 2 and len([line for line in code.splitlines() if line]) == 5
    starts = [[1.5, 0.0], [0.4, 1.0], [-1.0, 0.5]]
    damped = undriven("pendulum", [EFFECTS.get("viscous_friction")(0.1)], starts, 0.02, 500, 1e-3)
    monkeypatch.setattr("bench.diagnose.load", lambda source: damped)
    exec(compile(code, "README.md", "exec"), {})
    assert "viscous_friction" in capsys.readouterr().out
