"""A physics model as one Python file that needs numpy alone."""

from pathlib import Path

from bench.export.equations import Equations
from registry.atomic_io import write_text, writing
from registry.equations.program import Node, Value
from registry.equations.trace import Traced

PRINTED = {
    "add": "{} + {}",
    "subtract": "{} - {}",
    "multiply": "{} * {}",
    "divide": "{} / {}",
    "negative": "-{}",
    **{f: f"np.{f}({{}})" for f in ("sqrt", "exp", "log", "sin", "cos", "tanh", "abs", "sign", "floor")},
    **{f: f"np.{f}({{}}, {{}})" for f in ("power", "arctan2", "maximum", "minimum", "greater", "greater_equal")},
    "where": "np.where({}, {}, {})",
}

_FILE = '''\
"""{about}.

Written by `bench export-model`; needs numpy alone. SI units; states and inputs are arrays (..., n) of float64.

    import {module} as model
    states = model.simulate(state, inputs)  # (..., N, {proper}) from (..., {proper}) and inputs (..., N, {width})

{constants}
"""

import numpy as np

STATES = {states}
"""Names and units."""
INPUTS = {drives}
DT = {dt!r}
"""Sampling period of the inputs [s]. Inputs are {held} between samples."""
BODY = {body}
"""Entries of a full state before what delays and lags remember: the states, then the effects' own."""


{functions}


def step(full, before, after):
    """The full state (..., n) a period later (4th-order Runge-Kutta), at the inputs (..., m) of both samples."""
    body, memory = full[..., :BODY], full[..., BODY:]
    passed = _transmit(memory, before, after)
    memory, acting = passed[..., : memory.shape[-1]], passed[..., memory.shape[-1] :]
{advancing}
    return np.concatenate([body, memory], axis=-1)


def simulate(state, inputs):
    """States (..., N, {proper}) at the samples of inputs (..., N, {width}), from the first one on, steady before."""
    state, inputs = np.asarray(state, dtype=float), np.asarray(inputs, dtype=float)
    full, states = initial(state, inputs[..., 0, :]), [state]
    for k in range(1, inputs.shape[-2]):
        full = step(full, inputs[..., k - 1, :], inputs[..., k, :])
        states.append(full[..., : len(STATES)])
    return np.stack(np.broadcast_arrays(*states), axis=-2)


def _beside(values, *given):
    """Values of any shape (...) beside each other (..., n)."""
    shape = np.broadcast_shapes(*(g.shape[:-1] for g in given))
    out = np.empty((*shape, len(values)))
    for i, value in enumerate(values):
        out[..., i] = value
    return out
'''
_RUNGE_KUTTA = """\
    first, middle, last = np.split(acting, 3, axis=-1)
    rate = (4 * middle - 3 * first - last) / DT, (last - first) / DT, (3 * last - 4 * middle + first) / DT
    k1 = derivative(body, first, rate[0])
    k2 = derivative(body + DT / 2 * k1, middle, rate[1])
    k3 = derivative(body + DT / 2 * k2, middle, rate[1])
    k4 = derivative(body + DT * k3, last, rate[2])
    body = _project(body + DT / 6 * (k1 + 2 * (k2 + k3) + k4))"""
_ABOUT = {
    "derivative": "Time derivative of the state (..., BODY) at inputs and their time derivatives (..., m).",
    "project": "The state (..., BODY) with a quaternion, if there is one, at unit length.",
    "initial": "Full state from the state proper and inputs that have been steady until now.",
    "advance": "The state (..., BODY) a period later, with dry friction; acting: at start, middle and end (..., 3 m).",
    "transmit": "What is remembered after a step, then what acts at its start, middle and end.",
}


def source(equations: Equations, module: str = "model") -> str:
    """The file as text.

    Args:
        equations: of the model.
        module: how it will be imported, for the example in its head.
    """
    made = []
    for name in ("derivative", "initial", "project", "transmit", *(["advance"] if equations.advance else [])):
        shown = name if name in ("derivative", "initial") else f"_{name}"
        made.append(_function(shown, getattr(equations, name), _ABOUT[name]))
    held = "held" if equations.model.input_hold == "previous" else "straight lines"
    return _FILE.format(
        about=equations.about[:1].upper() + equations.about[1:],
        module=module,
        proper=len(equations.states),
        width=equations.inputs,
        constants=_constants(equations),
        states=_listed({n: u for n, u in zip(equations.states, equations.units, strict=True)}),
        drives=_listed(equations.drives),
        dt=equations.dt,
        held=held,
        body=equations.body,
        functions="\n\n\n".join(made),
        advancing="    body = _advance(body, acting)" if equations.advance else _RUNGE_KUTTA,
    )


def write(path: Path, equations: Equations) -> Path:
    """Write `source`, whole or not at all.

    Raises:
        BenchError: the file cannot be written.
    """
    with writing(path):
        write_text(path, source(equations, path.stem))
    return path


def _function(name: str, of: Traced, about: str) -> str:
    """One traced function; its statements work on arrays (…) entry by entry."""
    needed = of.program.needed(of.outputs)
    used = of.program.read(of.outputs)
    lines = ['@np.errstate(all="ignore")', f"def {name}({', '.join(of.arguments)}):", f'    """{about}"""']
    lines += [f"    {a} = np.asarray({a}, dtype=float)" for a in of.arguments]
    for argument in of.arguments:
        entries = sorted(i for a, i in used if a == argument)
        lines += [f"    {argument}_{i} = {argument}[..., {i}]" for i in entries]
    for node in needed:
        lines.append(f"    v{node.number} = {PRINTED[node.operation].format(*map(_text, node.arguments))}")
    results = ", ".join(map(_text, of.outputs))
    return "\n".join([*lines, f"    return _beside([{results}], {', '.join(of.arguments)})"])


def _text(value: Value) -> str:
    if isinstance(value, Node):
        if value.operation == "given":
            return "{}_{}".format(*value.entry)
        return f"v{value.number}"
    if value != value or value in (float("inf"), float("-inf")):
        return f"float('{value}')"
    return repr(float(value)) if value >= 0 else f"({float(value)!r})"


def _listed(names: tuple[str, ...] | dict[str, str]) -> str:
    """As Python prints them, a line each."""
    if isinstance(names, dict):
        return "{\n" + "".join(f"    {n!r}: {u!r},\n" for n, u in names.items()) + "}"
    return "(\n" + "".join(f"    {n!r},\n" for n in names) + ")"


def _constants(equations: Equations) -> str:
    """A line a constant of the model and of its effects, which stand as numbers in the statements."""
    model = equations.model
    return "\n".join(
        f"    {p.name} = {p.value!r}{'' if p.unit == '1' else f' {p.unit}'}"
        for parameters in (model.parameters(), *(e.parameters() for e in model.effects))
        for p in parameters
    )
