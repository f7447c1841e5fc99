"""A physics model in a user's own file: run, and tried once, so that a mistake is one sentence with its line."""

import importlib.util
import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import torch
from torch import Tensor

from bench.diagnose.logs.consistency import drives, modelled
from bench.diagnose.logs.subject import Subject
from bench.diagnose.settings import READING
from registry.contracts import Channel
from registry.dynamics import PhysicsModel
from registry.errors import BenchError, near
from registry.regular_file import regular
from registry.units import SIGNALS

_TOLD = ("state_channels", "input_signals", "equation")
"""What a physics model says of itself."""
BATCH = 3


def own_class(system: str) -> Any:
    """The class in "path/to/file.py:Class"; runs that file, makes a model and asks it for one derivative.

    Raises:
        BenchError: no such file or class, or what is wrong in it: method, shape, line.
    """
    path, _, name = system.rpartition(":")
    file = Path(path)
    if not file.is_file():
        raise BenchError(f"--system {system}: the file {file} does not exist.")
    regular(file)
    where = f"--system {system}"
    module_name = f"_system_{file.stem}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    if spec is None or spec.loader is None:
        raise BenchError(f"{where}: {file} is no Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    _do(where, file, str(file), lambda: spec.loader.exec_module(module))  # type: ignore[union-attr]
    kind = getattr(module, name, None)
    if not (isinstance(kind, type) and issubclass(kind, PhysicsModel)):
        raise BenchError(f"{where}: {file} has no class {name} that derives from PhysicsModel.")
    missing = sorted(kind.__abstractmethods__) + [n for n in _TOLD if not hasattr(kind, n)]
    if missing:
        raise BenchError(f"{where}: {name} lacks {', '.join(missing)}.")
    _says(where, kind)
    _tried(where, file, kind)
    return kind


def _says(where: str, kind: Any) -> None:
    """Raise where the class says of itself what cannot be."""
    name = kind.__name__
    if lacking := kind.lacking():
        raise BenchError(f"{where}: {name} {lacking}")
    channels, signals = kind.state_channels, kind.input_signals
    if not isinstance(channels, tuple) or not channels or not all(isinstance(c, Channel) for c in channels):
        raise BenchError(f"{where}: {name}.state_channels must be a tuple of Channel, not {channels!r:.120}.")
    if not isinstance(signals, tuple) or not all(isinstance(d, str) for d in signals):
        raise BenchError(
            f'{where}: {name}.input_signals must be a tuple of names such as ("force",), not {signals!r:.80}.'
        )
    known = {**SIGNALS, **kind.signals}
    for beside in kind.disturbances:
        if beside not in kind.signals or len(kind.signals[beside].axes) > 1:
            raise BenchError(
                f"{where}: {name}.disturbances has {beside!r}, which must stand in {name}.signals as a signal of one "
                'channel, such as Signal("degC", ("",)).'
            )
    for drive in signals:
        if drive not in known:
            raise BenchError(
                f"{where}: {name}.input_signals has {drive!r}, which is no signal: {near(drive, known)} "
                f"One of its own stands in {name}.signals, with its unit."
            )
    if not isinstance(kind.equation, str):
        raise BenchError(f"{where}: {name}.equation must be a text, not {kind.equation!r:.80}.")


def _tried(where: str, file: Path, kind: Any) -> None:
    """Raise where a model cannot be made, or its derivative is none."""
    name, size = kind.__name__, len(kind.state_channels)
    model = _do(where, file, f"{name}()", kind)
    _do(where, file, f"{name}.parameters", model.parameters)
    width = _do(where, file, f"{name}()", lambda: drives(model)) + len(model.extras)
    state = torch.linspace(0.5, 1.5, BATCH * size, dtype=torch.float64).reshape(BATCH, size)
    inputs = torch.linspace(1.0, 2.0, BATCH * width, dtype=torch.float64).reshape(BATCH, width)
    one = {p.name: torch.full((BATCH,), float(p.value)) for p in model.parameters() if isinstance(p.value, int | float)}
    each = _do(where, file, f"{name}()", lambda: replace(model, **one))
    asked = [
        ("derivative", model, (state, inputs)),
        ("project", model, (state,)),
        ("derivative", each, (state, inputs)),
    ]
    for call, made_by, given in asked:
        hint = (
            " with constants (3,), one a state: write tensor(self.CONSTANT, state).unsqueeze(-1) beside state[..., 1:]"
        )
        told = f"{name}.{call}" + hint * (made_by is each)
        made = _do(where, file, told, partial(getattr(made_by, call), *given))
        if not isinstance(made, Tensor):
            raise BenchError(f"{where}: {told} returns {type(made).__name__}, where a tensor (…, {size}) is due.")
        if made.shape != state.shape:
            raise BenchError(
                f"{where}: {told} makes {tuple(made.shape)} of states {tuple(state.shape)} and inputs "
                f"{tuple(inputs.shape)}: it must have the shape of the states, (…, {size})."
            )
        if not made.is_floating_point():
            raise BenchError(f"{where}: {told} returns {made.dtype}, where floats are due.")


def where_told(subject: Subject) -> tuple[Subject, tuple[str, ...]]:
    """The subject without samples at which its model gives no finite rate, few of many, and a sentence that says so.

    Raises:
        BenchError: they are many; how many, and where the first one is.
    """
    wrong, first = [], ""
    for log in subject.logs:
        given = torch.isfinite(log.states).all(-1) & torch.isfinite(log.inputs).all(-1) & log.valid
        rates = torch.from_numpy(modelled(subject.model, log))[:, list(log.measured)]
        wrong.append(given & ~torch.isfinite(rates).all(-1))
        if wrong[-1].any() and not first:
            first = f"first in {log.name} after {int(wrong[-1].nonzero()[0]) * log.dt:.6g} s"
    count, whole = (sum(int(x.sum()) for x in some) for some in (wrong, (log.valid for log in subject.logs)))
    if not count:
        return subject, ()
    said = f"{subject.system} gives no finite rate at {count} of {whole} samples ({100 * count / whole:.2g} %), {first}"
    if count > READING.untold * whole:
        raise BenchError(
            f"{said}: write own_rate so that it holds wherever the system was, or leave these samples out."
        )
    logs = (replace(log, valid=log.valid & ~bad) for log, bad in zip(subject.logs, wrong, strict=True))
    return replace(subject, logs=tuple(logs)), (f"{said}; these are left out.",)


def _do(where: str, file: Path, what: str, action: Callable[[], Any]) -> Any:
    """The result, or a sentence with the line of the file that was last at work."""
    try:
        return action()
    except (Exception, SystemExit) as error:
        line = error.lineno if isinstance(error, SyntaxError) else _line(error.__traceback__, file)
        at = f", line {line}" if line else ""
        said = " ".join(str(error).split())[:300]
        raise BenchError(f"{where}: {what}{at} fails with {type(error).__name__}: {said}.") from error


def _line(found: TracebackType | None, file: Path) -> int | None:
    own = [f.lineno for f in traceback.extract_tb(found) if Path(f.filename) == file]
    return own[-1] if own else None
