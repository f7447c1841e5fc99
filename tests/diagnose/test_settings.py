"""Thresholds: every one is documented, and used."""

import ast
from functools import cache
from pathlib import Path

import pytest

from bench.diagnose import settings
from bench.diagnose.settings import documented
from bench.diagnose.settings.threshold import Basis

SOURCES = Path(settings.__file__).parent.parent


@cache
def read() -> frozenset[tuple[str, str]]:
    """Every ``name.attribute`` in the modules of the diagnosis."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES.rglob("*.py"))
    return frozenset(
        (getattr(node.value, "id", ""), node.attr)
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
    )


def used(instance: str, name: str) -> bool:
    """Whether a module of the diagnosis reads ``instance.name``."""
    return (instance, name) in read()


@pytest.mark.parametrize(("owner", "threshold"), documented(), ids=lambda x: getattr(x, "name", x))
def test_every_threshold_is_documented_and_used(owner: str, threshold: settings.Field) -> None:
    said = threshold.metadata
    assert len(said["meaning"]) > 20 and said["unit"] and said["basis"] in Basis
    assert used(owner.upper(), threshold.name), f"{owner}.{threshold.name} bounds nothing: take it out"


def test_a_threshold_that_nothing_reads_is_seen() -> None:
    assert used("LOCATING", "regions") and not used("LOCATING", "towns") and not used("COMPARING", "regions")


def test_no_class_of_thresholds_is_left_out() -> None:
    files = Path(settings.__file__).parent.glob("*.py")
    classes = {
        node.name
        for file in files
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef) and any(isinstance(d, ast.Call) for d in node.decorator_list)
    }
    assert classes == {owner for owner, _ in documented()}
