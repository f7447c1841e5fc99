import sys
from dataclasses import dataclass, fields
from pathlib import Path

import pytest

from registry.contracts import Problem
from registry.core import PREDICTORS, REGISTRIES, Registry, check_options, option
from registry.errors import BenchError

PLUGIN = '''
"""A predictor from another package."""
from dataclasses import dataclass
from registry.core import PREDICTORS
from registry.predictors.baselines.constant import Constant

@PREDICTORS.register("{name}")
@dataclass(frozen=True)
class Foreign(Constant):
    """A predictor from another package."""
'''


def install(folder: Path, name: str) -> None:
    """What pip leaves behind of a distribution with one module and one entry point."""
    (folder / "foreign_bench.py").write_text(PLUGIN.format(name=name))
    info = folder / "foreign_bench-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-bench\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[multistep_bench.predictors]\nforeign = foreign_bench\n")


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """The predictors as a new process would find them: entry points not yet looked at."""
    PREDICTORS.names()
    monkeypatch.setattr(PREDICTORS, "_entries", dict(PREDICTORS._entries))
    monkeypatch.setattr(PREDICTORS, "_loaded", False)
    monkeypatch.delitem(sys.modules, "foreign_bench", raising=False)
    return PREDICTORS


def test_an_entry_point_adds_a_predictor(fresh: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "foreign")
    monkeypatch.syspath_prepend(tmp_path)
    assert "foreign" in fresh.names()
    assert fresh.get("Foreign")().build(Problem.plain(1, 2, 3, 10)).n_outputs == 2


def test_a_name_that_is_taken_is_an_error(fresh: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "LSTM")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BenchError, match=r"'LSTM' is taken by registry\.predictors\.lstm\.LSTM"):
        fresh.names()


def test_a_plug_in_that_does_not_import_is_named(
    fresh: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "foreign")
    (tmp_path / "foreign_bench.py").write_text("import a_package_that_is_not_there")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BenchError, match=r"'foreign' .*fails to import"):
        fresh.names()


def test_every_entry_explains_itself() -> None:
    """`bench show` has something to show: one summary line, and help for every option."""
    for kind, registry in REGISTRIES.items():
        for name in registry.names():
            entry = registry.get(name)
            assert 10 < len(registry.summary(name)) <= 130, (kind, name)
            for f in fields(entry):
                assert f.metadata.get("help"), (kind, name, f.name)


def test_options_are_checked_for_type_and_range() -> None:
    @dataclass(frozen=True)
    class Entry:
        size: int = option(5, "size", unit="m", low=1, high=9)
        rate: float = option(0.5, "rate", low=0.0)
        kind: str = option("a", "kind", choices=("a", "b"))

    check_options(Entry(9, 1, "b"), "entry")
    for wrong, says in (
        (Entry(size=10), r"entry\.size = 10 must be from 1 to 9 m\."),
        (Entry(size=2.5), "type int"),  # type: ignore[arg-type]
        (Entry(size=True), "type int"),
        (Entry(rate=float("nan")), "finite"),
        (Entry(rate=float("inf")), "finite"),
        (Entry(rate=-1.0), "at least 0"),
        (Entry(kind="c"), "choose one of a, b"),
    ):
        with pytest.raises(BenchError, match=says):
            check_options(wrong, "entry")
