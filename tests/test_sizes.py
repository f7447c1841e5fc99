"""What the project asks of its own modules: how long they are, how many share a room, how a call reads."""

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MODULE, FUNCTION = 400, 60
"""Lines, at most."""
ARGUMENTS = 6
"""By position in one call, at most: from the seventh on nobody knows which is which."""
ROOM = 14
"""Modules directly in one folder, at most, `__init__.py` not counted."""


@pytest.fixture(scope="module")
def sources() -> dict[str, str]:
    """The text of every module by its path."""
    paths = (p for room in ("bench", "registry", "studies") for p in (ROOT / room).rglob("*.py"))
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in paths}


parsed = cache(ast.parse)


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Every function and method, those in functions too."""
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def long_functions(sources: dict[str, str]) -> set[str]:
    """Those of more than `FUNCTION` lines, decorators not counted, as path:name."""
    return {
        f"{path}:{f.name}"
        for path, text in sources.items()
        for f in functions(parsed(text))
        if (f.end_lineno or 0) - f.lineno + 1 > FUNCTION
    }


def many_arguments(sources: dict[str, str]) -> list[str]:
    """Calls of the project's own functions with more than `ARGUMENTS` by position, as path:line.

    Told by name; one that takes any number of equal things (``*names``) may be given them.
    """
    trees = {path: parsed(text) for path, text in sources.items()}
    own = {node.name for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    own |= {f.name for tree in trees.values() for f in functions(tree)}
    own -= {f.name for tree in trees.values() for f in functions(tree) if f.args.vararg}
    found = []
    for path, tree in trees.items():
        for call in ast.walk(tree):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name | ast.Attribute):
                name = call.func.id if isinstance(call.func, ast.Name) else call.func.attr
                given = sum(not isinstance(a, ast.Starred) for a in call.args)
                if name in own and given > ARGUMENTS:
                    found.append(f"{path}:{call.lineno}")
    return found


def full_rooms(paths: list[str]) -> dict[str, int]:
    """Folder → modules directly in it, where these are more than `ROOM`."""
    count = Counter(p.rpartition("/")[0] for p in paths if not p.endswith("/__init__.py"))
    return {room: n for room, n in count.items() if n > ROOM}


def test_no_module_is_long(sources: dict[str, str]) -> None:
    assert len(sources) > 300
    assert [path for path, text in sources.items() if text.count("\n") > MODULE] == []


def test_no_function_is_long(sources: dict[str, str]) -> None:
    assert sorted(long_functions(sources)) == []


def test_calls_of_many_arguments_say_which_is_which(sources: dict[str, str]) -> None:
    assert many_arguments(sources) == []


def test_no_room_is_full(sources: dict[str, str]) -> None:
    assert full_rooms(list(sources)) == {}


def test_what_is_too_long_is_seen() -> None:
    body = "    x = 1\n" * FUNCTION
    toy = {"a/b.py": f"def long():\n{body}", "a/c.py": f"def short():\n{body[10:]}"}
    assert long_functions(toy) == {"a/b.py:long"}
    calls = {"a/b.py": "def f(*x): ...\ndef g(a): ...\nf(1, 2, 3, 4, 5, 6, 7)\ng(1, 2, 3, 4, 5, 6, 7)\n"}
    assert many_arguments(calls) == ["a/b.py:4"]
    assert many_arguments({"a/b.py": "def g(a): ...\ng(1, 2, 3, 4, 5, 6, *x)\nprint(1, 2, 3, 4, 5, 6, 7)\n"}) == []
    assert full_rooms([f"a/{i}.py" for i in range(ROOM)] + ["a/__init__.py", "a/b/c.py"]) == {}
    assert full_rooms([f"a/{i}.py" for i in range(ROOM + 1)]) == {"a": ROOM + 1}
