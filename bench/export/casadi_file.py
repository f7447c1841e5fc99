"""A physics model as functions of CasADi, which tools for optimal control and estimation take."""

import operator
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.export.equations import Equations
from registry.equations.trace import Traced
from registry.errors import BenchError


def functions(equations: Equations) -> dict[str, Any]:
    """The functions, each of column vectors.

    Returns:
        "derivative" (state, inputs, input_rates) → rate, "step" (full, before, after) → full state a period later,
        "initial" (state, inputs) → full state after all has been steady.

    Raises:
        BenchError: CasADi is not installed.
    """
    ca = _casadi()
    f, body, width, dt = equations, equations.body, equations.inputs, equations.dt
    state, inputs, rates = (ca.SX.sym(n, size) for n, size in f.derivative.arguments.items())
    derivative = ca.Function(
        "derivative",
        [state, inputs, rates],
        [_of(ca, f.derivative, {"state": state, "inputs": inputs, "input_rates": rates})],
        ["state", "inputs", "input_rates"],
        ["rate"],
    )
    proper = ca.SX.sym("state", len(f.states))
    start = _of(ca, f.initial, {"state": proper, "inputs": inputs})
    initial = ca.Function("initial", [proper, inputs], [start], ["state", "inputs"], ["full"])
    full, before, after = ca.SX.sym("full", body + f.memory), ca.SX.sym("before", width), ca.SX.sym("after", width)
    passed = _of(ca, f.transmit, {"memory": full[body:], "before": before, "after": after})
    memory, acting = passed[: f.memory], passed[f.memory :]
    first, middle, last = (acting[i * width : (i + 1) * width] for i in range(3))
    slopes = (4 * middle - 3 * first - last) / dt, (last - first) / dt, (3 * last - 4 * middle + first) / dt
    now = full[:body]
    k1 = derivative(now, first, slopes[0])
    k2 = derivative(now + dt / 2 * k1, middle, slopes[1])
    k3 = derivative(now + dt / 2 * k2, middle, slopes[1])
    k4 = derivative(now + dt * k3, last, slopes[2])
    later = _of(ca, f.project, {"state": now + dt / 6 * (k1 + 2 * (k2 + k3) + k4)})
    if f.advance is not None:
        later = _of(ca, f.advance, {"state": now, "acting": acting})
    step = ca.Function(
        "step", [full, before, after], [ca.vertcat(later, memory)], ["full", "before", "after"], ["next"]
    )
    return {"derivative": derivative, "step": step, "initial": initial}


def write(path: Path, equations: Equations) -> list[Path]:
    """Save the functions beside each other: the derivative at ``path``, the others with their names added.

    Raises:
        BenchError: CasADi is not installed, or the files cannot be written.
    """
    made = functions(equations)
    files = {name: path if name == "derivative" else path.with_stem(f"{path.stem}_{name}") for name in made}
    try:
        for name, file in files.items():
            made[name].save(str(file))
    except (OSError, RuntimeError) as error:
        raise BenchError(f"{path} cannot be written: {str(error).splitlines()[0]}.") from error
    return list(files.values())


def _casadi() -> Any:
    try:
        import casadi
    except ImportError as error:
        raise BenchError("--to casadi needs CasADi: pip install casadi (the extra `export`).") from error
    return casadi


def _of(ca: Any, traced: Traced, given: Mapping[str, Any]) -> Any:
    """The outputs of a traced function at column vectors of symbols."""
    entries: dict[str, Sequence[Any]] = {n: [v[i] for i in range(traced.arguments[n])] for n, v in given.items()}
    values = traced.program.evaluate(traced.outputs, _operations(ca), entries)
    return ca.vertcat(*values) if values else ca.SX(0, 1)


def _operations(ca: Any) -> dict[str, Any]:
    same = ("sqrt", "exp", "log", "sin", "cos", "tanh", "sign", "floor")
    return {
        **{name: getattr(ca, name) for name in same},
        "add": operator.add,
        "subtract": operator.sub,
        "multiply": operator.mul,
        "divide": operator.truediv,
        "negative": operator.neg,
        "power": ca.power,
        "arctan2": ca.atan2,
        "abs": ca.fabs,
        "maximum": ca.fmax,
        "minimum": ca.fmin,
        "greater": operator.gt,
        "greater_equal": operator.ge,
        "where": ca.if_else,
    }
