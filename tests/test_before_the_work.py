"""What would end a command after its work, or never, ends it before: outputs, empty names, caches, compilers."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Typed

from bench.tracking.server import connected
from registry.cache import cache_folder
from registry.errors import BenchError
from registry.kernels.native import library

OUTPUTS = [
    ("speed", "--json"),
    ("check", "--json"),
    ("check", "--markdown"),
    ("report", "washout_vs_mlp", "-o"),
    ("export", "washout_vs_mlp", "-o"),
    ("predict", "abc", "--input", "x.csv", "-o"),
    ("compare", "pelican_twin", "--json"),
    ("locate", "pelican_twin", "--json"),
    ("discover", "pelican_twin", "--json"),
    ("extend", "pelican_twin", "--add", "rotor_drag", "--json"),
    ("diagnose", "pelican_twin", "--json"),
    ("design", "pelican_twin", "-o"),
]


@pytest.fixture
def bench(typed: Typed) -> Callable[..., str]:
    """The command in this process; what it says where it ends with exit code 2."""

    def run(*arguments: str | Path) -> str:
        code, _, said = typed(*arguments)
        assert code == 2 and len(said.splitlines()) <= 2, said
        return said

    return run


@pytest.mark.parametrize("command", OUTPUTS, ids=" ".join)
def test_an_output_is_looked_at_before_the_work(
    command: tuple[str, ...], bench: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for target, says in (
        ("file/x", "file is no folder"),
        (".", "a folder, where a file is needed"),
        ("pipe", "a pipe, a socket or a device"),
        ("", "it names no file"),
        (300 * "x", "so long a name"),
    ):
        assert says in bench(*command, target), target
    if command[0] in ("speed", "check", "report", "export", "predict"):
        assert "nowhere is no folder" in bench(*command, "nowhere/x")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "pipe"]


@pytest.mark.parametrize(
    "command",
    [("run", "constant", "--dataset", ""), ("diagnose", " "), ("sweep", "LSTM: 1x8 - MLP: 8x10", "--dataset", "")],
)
def test_an_empty_name_is_no_default(command: tuple[str, ...], bench: Callable[..., str]) -> None:
    assert "it is empty" in bench(*command)


def test_a_relative_cache_is_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for named in ("~", "~/.cache", "cache", "", "."):
        monkeypatch.setenv("XDG_CACHE_HOME", named)
        assert cache_folder() == tmp_path / ".cache" / "multistep-bench"
    monkeypatch.setenv("XDG_CACHE_HOME", "/elsewhere")
    assert cache_folder() == Path("/elsewhere/multistep-bench")


@pytest.mark.parametrize("compiler", ["", "   ", "cat"])
def test_a_compiler_that_is_blank_or_waits_for_input(compiler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", compiler)
    if compiler == "cat":
        with pytest.raises(library._Unavailable, match="cat does not compile"):
            library._load("native")
    else:
        assert Path(library._compiler()[0]).name in ("g++", "clang++", "c++")


@pytest.mark.parametrize("uri", ["postgresql://u@h/d", "mysql+pymysql://u@h/d", "nonsense://x", "sqlite+x:///y"])
def test_an_address_without_its_driver(uri: str) -> None:
    with pytest.raises(BenchError) as error, connected(uri) as client:
        client.search_experiments(max_results=1)
    assert "\n" not in str(error.value)
