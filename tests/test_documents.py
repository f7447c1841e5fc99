"""What the documents say is true."""

import re
from pathlib import Path

import pytest
import torch

from registry.core import PREDICTORS

ROOT = Path(__file__).parent.parent


def test_the_predictor_of_the_contributing_guide_works(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = [
        c for c in re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S) if "drift" in c
    ]
    body = [line for line in code.split("class DriftPredictor")[1].splitlines() if line.strip()]
    assert len(body) <= 32  # two classes, about twenty lines of substance
    monkeypatch.setattr(PREDICTORS, "_entries", dict(PREDICTORS._entries))
    exec(compile(code, "drift.py", "exec"), {"__name__": "drift"})
    predictor = PREDICTORS.get("drift")(fade=0.5).build(1, 1, 3, 10)
    state = predictor.fill(torch.zeros(1, 10, 1), torch.arange(10.0).reshape(1, 10, 1))
    assert predictor(torch.zeros(1, 3, 1), state).flatten().tolist() == [9.5, 9.75, 9.875]


def test_ci_runs_the_test_command_of_the_readme() -> None:
    command = re.search(r"^\((python3 -m venv .*)\) 2>&1", (ROOT / ".ci/run").read_text(), re.M)
    assert command and command[1] in (ROOT / "README.md").read_text()


def test_commands_of_the_readme_exist() -> None:
    from bench.cli import cli

    context = cli.make_context("bench", [], resilient_parsing=True)
    for line in re.findall(r"^(?:\.venv/bin/)?bench (.+)$", (ROOT / "README.md").read_text(), re.M):
        name = line.split()[0]
        assert cli.get_command(context, name) is not None, line
