"""Operators and functions on expressions: their types, their bounds, and their values where the operands are known."""

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from friction_hil.export.ir import Bounds, Constant, Expression, Operation, Type, Variable

# Functions of the mathematical library: the same name, meaning and order of arguments in Python and in C99
FUNCTIONS = (
    *("sin", "cos", "tanh", "exp", "expm1", "log", "log1p", "sqrt", "asinh", "copysign", "pow"),
)  # fmt: skip
_COMPARE: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_FLOATS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
_INTS: dict[str, Callable[[Any, Any], int]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "//": operator.floordiv,
    "%": operator.mod,
    "&": operator.and_,
}


def is_number(kind: Type) -> bool:
    """Return True for the types of floating-point numbers."""
    return kind in ("real", "wide")


def united(first: Type, second: Type) -> Type:
    """Return the type of a variable that takes values of both types."""
    order: tuple[Type, ...] = ("bool", "int", "real", "wide")
    return max(first, second, key=order.index)


def known(value: Any) -> Constant:
    """Return a Python number as a constant."""
    if isinstance(value, (bool, np.bool_)):
        return Constant("bool", bool(value))
    if isinstance(value, (int, np.integer)):
        return Constant("int", int(value), bounds=(int(value), int(value)))
    return Constant("real", float(value))


def cast(value: Expression, kind: Type) -> Expression:
    """Return a value as another type; a number becomes an int by dropping its fraction."""
    if value.type == kind:
        return value
    if isinstance(value, Constant) and math.isfinite(value.value):
        if kind == "int":
            return known(int(value.value))
        if kind == "bool":
            return known(bool(value.value))
        return Constant(kind, float(value.value), name=value.name)
    if isinstance(value, Constant) and is_number(kind):
        return Constant(kind, value.value, name=value.name)
    return Operation(kind, "cast", (value,), bounds=value.bounds if kind in ("int", "real") else None)


def negative(value: Expression) -> Expression:
    """Return -value."""
    if isinstance(value, Constant):
        return Constant(value.type, -value.value, bounds=_flipped(value.bounds))
    return Operation(value.type, "neg", (value,), bounds=_flipped(value.bounds))


def _flipped(bounds: Bounds | None) -> Bounds | None:
    return None if bounds is None else (-bounds[1], -bounds[0])


def binary(sign: str, a: Expression, b: Expression) -> Expression:
    """Return the result of an arithmetic operator.

    The difference of two positions is a displacement, a position plus a displacement is a position, and every other
    result of them a plain number.
    """
    if not is_number(a.type) and not is_number(b.type) and sign != "/":
        return _of_ints(sign, cast(a, "int"), cast(b, "int"))
    kind: Type = "real"
    if (sign == "+" and "wide" in (a.type, b.type)) or (sign == "-" and a.type == "wide" and b.type != "wide"):
        kind = "wide"
    if not is_number(a.type):
        a = cast(a, "real")
    if not is_number(b.type):
        b = cast(b, "real")
    if isinstance(a, Constant) and isinstance(b, Constant):
        with np.errstate(all="ignore"):
            return Constant(kind, float(_FLOATS[sign](np.float64(a.value), np.float64(b.value))))
    if kind == "real" and isinstance(b, Constant) and b.value == 1.0 and sign in "*/" and a.type == "real":
        return a  # exact, also for NaN and infinity
    if kind == "real" and isinstance(a, Constant) and a.value == 1.0 and sign == "*" and b.type == "real":
        return b
    return Operation(kind, sign, (a, b), bounds=_bounds(sign, a, b))


def _of_ints(sign: str, a: Expression, b: Expression) -> Expression:
    if isinstance(a, Constant) and isinstance(b, Constant):
        return known(_INTS[sign](int(a.value), int(b.value)))
    if sign in "+-" and isinstance(b, Constant) and b.value == 0:
        return a
    if sign == "+" and isinstance(a, Constant) and a.value == 0:
        return b
    if sign == "+" and isinstance(a, Constant):
        a, b = b, a
    if sign == "%" and (a.bounds is None or a.bounds[0] < 0):
        raise ValueError("% of a number that may be negative differs between languages")
    # (x + 2) + 3 as x + 5, so that an index reads well
    if sign == "+" and isinstance(b, Constant) and isinstance(a, Operation) and a.name == "+":
        inner, added = a.operands
        if isinstance(added, Constant) and added.type == "int":
            return _of_ints("+", inner, known(int(added.value) + int(b.value)))
    return Operation("int", sign, (a, b), bounds=_bounds(sign, a, b))


def _bounds(sign: str, a: Expression, b: Expression) -> Bounds | None:
    if sign == "&" and isinstance(b, Constant) and b.value >= 0:
        return 0, int(b.value)
    if a.bounds is None or b.bounds is None:
        return None
    (low, high), (least, most) = a.bounds, b.bounds
    if sign == "+":
        return low + least, high + most
    if sign == "-":
        return low - most, high - least
    if sign == "*":
        corners = [low * least, low * most, high * least, high * most]
        return min(corners), max(corners)
    if sign == "//" and isinstance(b, Constant):
        return low // least, high // least
    if sign == "%" and isinstance(b, Constant):
        return 0, most - 1
    return None


