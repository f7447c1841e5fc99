"""A learned term in words, and its parameters by name."""

from bench.diagnose.learned_shape import LearnedShape
from bench.diagnose.report import phrases
from bench.diagnose.result import ParameterEstimate
from registry.dynamics import PhysicsModel
from registry.effects.learned_term import LearnedTerm
from registry.terms import signals
from registry.terms.shapes import SHAPES, SPLINE


def axis_named(axis: str, model: PhysicsModel) -> str:
    """An axis as a reader says it."""
    kind = type(model)
    if not signals.flies(kind):
        return phrases.named(signals.quantity_of(kind, axis))
    return phrases.named(axis if axis.startswith(("world", "torque")) else f"body_{axis}")


def described(
    term: LearnedTerm, model: PhysicsModel, estimates: list[ParameterEstimate]
) -> tuple[LearnedShape, dict[str, ParameterEstimate]]:
    """A term with what is known of its parameters.

    Args:
        term: fitted.
        model: that it acts in.
        estimates: of its parameters, in order; their units are not looked at.
    """
    named = term.named_parameters(model)
    parameters = {
        name: ParameterEstimate(e.value, e.low, e.high, unit) for (name, unit), e in zip(named, estimates, strict=True)
    }
    of = f"f({phrases.named(term.signals[0])})" if term.signals else "c"
    times = f" × {phrases.named(term.signals[1])}" if len(term.signals) > 1 else ""
    if term.shape == SPLINE:
        unit = signals.available(model)[term.signals[0]]
        over, factor = phrases.shown(unit, term.signals[0])
        low, high = (phrases.number(factor * k) for k in term.span)
        formula, how = "f(x)", f"a spline through {len(term.knots)} values from {low} to {phrases.united(high, over)}"
    else:
        shape = SHAPES[term.shape]
        formula = shape.text
        values = [phrases.estimate(n, p) for n, p in parameters.items()]
        if len(values) > 1:
            values = [f"{n} = {v}" for n, v in zip(parameters, values, strict=True)]
        said = shape.said if len(parameters) == 1 else f"{shape.said} {formula}"
        how = ", ".join([said, *values])
    text = f"{axis_named(term.axis, model)} = {of}{times}, {how}"
    return LearnedShape(term.axis, term.signals, term.shape, formula, text), parameters
