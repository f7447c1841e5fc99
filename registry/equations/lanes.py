"""Programs that a compiled interpreter runs on many lanes at once: what costs torch a call is a few instructions here.

A statement is done on a block of lanes before the next one, its operands in the first cache. The operations are those
of torch, one by one and in their order: results are equal but for the last bits of sums and of functions such as exp.
"""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from registry.equations.program import ON_NUMBERS, Node, Value
from registry.equations.trace import Traced
from registry.kernels.native import library

_SOURCES = Path(__file__).parent / "native"
_FLAGS = ("-ffp-contract=off",)
_CODES = {name: i for i, name in enumerate(ON_NUMBERS)}


class _Argument(ctypes.Structure):
    """`Argument` of lanes.cpp."""

    _fields_ = (
        ("values", ctypes.c_void_p),
        *((n, ctypes.c_int64) for n in ("size", "per_model", "per_lane", "per_step")),
        ("registers", ctypes.c_void_p),
    )


_SIZES = ("models", "lanes", "steps", "statements", "constants", "registers", "arguments", "outputs", "fed")
_ADDRESSES = ("code", "constant", "constant_registers", "given", "output_registers", "out")


class _Run(ctypes.Structure):
    """`Run` of lanes.cpp."""

    _fields_ = (
        *((n, ctypes.c_int64) for n in _SIZES),
        *((n, ctypes.c_void_p) for n in _ADDRESSES),
        *((n, ctypes.c_int64) for n in ("per_model", "per_lane", "per_step", "per_entry")),
    )


@lru_cache
def _interpreter() -> ctypes.CDLL | None:
    """The compiled interpreter; None where there is no compiler, or none is wanted."""
    return library.built(_SOURCES, _FLAGS)


def available() -> bool:
    """Whether programs can be run."""
    return _interpreter() is not None


@dataclass(frozen=True, eq=False)
class Lanes:
    """A program as the interpreter reads it."""

    code: np.ndarray
    """(statements, 5) int32: operation, where its result goes, three operands; all but the first are registers."""
    constants: np.ndarray
    """(c,) what stands in the registers `constant_registers` from the start."""
    constant_registers: np.ndarray
    registers: int
    arguments: Mapping[str, np.ndarray]
    """By name, in order: of every entry its register; −1: it is not read."""
    outputs: np.ndarray
    """(n,) registers."""

    @classmethod
    def of(cls, traced: Traced) -> "Lanes":
        """Statements in order, in as few registers as their lives allow."""
        return _allocated(traced)

    def run(self, given: Sequence[Tensor], models: int, lanes: int, steps: int = 0) -> Tensor:
        """The outputs of every model on every lane.

        Args:
            given: an argument each, (models or 1, lanes or 1, n); where there are steps, all but the first may be
                (models or 1, lanes or 1, steps, n).
            models: M.
            lanes: W.
            steps: so many in a row, where the first outputs of one are the first argument of the next; 0: once.

        Returns:
            (M, W, outputs), each entry's lanes one after another, or (M, W, steps, outputs).
        """
        count = len(self.outputs)
        if steps:
            out = torch.empty(models, lanes, steps, count, dtype=torch.float64)
        else:
            out = torch.empty(models, count, lanes, dtype=torch.float64).transpose(1, 2)
        if not out.numel():
            return out
        held = [x.to(torch.float64).contiguous() for x in given]
        fields = [_argument(x, r) for x, r in zip(held, self.arguments.values(), strict=True)]
        arguments = (_Argument * len(fields))(*fields)
        call = _Run(
            models=models,
            lanes=lanes,
            steps=max(steps, 1),
            statements=len(self.code),
            constants=len(self.constants),
            registers=self.registers,
            arguments=len(fields),
            outputs=count,
            fed=held[0].shape[-1] if steps else 0,
            code=self.code.ctypes.data,
            constant=self.constants.ctypes.data,
            constant_registers=self.constant_registers.ctypes.data,
            given=ctypes.addressof(arguments),
            output_registers=self.outputs.ctypes.data,
            out=out.data_ptr(),
            per_model=out.stride(0),
            per_lane=out.stride(1),
            per_step=out.stride(2) if steps else 0,
            per_entry=out.stride(-1),
        )
        interpreter = _interpreter()
        assert interpreter is not None  # else nobody has a reason to ask
        interpreter.run_lanes(ctypes.byref(call))
        return out


def _argument(x: Tensor, registers: np.ndarray) -> _Argument:
    """An argument (models or 1, lanes or 1, n) or (models or 1, lanes or 1, steps, n) without gaps."""
    strides = [s if size > 1 else 0 for s, size in zip(x.stride(), x.shape, strict=True)]
    return _Argument(
        values=x.data_ptr(),
        size=x.shape[-1],
        per_model=strides[0],
        per_lane=strides[1],
        per_step=strides[2] if x.dim() == 4 else 0,
        registers=registers.ctypes.data,
    )


def _allocated(traced: Traced) -> Lanes:
    """Inputs and constants keep their registers, results of statements theirs until nobody reads them any more."""
    program, nodes = traced.program, traced.program.needed(traced.outputs)
    read = program.read(traced.outputs)
    entries = {n.entry: n.number for n in program.nodes if n.operation == "given" and n.entry in read}
    arguments = {name: np.full(size, -1, dtype=np.int32) for name, size in traced.arguments.items()}
    place: dict[int, int] = {}
    for register, ((name, i), number) in enumerate(entries.items()):
        place[number] = arguments[name][i] = register
    values = [*traced.outputs, *(a for n in nodes for a in n.arguments)]
    constants = {repr(v): float(v) for v in values if not isinstance(v, Node)}
    known = {text: len(entries) + i for i, text in enumerate(constants)}

    def register_of(value: Value) -> int:
        return place[value.number] if isinstance(value, Node) else known[repr(value)]

    count, free, code = len(entries) + len(known), list[int](), np.zeros((len(nodes), 5), dtype=np.int32)
    last = {a.number: i for i, n in enumerate(nodes) for a in n.arguments if isinstance(a, Node)}
    stays = {v.number for v in traced.outputs if isinstance(v, Node)} | set(entries.values())
    for i, node in enumerate(nodes):
        code[i, 0], code[i, 2 : 2 + len(node.arguments)] = _CODES[node.operation], [*map(register_of, node.arguments)]
        done = {a.number for a in node.arguments if isinstance(a, Node) and last[a.number] == i} - stays
        free += sorted(place[number] for number in done)
        if not free:
            free, count = [count], count + 1
        place[node.number] = code[i, 1] = free.pop()
    return Lanes(
        code=code,
        constants=np.array(list(constants.values())),
        constant_registers=np.array(list(known.values()), dtype=np.int32),
        registers=count,
        arguments=arguments,
        outputs=np.array([register_of(v) for v in traced.outputs], dtype=np.int32),
    )