def compared(sign: str, a: Expression, b: Expression) -> Expression:
    """Return the result of a comparison."""
    if isinstance(a, Constant) and isinstance(b, Constant):
        return known(_COMPARE[sign](a.value, b.value))
    kind = united(a.type, b.type)
    if is_number(kind):
        a, b = (each if is_number(each.type) else cast(each, "real") for each in (a, b))
    return Operation("bool", sign, (a, b))


def inverted(value: Expression) -> Expression:
    """Return not value."""
    if isinstance(value, Constant):
        return known(not value.value)
    return Operation("bool", "not", (truth(value),))


def truth(value: Expression) -> Expression:
    """Return a value as a condition."""
    if value.type == "bool":
        return value
    return compared("!=", value, known(0) if value.type == "int" else known(0.0))


def joined(name: str, values: list[Expression]) -> Expression:
    """Return ``and`` or ``or`` of conditions; those that are known disappear."""
    decisive = name == "or"
    kept: list[Expression] = []
    for value in map(truth, values):
        if isinstance(value, Constant):
            if bool(value.value) == decisive:
                kept.append(value)
                break
            continue
        kept.append(value)
    if not kept:
        return known(not decisive)
    if isinstance(kept[0], Constant):
        return kept[0]
    result = kept[0]
    for value in kept[1:]:
        result = Operation("bool", name, (result, value))
    return result


def selected(test: Expression, then: Expression, other: Expression) -> Expression:
    """Return ``then if test else other``."""
    if isinstance(test, Constant):
        return then if test.value else other
    if (isinstance(then, Constant) and then.is_same(other)) or then == other:
        return then
    kind = united(then.type, other.type)
    bounds = None
    if then.bounds is not None and other.bounds is not None:
        bounds = min(then.bounds[0], other.bounds[0]), max(then.bounds[1], other.bounds[1])
    return Operation(kind, "select", (test, cast(then, kind), cast(other, kind)), bounds=bounds)


def extreme(name: str, values: list[Expression]) -> Expression:
    """Return ``min`` or ``max`` as Python defines them: the first, unless a later one is beyond it; also with NaN."""
    result = values[0]
    for value in values[1:]:
        kind = united(result.type, value.type)
        a, b = cast(result, kind), cast(value, kind)
        if isinstance(a, Constant) and isinstance(b, Constant):
            result = b if (b.value < a.value if name == "min" else b.value > a.value) else a
            continue
        result = Operation(kind, name, (a, b), bounds=_of_extreme(name, a, b))
    return result


def _of_extreme(name: str, a: Expression, b: Expression) -> Bounds | None:
    first, second = span(a), span(b)
    pick = min if name == "min" else max
    low, high = pick(first[0], second[0]), pick(first[1], second[1])
    # only bounds of both sides are worth keeping
    return None if math.isinf(low) or math.isinf(high) else (math.floor(low), math.ceil(high))


def span(value: Expression) -> tuple[float, float]:
    """Return the smallest and the largest value that an expression can have, as far as that is known."""
    if value.bounds is not None:
        return value.bounds
    if isinstance(value, Constant):
        return value.value, value.value
    if isinstance(value, Operation) and value.name in ("min", "max"):
        first, second = map(span, value.operands)
        pick = min if value.name == "min" else max
        return pick(first[0], second[0]), pick(first[1], second[1])
    if isinstance(value, Operation) and value.name == "cast" and value.type == "int":
        return span(value.operands[0])
    return -math.inf, math.inf


def absolute(value: Expression) -> Expression:
    """Return the absolute value."""
    if isinstance(value, Constant):
        return Constant(value.type, abs(value.value))
    if value.type == "int":
        return selected(compared("<", value, known(0)), negative(value), value)
    return Operation(value.type, "fabs", (value,))


def function(name: str, operands: list[Expression]) -> Expression:
    """Return the value of one of `FUNCTIONS`, or of ``isfinite`` or ``isnan``."""
    if name in ("isfinite", "isnan"):
        (value,) = operands
        if isinstance(value, Constant):
            return known(getattr(math, name)(value.value))
        return known(name == "isfinite") if not is_number(value.type) else Operation("bool", name, (value,))
    values = [cast(each, "real") for each in operands]
    if all(isinstance(each, Constant) for each in values):
        numbers = [each.value for each in values if isinstance(each, Constant)]
        try:
            return known(float(getattr(math, name)(*numbers)))
        except (ValueError, OverflowError):
            pass  # C has an answer to what Python refuses
    return Operation("real", name, tuple(values))


def substituted(expression: Expression, values: dict[str, Expression]) -> Expression:
    """Return an expression with other expressions in place of variables."""
    if isinstance(expression, Variable):
        return values.get(expression.name, expression)
    if isinstance(expression, Operation):
        operands = tuple(substituted(each, values) for each in expression.operands)
        return Operation(expression.type, expression.name, operands, bounds=expression.bounds)
    if isinstance(expression, Constant):
        return expression
    raise ValueError("a function of the state cannot be built in")
