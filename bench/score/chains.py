"""Which of the simulators a case comes from, for those who need not know."""

import shutil
from pathlib import Path

from bench.diagnose.logs.subject import Subject
from bench.score import case as first
from bench.score import oracle, trial
from bench.score.case import Case
from bench.score.chain import case as second
from bench.score.logs import subject
from bench.score.multirotor.corrupt import Fault
from bench.score.unknown import case as unknown
from bench.score.unknown.condition import UnknownCase
from registry.dynamics import PhysicsModel


def measured(case: Case, cache: Path) -> tuple[Subject, list[Fault]]:
    """The logs of ``case`` as the diagnosis takes them, and what was spoilt in them."""
    if isinstance(case, second.ChainCase):
        return second.measured(case, cache), []
    if isinstance(case, UnknownCase):
        return unknown.measured(case, cache), []
    columns, faults = first.fly_and_faults(case, cache)
    known = {k: dict(v) for k, v in case.known.items()}
    return subject(case.id, columns, first.nominal(case), dict(first.UNCERTAINTY), known, case.drive), faults


def shares(case: Case, cache: Path) -> dict[str, float]:
    """Of the error of a forecast, by hidden effect."""
    if not case.effects:
        return {}
    if isinstance(case, second.ChainCase):
        return second.shares(case, cache)
    return oracle.shares(case, first.truth(case, cache))


def changed_constants(case: Case) -> dict[str, list[dict[str, float]]]:
    """See `bench.score.case.changed_constants`."""
    if isinstance(case, second.ChainCase):
        return second.changed_constants(case)
    return first.changed_constants(case)


def true_model(case: Case, base: PhysicsModel) -> PhysicsModel:
    """``base`` with the true constants and the hidden effects."""
    if isinstance(case, second.ChainCase):
        return second.true_model(case, base)
    return first.true_model(case, base)


def write_folder(case: Case, path: Path, cache: Path) -> None:
    """Write the logs of ``case`` and their dataset.toml to the folder ``path``; known effects go to model.toml."""
    if isinstance(case, second.ChainCase):
        shutil.copytree(second.kept(case, cache), path, dirs_exist_ok=True)
    elif isinstance(case, UnknownCase):
        shutil.copytree(unknown.kept(case, cache), path, dirs_exist_ok=True)
    else:
        trial.write_folder(case, path, cache)


def cases(seed: str, quick: bool, chain: str) -> list[Case]:
    """The suite of ``chain`` ("first", "second", "both", "unknown") for ``seed``, "development" or "reported"."""
    from bench.score import cases as one
    from bench.score.chain import suite as two
    from bench.score.unknown import suite as three

    out: list[Case] = []
    for name, of in (("first", one), ("second", two), ("unknown", three)):
        if chain == name or (chain == "both" and name != "unknown"):
            out += of.cases(of.REPORTED if seed == "reported" else of.DEVELOPMENT, quick)
    return out
