"""Which effects of the catalogue can be looked for at all."""

from collections.abc import Collection, Sequence

import numpy as np

from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import SEARCHING
from bench.diagnose.simulate.unmeasured import hidden
from registry.core import EFFECTS
from registry.dynamics import Effect, InputEffect, PhysicsModel
from registry.effects.actuation import DriveEffect
from registry.errors import BenchError


def check_catalogue(subject: Subject, model: PhysicsModel, names: Sequence[str]) -> None:
    """Raise `BenchError` where an effect that was asked for cannot be looked for."""
    for name in names:
        why = unfit(subject, model, name, EFFECTS.get(name))
        if why and not set(EFFECTS.get(name).requires) & set(names):
            raise BenchError(f"--catalogue {name}: {why}.")


def admissible(
    subject: Subject, model: PhysicsModel, catalogue: Sequence[str] | None
) -> list[tuple[str, type[Effect]]]:
    """Effects of the catalogue that fit the system, whose signals were measured and that the model lacks.

    Raises:
        BenchError: an id that is not in the catalogue.
    """
    kinds = [(name, EFFECTS.get(name)) for name in (EFFECTS.names() if catalogue is None else catalogue)]
    return [(name, kind) for name, kind in kinds if not unfit(subject, model, name, kind)]


def acting_through(
    subject: Subject, model: PhysicsModel, catalogue: Sequence[str] | None
) -> list[tuple[str, type[Effect]]]:
    """Effects that fit but act only through another one, such as wind through a drag, which the model lacks too."""
    needy = [(n, EFFECTS.get(n)) for n in (EFFECTS.names() if catalogue is None else catalogue)]
    held = {EFFECTS.name_of(type(e)) for e in model.effects} | set(model.provides)
    return [
        (name, kind)
        for name, kind in needy
        if not kind.met_by(held) and not unfit(subject, model, name, kind, beside=kind.requires)
    ]


def unfit(subject: Subject, model: PhysicsModel, name: str, kind: type[Effect], beside: Collection[str] = ()) -> str:
    """Why an effect cannot be looked for, with effects of these ids ``beside`` it; empty: it can."""
    simulated = {model.state_channels[i].group for i in hidden(subject.logs)}  # it stands in for the measurement
    measured = set(subject.signals) | set(model.extras) | simulated
    drive = set(type(model).input_signals) & measured
    if drive & {"rotor_command", "pwm"}:
        measured |= {"rotor_speed", "rotor_command"}  # a command stands for the speed that it asks for
    measured |= type(model).also_measured(measured)
    held = {EFFECTS.name_of(type(e)) for e in model.effects} | set(model.provides)
    if issubclass(kind, InputEffect) and not type(model).input_signals:
        return f"it acts on an input, and {type(model).system_name()} has none"
    if not kind.suits(type(model)):
        return f"it is an effect of {kind.acts_in or ', '.join(kind.systems)}, not of {type(model).system_name()}"
    if name == "input_delay" and model.drive_acts_at_once:
        return "what drives the model was measured, and acts at once: a delay of it is one of the log"
    if issubclass(kind, DriveEffect) and drive_is_noisy(subject):
        return (
            "what drives the model was measured, with noise: so it is what acts, after an actuator, and not its command"
        )
    if "rotor_command" in kind.needs and getattr(model, "drive", "") not in ("rotor_command", "pwm"):
        return "the model is not driven by a command"
    if not kind.met_by({*held, *beside}):
        return f"it acts beside {' or '.join(kind.requires)}, which the model has not"
    if kind.learned:
        return "it is learned from what the catalogue leaves, by `bench extend DATA --add learned`"
    if name in held:
        return "the model has it"
    if why := kind.neutral_for(model, {}).misfit(model):
        return why.rstrip(".")
    missing = [n for n in kind.needs if n not in measured]
    return f"{', '.join(missing)} was not measured" if missing else ""


def drive_is_noisy(subject: Subject) -> bool:
    """Whether a signal that drives the model, and is no command, has noise beside which thresholds mean nothing.

    The median of third differences: steps are no noise.
    """
    if subject.model.input_hold == "previous":
        return False
    drives = [log.inputs.numpy()[:, : log.inputs.shape[-1] - len(subject.model.extras)] for log in subject.logs]
    third = np.concatenate([np.abs(np.diff(u, n=3, axis=0)) for u in drives])
    sigma = np.median(third, axis=0) / (0.6745 * 20**0.5) if len(third) else np.zeros(1)
    return bool((sigma > SEARCHING.noisy_drive * np.concatenate(drives).std(0)).any())
