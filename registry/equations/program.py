"""Equations as a list of statements on single numbers, from which a file of any language is printed.

Every statement is an operation of `ARITY` on numbers and earlier statements. The same statement is kept once, and what
is known beforehand is computed beforehand: a model whose effect is neutral costs nothing.
"""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Node:
    """The result of a statement, or one entry of an input."""

    number: int
    operation: str
    """Of `ON_NUMBERS`, or "given"."""
    arguments: tuple["Value", ...]
    entry: tuple[str, int] = ("", 0)
    """Of an input: its name and the place."""


Value = Node | float


def _sign(x: float) -> float:
    return math.copysign(1.0, x) if x else 0.0


def _divide(x: float, y: float) -> float:
    if y:
        return x / y
    return math.nan if not x or math.isnan(x) else math.copysign(math.inf, x) * math.copysign(1.0, y)


ON_NUMBERS: dict[str, Callable[..., float]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": _divide,
    "power": math.pow,
    "negative": operator.neg,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "arctan2": math.atan2,
    "abs": abs,
    "sign": _sign,
    "floor": lambda x: float(math.floor(x)),
    "maximum": max,
    "minimum": min,
    "greater": lambda x, y: float(x > y),
    "greater_equal": lambda x, y: float(x >= y),
    "where": lambda condition, x, y: x if condition else y,
}
"""Every operation that there is. Comparisons give 1 or 0."""


class Program:
    """Statements in the order in which they are computed."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[tuple[Any, ...], Node] = {}

    def given(self, name: str, size: int) -> list[Node]:
        """The entries of an input."""
        return [self._keep("given", (), (name, i)) for i in range(size)]

    def __call__(self, operation: str, *arguments: Value) -> Value:
        """The result of an operation of `ON_NUMBERS`, as a number where it is known."""
        if not any(isinstance(a, Node) for a in arguments):
            return ON_NUMBERS[operation](*arguments)
        short = _shortened(operation, arguments)
        return self._keep(operation, arguments) if short is None else short

    def _keep(self, operation: str, arguments: tuple[Value, ...], entry: tuple[str, int] = ("", 0)) -> Node:
        key = (operation, entry, *(("#", a.number) if isinstance(a, Node) else a for a in arguments))
        if key not in self._known:
            self._known[key] = Node(len(self.nodes), operation, arguments, entry)
            self.nodes.append(self._known[key])
        return self._known[key]

    def needed(self, outputs: Sequence[Value]) -> list[Node]:
        """The statements on which outputs rest, in order; inputs are none."""
        left, found = [v for v in outputs if isinstance(v, Node)], set()
        while left:
            node = left.pop()
            if node.number not in found:
                found.add(node.number)
                left += [a for a in node.arguments if isinstance(a, Node)]
        return [n for n in self.nodes if n.number in found and n.operation != "given"]

    def read(self, outputs: Sequence[Value]) -> set[tuple[str, int]]:
        """The entries of inputs on which outputs rest, by name and place."""
        values = [*outputs, *(a for n in self.needed(outputs) for a in n.arguments)]
        return {v.entry for v in values if isinstance(v, Node) and v.operation == "given"}

    def evaluate(
        self,
        outputs: Sequence[Value],
        operations: Mapping[str, Callable[..., Any]],
        given: Mapping[str, Sequence[Any]],
    ) -> list[Any]:
        """The outputs, with the operations and inputs of another world, such as CasADi's symbols.

        Args:
            outputs: to be computed.
            operations: by the names of `ON_NUMBERS`.
            given: entries of every input, by its name.
        """
        values: dict[int, Any] = {}

        def of(value: Any) -> Any:
            if not isinstance(value, Node):
                return value
            if value.operation == "given":
                name, i = value.entry
                return given[name][i]
            return values[value.number]

        for node in self.needed(outputs):
            values[node.number] = operations[node.operation](*map(of, node.arguments))
        return list(map(of, outputs))


def _shortened(operation: str, arguments: Sequence[Value]) -> Value | None:
    """What an operation comes to that one known number decides; None: it has to be done."""
    first, *rest = arguments
    second: Value = rest[0] if rest else math.nan
    if operation in ("add", "multiply") and not isinstance(first, Node):
        first, second = second, first
    if operation == "where" and not isinstance(arguments[0], Node):
        return arguments[1] if arguments[0] else arguments[2]
    if operation == "where" and arguments[1] is arguments[2]:
        return arguments[1]
    if isinstance(second, Node):
        return 0.0 if operation == "divide" and first == 0.0 else None
    if (operation in ("add", "subtract") and second == 0.0) or (operation in ("multiply", "divide") and second == 1.0):
        return first
    return 0.0 if operation == "multiply" and second == 0.0 else None
