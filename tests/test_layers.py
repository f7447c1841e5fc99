"""Data flow one way: no module and no room leads back to itself, wherever in a file an import stands."""

from graphlib import CycleError, TopologicalSorter

import pytest

grimp = pytest.importorskip("grimp", reason="comes with import-linter")

Graph = dict[str, set[str]]


@pytest.fixture(scope="module")
def modules() -> Graph:
    """Every module of the project and those of the project that it imports, also in functions and for types alone."""
    graph = grimp.build_graph("bench", "registry", "studies", cache_dir=None)
    return {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}


def circle(graph: Graph) -> list[str]:
    """One circle of imports, first and last the same; empty: there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def rooms(modules: Graph, package: str) -> Graph:
    """What is directly in a package and imports what else of it, rooms taken as a whole."""

    def room(name: str) -> str:
        return ".".join(name.split(".")[: package.count(".") + 2])

    inside = {name: found for name, found in modules.items() if name.startswith(f"{package}.")}
    graph: Graph = {}
    for name, found in inside.items():
        others = {room(other) for other in found if other in inside}
        graph.setdefault(room(name), set()).update(others - {room(name)})
    return graph


def test_no_module_imports_itself_by_way_of_others(modules: Graph) -> None:
    assert "bench.diagnose.discover" in modules and "registry.contracts.predictor" in modules
    assert circle(modules) == []


@pytest.mark.parametrize("package", ["bench", "bench.diagnose", "registry"])
def test_no_room_imports_itself_by_way_of_others(modules: Graph, package: str) -> None:
    graph = rooms(modules, package)
    assert len(graph) > 5
    assert circle(graph) == []


def test_a_circle_is_seen_between_modules_and_between_rooms() -> None:
    apart = {"a.x.one": {"a.y.one"}, "a.y.one": set(), "a.y.two": {"a.x.two"}, "a.x.two": set()}
    assert circle(apart) == []
    assert set(circle(rooms(apart, "a"))) == {"a.x", "a.y"}
    assert set(circle({**apart, "a.y.one": {"a.x.one"}})) == {"a.x.one", "a.y.one"}
