"""The equations of a physics model as a `Program`: its torch operations are recorded, then done on single numbers."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from registry.equations.program import ON_NUMBERS, Node, Program, Value
from registry.errors import BenchError

Array = Any
"""A numpy array of `Value`, of any shape."""


@dataclass(frozen=True)
class Traced:
    """A function of named vectors, each of a known size, that gives one vector."""

    arguments: dict[str, int]
    program: Program
    outputs: tuple[Value, ...]


def traced(function: Callable[..., Tensor], arguments: Mapping[str, int]) -> Traced:
    """Record what ``function`` does.

    Args:
        function: of one float64 vector (n,) an argument, gives a vector; it may not branch on their values.
        arguments: name → n, in order.

    Raises:
        BenchError: it branches on values, or does something that `_ACTIONS` does not hold.
    """
    return recorded(lambda _, *given: function(*given), arguments)


def recorded(function: Callable[..., Tensor], arguments: Mapping[str, int]) -> Traced:
    """As `traced`, of a function whose first argument is the `Recorder`."""
    generator = torch.Generator().manual_seed(0)
    examples = [0.5 + torch.rand(n, generator=generator, dtype=torch.float64) for n in arguments.values()]
    program = Program()
    recorder = Recorder(program)
    for example, (name, n) in zip(examples, arguments.items(), strict=True):
        recorder.keep(example, _array(program.given(name, n), (n,)))
    with torch.no_grad(), recorder:
        result = function(recorder, *examples)
    return Traced(dict(arguments), program, tuple(recorder.of(result).reshape(-1).tolist()))


class Recorder(TorchDispatchMode):
    """Does on arrays of `Value` what is done on the tensors that it was told of."""

    def __init__(self, program: Program) -> None:
        super().__init__()
        self.program, self._player = program, _Player(program)
        self._known: dict[int, tuple[Tensor, Array]] = {}  # with the tensor, whose number is then nobody else's

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # nobody compiles this, and to be skipped costs a second of imports

    def keep(self, x: Tensor, values: Array) -> None:
        """From now on a tensor stands for these values of its shape."""
        self._known[id(x)] = x, values

    def insert(self, traced: Traced, *given: Tensor) -> Tensor:
        """Apply a recorded program to other arguments; the tensor returned is a placeholder without numbers."""
        values = dict(zip(traced.arguments, (self.of(x).reshape(-1).tolist() for x in given), strict=True))
        operations = {name: partial(self.program, name) for name in ON_NUMBERS}
        found = traced.program.evaluate(traced.outputs, operations, values)
        out = torch.ones(len(found), dtype=torch.float64)
        self.keep(out, _array(found, (len(found),)))
        return out

    def of(self, x: Any) -> Any:
        """The values that a tensor, or each of a list, stands for; one that it was not told of is constant."""
        if isinstance(x, Tensor):
            if id(x) in self._known:
                return self._known[id(x)][1]
            return _array(x.detach().cpu().to(torch.float64).reshape(-1).tolist(), tuple(x.shape))
        return [self.of(v) for v in x] if isinstance(x, (list, tuple)) else x

    def _stands(self, x: Any) -> bool:
        if isinstance(x, Tensor):
            return id(x) in self._known
        return isinstance(x, (list, tuple)) and any(map(self._stands, x))

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        out = func(*args, **kwargs)
        made = not any(isinstance(x, Tensor) for x in args) and func.__name__.partition(".")[0] in _ACTIONS
        if made or self._stands(args) or self._stands(list(kwargs.values())):
            values = self._player.play(func, self.of(args), {k: self.of(v) for k, v in kwargs.items()})
            several = isinstance(out, (list, tuple))
            for x, found in zip(out, values, strict=True) if several else [(out, values)]:
                self.keep(x, found)
        return out


def _array(values: Sequence[Value], shape: Sequence[int]) -> Array:
    out = np.empty(len(values), dtype=object)
    out[:] = values
    return out.reshape(shape)


@dataclass
class _Player:
    """Does recorded operations on arrays of values."""

    program: Program

    def play(self, target: Any, args: Any, kwargs: Any) -> Any:
        name = target.__name__.partition(".")[0] if hasattr(target, "__name__") else str(target)
        name = name.removesuffix("_") if name != "copy_" else name
        if name in _ELEMENTWISE:
            return self.each(_ELEMENTWISE[name], *args)
        if name in _BRANCHES:
            raise BenchError("The model cannot be exported: it branches on values.")
        if name not in _ACTIONS:
            raise BenchError(
                f"The model uses {name!r} of torch, which export does not support: use operations such as "
                "sums, products, where and clamp."
            )
        return _ACTIONS[name](self, *args, **kwargs)

    def each(self, operation: str, *arguments: Any) -> Array:
        """An operation on every entry, with broadcasting."""
        arrays = np.broadcast_arrays(*map(_as_array, arguments))
        flat = [
            self.program(operation, *values) for values in zip(*(a.reshape(-1).tolist() for a in arrays), strict=True)
        ]
        return _array(flat, arrays[0].shape)


def _as_array(x: Any) -> Array:
    return x if isinstance(x, np.ndarray) else _array([float(x)], ())


# ------------------------------------------------------------------------------------------- torch's operations

_ELEMENTWISE = {
    "mul": "multiply",
    "div": "divide",
    "neg": "negative",
    "sqrt": "sqrt",
    "exp": "exp",
    "log": "log",
    "sin": "sin",
    "cos": "cos",
    "tanh": "tanh",
    "atan2": "arctan2",
    "abs": "abs",
    "sign": "sign",
    "floor": "floor",
    "maximum": "maximum",
    "minimum": "minimum",
    "where": "where",
    "gt": "greater",
    "ge": "greater_equal",
}


def _add(p: _Player, a: Any, b: Any, alpha: float = 1) -> Array:
    return p.each("add", a, b if alpha == 1 else p.each("multiply", float(alpha), b))


def _sub(p: _Player, a: Any, b: Any, alpha: float = 1) -> Array:
    return p.each("subtract", a, b if alpha == 1 else p.each("multiply", float(alpha), b))


def _pow(p: _Player, a: Any, exponent: Any) -> Array:
    if exponent == 2:
        return p.each("multiply", a, a)
    if exponent == 3:
        return p.each("multiply", p.each("multiply", a, a), a)
    return p.each("sqrt", a) if exponent == 0.5 else p.each("power", a, exponent)


def _clamp(p: _Player, a: Any, low: Any = None, high: Any = None, **other: Any) -> Array:
    low, high = other.get("min", low), other.get("max", high)
    a = a if low is None else p.each("maximum", a, low)
    return a if high is None else p.each("minimum", a, high)


def _leg(p: _Player, a: Any) -> Array:
    """√(1 − a²), without the loss of digits near ±1."""
    return p.each("sqrt", p.each("multiply", p.each("subtract", 1.0, a), p.each("add", 1.0, a)))


def _sum(p: _Player, a: Array, dims: Sequence[int] | None = None, keepdim: bool = False, **_: Any) -> Array:
    axes = sorted(range(a.ndim) if not dims else (d % a.ndim for d in dims), reverse=True)
    for axis in axes:
        parts = [np.take(a, [i], axis=axis) for i in range(a.shape[axis])]
        a = parts[0] if parts else np.zeros_like(a)
        for part in parts[1:]:
            a = p.each("add", a, part)
        a = a if keepdim else np.squeeze(a, axis=axis)
    return a


def _norm(p: _Player, a: Array, order: float = 2, dims: Any = None, keepdim: bool = False, **_: Any) -> Array:
    if order != 2:
        raise BenchError(f"The model uses a norm of order {order}, which export does not support: use 2.")
    return p.each("sqrt", _sum(p, p.each("multiply", a, a), dims, keepdim))


def _select(p: _Player, a: Array, dim: int, i: int) -> Array:
    return a[(slice(None),) * (dim % a.ndim) + (i, ...)]


def _slice(p: _Player, a: Array, dim: int = 0, start: Any = None, end: Any = None, step: int = 1) -> Array:
    return a[(slice(None),) * (dim % a.ndim) + (slice(start, end, step), ...)]


def _split(p: _Player, a: Array, sizes: Any, dim: int = 0) -> list[Array]:
    length = a.shape[dim]
    sizes = [sizes] * math.ceil(length / sizes) if isinstance(sizes, int) else list(sizes)
    edges = np.cumsum([0, *sizes]).clip(max=length)
    return [_slice(p, a, dim, int(i), int(j)) for i, j in pairwise(edges)]


def _view(p: _Player, a: Array, shape: Sequence[int]) -> Array:
    return a.reshape(tuple(shape))


def _expand(p: _Player, a: Array, shape: Sequence[int], **_: Any) -> Array:
    own = (1,) * (len(shape) - a.ndim) + a.shape
    return np.broadcast_to(a, [o if s == -1 else s for s, o in zip(shape, own, strict=True)])


def _copy_into(p: _Player, into: Array, source: Any, *_: Any) -> Array:
    into[...] = _as_array(source)
    return into


def _filled(value: float) -> Callable[..., Array]:
    return lambda p, shape, *_, **__: _array([value] * math.prod(shape), tuple(shape))


def _like(value: float) -> Callable[..., Array]:
    return lambda p, a, *_, **__: _array([value] * a.size, a.shape)


def _arange(p: _Player, *ends: float, **_: Any) -> Array:
    return _array([float(v) for v in np.arange(*ends)], (len(np.arange(*ends)),))


def _index(p: _Player, a: Array, at: Sequence[Any]) -> Array:
    places = []
    for i in at:
        if i is not None and any(isinstance(v, Node) for v in i.reshape(-1)):
            raise BenchError("The model indexes by computed values, which export does not support.")
        places.append(slice(None) if i is None else i.astype(float).astype(int))
    return a[tuple(places)].copy()


def _same(p: _Player, a: Array, *_: Any, **__: Any) -> Array:
    return a


_BRANCHES = ("_local_scalar_dense", "is_nonzero", "equal", "nonzero")
_ACTIONS: dict[str, Callable[..., Any]] = {
    "add": _add,
    "sub": _sub,
    "rsub": lambda p, a, b, alpha=1: _sub(p, b, a, alpha),
    "reciprocal": lambda p, a: p.each("divide", 1.0, a),
    "square": lambda p, a: p.each("multiply", a, a),
    "pow": _pow,
    "clamp": _clamp,
    "clamp_min": _clamp,
    "clamp_max": lambda p, a, high: _clamp(p, a, None, high),
    "asin": lambda p, a: p.each("arctan2", a, _leg(p, a)),
    "acos": lambda p, a: p.each("arctan2", _leg(p, a), a),
    "atan": lambda p, a: p.each("arctan2", a, 1.0),
    "lt": lambda p, a, b: p.each("greater", b, a),
    "le": lambda p, a, b: p.each("greater_equal", b, a),
    "sum": _sum,
    "linalg_vector_norm": _norm,
    "select": _select,
    "slice": _slice,
    "split": _split,
    "split_with_sizes": _split,
    "unbind": lambda p, a, dim=0: [_select(p, a, dim, i) for i in range(a.shape[dim])],
    "cat": lambda p, parts, dim=0: np.concatenate(parts, axis=dim),
    "stack": lambda p, parts, dim=0: np.stack(parts, axis=dim),
    "unsqueeze": lambda p, a, dim: np.expand_dims(a, dim),
    "squeeze": lambda p, a, dim: np.squeeze(a, axis=dim if isinstance(dim, int) else tuple(dim)),
    "view": _view,
    "_unsafe_view": _view,
    "reshape": _view,
    "expand": _expand,
    "repeat": lambda p, a, times: np.tile(a, times),
    "permute": lambda p, a, dims: a.transpose(dims),
    "transpose": lambda p, a, i, j: a.swapaxes(i, j),
    "index": _index,
    "copy_": _copy_into,
    "alias": _same,
    "detach": _same,
    "_to_copy": lambda p, a, *_, **__: a.copy(),
    "clone": lambda p, a, *_, **__: a.copy(),
    "lift_fresh_copy": lambda p, a: a.copy(),
    "zeros": _filled(0.0),
    "ones": _filled(1.0),
    "eye": lambda p, size, *_, **__: _array(np.eye(size).reshape(-1).tolist(), (size, size)),
    "full": lambda p, shape, value, *_, **__: _array([float(value)] * math.prod(shape), tuple(shape)),
    "new_zeros": lambda p, a, shape, *_, **__: _filled(0.0)(p, shape),
    "new_ones": lambda p, a, shape, *_, **__: _filled(1.0)(p, shape),
    "new_empty": lambda p, a, shape, *_, **__: _filled(0.0)(p, shape),
    "zeros_like": _like(0.0),
    "ones_like": _like(1.0),
    "arange": _arange,
}
