"""Names on the command line, looked up before anything heavy is imported: a misspelt one is said at once."""

import os

import click

from bench.experiment import study
from bench.experiment.notation import parse
from registry.core import DATASETS, PHYSICS, PREDICTORS
from registry.errors import BenchError, near


def check_target(target: str) -> None:
    """Raise `BenchError` where ``target`` is neither a study nor a configuration.

    A single word gets the near names of studies and predictors.
    """
    if target in study.titles():
        return
    if ":" not in target and " " not in target.strip() and target not in PREDICTORS.outline():
        raise BenchError(
            f"There is no study or predictor {target!r}: {near(target, [*study.titles(), *PREDICTORS.outline()])}"
        )
    parse(target)


def check_request(ctx: click.Context, target: str, dataset: str | None) -> None:
    """Check the data set and the target, and refuse --preset beside a single configuration.

    Raises:
        BenchError: there is no such data set or target.
        click.UsageError: the preset of a configuration.
    """
    check_dataset(dataset)
    check_target(target)
    if target not in study.titles() and ctx.get_parameter_source("preset") == click.core.ParameterSource.COMMANDLINE:
        raise click.UsageError(
            "--preset belongs to a study; set a configuration's own options, such as --set training.updates=3000."
        )


def check_system(system: str | None) -> None:
    """Raise `BenchError` where a physics model is neither registered nor a class in a file that exists."""
    if system is None:
        return
    path, colon, _ = system.rpartition(":")
    if not colon or not path.endswith(".py"):
        PHYSICS.check(system)
    elif not os.path.isfile(path):  # False too for what can be no path
        raise BenchError(f"--system {system}: the file {path} does not exist.")


def check_dataset(name: str | None) -> None:
    """Raise `BenchError` where no data set has this name and no folder with a dataset.toml either."""
    if name is not None and not os.path.isfile(os.path.join(name, "dataset.toml")):
        DATASETS.check(name)
