"""A physics model among the signals of a run: which of them drive it, which are its states, where it starts."""

import dataclasses
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from registry.contracts import Dataset, Predictor, Problem
from registry.core import PHYSICS
from registry.dynamics import PhysicsModel
from registry.dynamics.initial_state import estimate_initial_state
from registry.errors import BenchError
from registry.model_file import read
from registry.physics.quadrotor import Quadrotor
from registry.physics.rigid_body import RigidBody
from registry.stated import physics_of, refuse_unstated

_NEEDED = ("velocity", "attitude", "body_rates")
"""States of a rigid body that nothing else tells; a position is looked at by few effects."""
Signals = tuple[str, ...]


class WhiteBox:
    """The physics model of a problem. It lives in SI; its full state is that of `PhysicsModel`."""

    def __init__(self, problem: Problem, file: str = "", driven: bool = True, sought: bool = False) -> None:
        """
        Args:
            problem: what is predicted from what.
            file: a model.toml; empty: the registered model with the data's nominal constants.
            driven: whether the inputs drive the model; else something that is learnt does.
            sought: whether unmeasured states begin where a free run meets the history best; else at zero.

        Raises:
            BenchError: a signal is missing that the model needs, or one is to be predicted that it does not have.
        """
        self.dt, self.sought = 1 / problem.rate, sought
        model = read(Path(file), problem.system) if file else _nominal(problem)
        groups = [c.group for c in problem.inputs]
        looked_at = model.extras if model.effects else ()
        self.model = replace(model, extras=tuple(e for e in looked_at if groups.count(e) == 1))
        self.name = PHYSICS.name_of(type(model))
        self.drives = self._driving(problem, groups) if driven else []
        """Columns of the inputs that drive the model, then its extras."""
        self.extras = len(self.model.extras)
        states = [c.name for c in self.model.state_channels]
        known = [c.name for c in (*problem.outputs, *problem.context)]
        foreign = [c.group for c in problem.outputs if c.name not in states]
        if foreign:
            own = ", ".join(dict.fromkeys(c.group for c in self.model.state_channels))
            raise BenchError(f"{self.name} does not predict {foreign[0]}: choose --outputs among {own}.")
        self.rows = [states.index(c.name) for c in problem.outputs]
        """Place of each output in the state."""
        self.seen = [(states.index(c), i) for i, c in enumerate(known) if c in states]
        """Places in the state, and in the outputs and context, of what was measured."""
        self._refuse_unknown_start(known)
        self.size = self.model.initial(torch.zeros(len(states)), torch.zeros(len(self.drives)), self.dt).shape[-1]

    @property
    def bare(self) -> bool:
        """Whether it is the simple quadrotor and no more."""
        model = self.model
        return type(model) is Quadrotor and not model.effects and not any(model.inertia_products)

    @property
    def held(self) -> bool:
        """Whether inputs are held over a step."""
        return self.model.input_hold == "previous"

    def init_buffers(self, predictor: Predictor, inputs: Tensor, outputs: Tensor) -> Tensor:
        """Buffers at k0 (…, drives + size), SI: what drives the model, then its full state.

        Args:
            predictor: for its scalers.
            inputs: (…, τ, m) scaled history.
            outputs: (…, τ, n + c) scaled, outputs then context.
        """
        measured, context = outputs.split([predictor.n_outputs, predictor.n_context], -1)
        measured = predictor.output_scaler.invert(measured)
        if predictor.context_scaler is not None:
            measured = torch.cat([measured, predictor.context_scaler.invert(context)], -1)
        u = predictor.input_scaler.invert(inputs)
        return torch.cat([u[..., -1, self.drives], self.start(u, measured)], -1)

    def start(self, inputs: Tensor, measured: Tensor) -> Tensor:
        """Full state (…, size) at the end of a history.

        Measured states are as measured. Memories of the inputs, states of effects and states that were not measured
        are as the history leaves them: the model runs through it with the measured states put in at every sample.

        Args:
            inputs: (…, τ, m).
            measured: (…, τ, n + c) outputs and context.
        """
        rows, columns = (list(x) for x in zip(*self.seen, strict=True))
        proper = len(self.model.state_channels)
        states = measured.new_zeros(*measured.shape[:-1], proper)
        states[..., rows] = measured[..., columns]
        driving = inputs[..., self.drives]
        if len(rows) == proper == self.size:
            return self.model.project(states[..., -1, :])
        hidden = [i for i in range(proper) if i not in rows]
        if self.sought and hidden:
            states[..., 0, hidden] = estimate_initial_state(
                self.model, states[..., 0, :], hidden, driving, states, self.dt
            )
        full = self.model.initial(states[..., 0, :], driving[..., 0, :], self.dt)
        known = torch.zeros(self.size, dtype=torch.bool, device=full.device)
        known[rows] = True
        for k in range(1, states.shape[-2]):
            full = self.model.step(full, driving[..., k - 1, :], driving[..., k, :], self.dt)
            full = torch.where(known, torch.nn.functional.pad(states[..., k, :], (0, self.size - proper)), full)
        return torch.cat([self.model.project(full[..., : self._body]), full[..., self._body :]], -1)

    @property
    def _body(self) -> int:
        return len(self.model.state_channels) + self.model.internal_size

    def _driving(self, problem: Problem, groups: list[str]) -> list[int]:
        accepted = _accepted(self.model)
        drive = next((s for s in accepted if s in groups), None)
        if accepted and drive is None:
            have = ", ".join(dict.fromkeys(groups)) or "no input"
            raise BenchError(f"{self.name} needs {' or '.join(accepted)} among the --inputs, which are: {have}.")
        columns = [i for i, g in enumerate(groups) if g == drive]
        if isinstance(self.model, Quadrotor) and len(columns) != len(self.model.rotor_positions):
            raise BenchError(
                f"{drive} has {len(columns)} channels and the model {len(self.model.rotor_positions)} rotors: "
                "give the rotor_positions of this vehicle."
            )
        return columns + [groups.index(e) for e in self.model.extras]

    def _refuse_unknown_start(self, known: list[str]) -> None:
        states = self.model.state_channels
        looked_at = _looked_at(self.model)
        missing = [
            c.group
            for c in states
            if c.name not in known and isinstance(self.model, RigidBody) and c.group in looked_at
        ]
        if missing or not self.seen:
            lacking = missing[0] if missing else states[0].group
            raise BenchError(f"{self.name} starts from a measured {lacking}: add it to --context or --outputs.")


