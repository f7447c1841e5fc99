"""What modules file in a registry, read from their sources: importing them would load torch, which takes seconds."""

import ast
import importlib
import importlib.util
import pkgutil
from collections.abc import Iterator
from importlib.machinery import PathFinder
from pathlib import Path

COMPUTED = "OUTLINE"
"""A module whose names are computed says where they come from: OUTLINE = "module:function" (name → first line)."""


def modules(package: str) -> Iterator[pkgutil.ModuleInfo]:
    """Every module of a package and of those in it, by its full name; the packages, which are light, are imported."""
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.ispkg:
            yield module


def package_sources(package: str) -> Iterator[str]:
    """The sources of a package's `modules`."""
    for module in modules(package):
        found = module.module_finder.find_spec(module.name, None)
        if found is not None and found.origin is not None:
            yield Path(found.origin).read_text(encoding="utf-8")


def source_of(module: str) -> str | None:
    """The source of a module, found without importing it or the package that holds it; None: there is none."""
    places, name = None, ""
    for part in module.split("."):
        name = f"{name}.{part}" if name else part
        found = PathFinder.find_spec(name, places)
        if found is None:  # an editable installation has finders of its own, which import the packages above
            found = importlib.util.find_spec(name)
        if found is None:
            return None
        places = found.submodule_search_locations
    if found is None or found.origin is None or not found.origin.endswith(".py"):
        return None
    return Path(found.origin).read_text(encoding="utf-8")


def registered(source: str, registry: str) -> dict[str, str]:
    """Name → first line of its docstring of what a module files by ``@REGISTRY.register("name")``.

    Args:
        source: of the module.
        registry: name of the registry as the module spells it, such as "EFFECTS".
    """
    if f"{registry}.register(" not in source:
        return {}
    found: dict[str, str] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef):
            names = [_argument(d, registry) for d in node.decorator_list]
            about = (ast.get_docstring(node) or "").strip().partition("\n")[0]
            found |= {name: about for name in names if name is not None}
        elif isinstance(node, ast.Assign) and [t.id for t in node.targets if isinstance(t, ast.Name)] == [COMPUTED]:
            module, _, function = ast.literal_eval(node.value).partition(":")
            found |= getattr(importlib.import_module(module), function)()
    return found


def keywords(source: str, name: str) -> dict[str, str]:
    """The keyword arguments, as far as they are text, of the call that a module assigns to ``name``."""
    for node in ast.parse(source).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if [t.id for t in targets if isinstance(t, ast.Name)] == [name] and isinstance(node.value, ast.Call):  # type: ignore[attr-defined]
            values = {k.arg: k.value for k in node.value.keywords}  # type: ignore[attr-defined]
            return {
                k: v.value for k, v in values.items() if k and isinstance(v, ast.Constant) and isinstance(v.value, str)
            }
    return {}


def _argument(decorator: ast.expr, registry: str) -> str | None:
    """The text that ``@REGISTRY.register("text")`` is given; None: another decorator."""
    match decorator:
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id=name), attr="register"), args=[ast.Constant(value=str(text))]
        ) if name == registry:
            return text
    return None
