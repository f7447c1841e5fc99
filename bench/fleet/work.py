"""In a worker: the diagnosis of one vehicle, as the texts of its files."""

import platform
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits

from bench.diagnose.diagnose import diagnose
from bench.diagnose.logs.load import load, starting_from
from bench.diagnose.report import output_folder
from bench.diagnose.result import Diagnosis
from bench.diagnose.select.catalogue import check_catalogue
from bench.experiment.asked import Asked
from bench.fleet.members import Member
from bench.fleet.options import Options, environment, key_of
from registry.atomic_io import scratch
from registry.dynamics import PhysicsModel
from registry.errors import BenchError

Diagnose = Callable[[Member, Options], tuple[Diagnosis, PhysicsModel]]
"""How a vehicle is diagnosed. It must be importable by name: other processes and machines call it."""
Outcome = tuple[str, dict[str, str]]
"""A sentence on why there is no answer (empty: there is one), and the texts of the files by name."""


def diagnose_member(member: Member, options: Options) -> tuple[Diagnosis, PhysicsModel]:
    """`bench.diagnose` of one vehicle of a fleet.

    Raises:
        BenchError: its data or the model cannot be read, or do not fit each other.
    """
    subject = load(member.folder, options.system)
    if options.model:
        subject = replace(subject, model=starting_from(subject, Path(options.model)))
    check_catalogue(subject, subject.model, options.catalogue)
    return diagnose(
        replace(subject, name=member.title),
        catalogue=options.effects,
        horizon_s=options.horizon_s,
        ignore=options.ignore,
    )


def work(do: Diagnose, member: Member, options: Options, key: str, same: dict[str, str]) -> Outcome:
    """Diagnose one vehicle; what is wrong with it alone is a sentence and stops nobody else.

    Args:
        do: how.
        member: whom.
        options: what is asked.
        key: of the answer, as the driver knows it.
        same: the driver's `environment`, of which the answer is a function.

    Raises:
        BenchError: this machine would give other results than the driver's.
    """
    if dict(environment()) != same:
        other = ", ".join(n for n in same if environment().get(n) != same[n])
        raise BenchError(
            f"The worker on {platform.node()} would give other results: its {other} differs from the driver's; run the "
            "driver on a machine like it, with the same packages."
        )
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1):
            if key_of(member, options) != key:
                raise BenchError(f"The data in {member.path} were changed meanwhile: start again.")
            found, model = do(member, options)
            return "", _files(member, options, found, model)
    except BenchError as error:
        return str(error).replace(member.path, member.source), {}
    except Exception as error:  # one vehicle among thousands: the others are diagnosed all the same
        return f"The diagnosis failed with {type(error).__name__}: {str(error).partition(chr(10))[0]:.300}", {}


def _files(member: Member, options: Options, found: Diagnosis, model: PhysicsModel) -> dict[str, str]:
    asked = Asked(options.system or "", options.model)
    found = replace(found, evidence=replace(found.evidence, source=member.source, part=member.part, asked=asked))
    with scratch() as folder:
        return {p.name: p.read_text(encoding="utf-8") for p in output_folder.write(folder, found, model)}