def default_signals(dataset: Dataset, file: str = "") -> tuple[Signals, Signals, Signals]:
    """Inputs, outputs and context of a run that names none: what drives the model, and its measured states.

    Of a rigid body the velocities are predicted; position and attitude only set the start. Of other systems every
    state that the data hold is predicted.
    """
    kind = physics_of(dataset.system, dataset.label)
    model: Any = read(Path(file), dataset.system) if file else kind()
    refuse_unstated(dataset, type(model), file)
    accepted = _accepted(model)
    drive = next((s for s in accepted if s in dataset.inputs), accepted[0] if accepted else None)
    inputs = (drive, *(e for e in model.extras if e in dataset.inputs)) if drive else dataset.inputs
    states = tuple(dict.fromkeys(c.group for c in model.state_channels))
    outputs = ("velocity", "body_rates") if isinstance(model, RigidBody) else ()
    measured = measured_signals(dataset)
    lacking = [s for s in states if s in _looked_at(model) and s not in measured] if outputs else []
    if lacking:
        raise BenchError(
            f"{dataset.label} has no {' and no '.join(lacking)}, from which {type(model).system_name()} starts: a "
            "network does without."
        )
    states = tuple(s for s in states if s in measured)
    return inputs, outputs or states, tuple(s for s in states if s not in outputs) if outputs else ()


def _accepted(model: PhysicsModel) -> tuple[str, ...]:
    """Signals that can drive the model; a quadrotor read from a file knows which it is."""
    if isinstance(model, Quadrotor) and model.drive != model.input_signals[0]:
        return (model.drive,)
    return model.input_signals


def _looked_at(model: PhysicsModel) -> set[str]:
    """States without which a rigid body does not start."""
    return {s for e in model.effects for s in e.needs} | set(_NEEDED)


@lru_cache(maxsize=4)
def measured_signals(dataset: Dataset) -> frozenset[str]:
    """Names of the signals that every recording of the data set holds."""
    if dataset.recorded:
        return frozenset(c.group for c in dataset.recorded)
    return frozenset.intersection(*(frozenset(c.group for c in r.channels) for r in dataset.load().recordings))


def _nominal(problem: Problem) -> PhysicsModel:
    kind = physics_of(problem.system, "The data")
    fields = {f.name for f in dataclasses.fields(kind)}
    given = {k: _tuples(v) for k, v in problem.physics.items() if k in fields}
    groups = {c.group for c in problem.inputs}
    drive = next((s for s in kind.input_signals if s in groups), None)
    if drive is not None and kind.chooses_drive():
        given["drive"] = drive
    extras = ("battery",) if "battery" in groups - {drive} else ()
    model: PhysicsModel = kind(**given, input_hold=problem.input_hold, extras=extras)
    return model


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else float(value)
