"""Whether effects that somebody asks for can be looked for at all."""

from collections.abc import Sequence

from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.search import unfit
from registry.core import EFFECTS
from registry.dynamics import PhysicsModel
from registry.errors import BenchError


def check_catalogue(subject: Subject, model: PhysicsModel, names: Sequence[str]) -> None:
    """Raise `BenchError` where an effect that was asked for cannot be looked for."""
    for name in names:
        why = unfit(subject, model, name, EFFECTS.get(name))
        if why and not set(EFFECTS.get(name).requires) & set(names):
            raise BenchError(f"--catalogue {name}: {why}.")
