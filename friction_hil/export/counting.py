"""The operations of a step in the worst case: of two branches the dearer one, of a loop its most passes."""

from collections import Counter
from functools import cache

from friction_hil.export import arithmetic, ir

ADDITIONS, DIVISIONS, COMPARISONS = "additions and multiplications", "divisions", "comparisons"
_SIGNS = {
    **dict.fromkeys(("+", "-", "*"), ADDITIONS),
    "/": DIVISIONS,
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!=", "min", "max", "isfinite", "isnan"), COMPARISONS),
}


def operations(function: ir.Function) -> dict[str, int]:
    """Return the numbers of floating-point operations, and of calls of each function of the library."""
    return dict(_of_function(function))


@cache
def _of_function(function: ir.Function) -> "Counter[str]":
    return _of_block(function.body)


def _of_block(block: ir.Block) -> "Counter[str]":
    total: Counter[str] = Counter()
    for statement in block:
        own: Counter[str] = Counter()
        for expression in ir.expressions(statement):
            own += _of_expression(expression)
        match statement:
            case ir.CallStatement(_, called):
                own += _of_function(called)
            case ir.If(_, then, other):
                own += _of_block(then) | _of_block(other)
            case ir.For(body=body, most=most):
                own += _times(_of_block(body), most)
            case ir.While(body=body, most=most):
                own = _times(own, most + 1) + _times(_of_block(body), most)
        total += own
    return total


def _times(count: "Counter[str]", factor: int) -> "Counter[str]":
    return Counter({name: number * factor for name, number in count.items()})


def _of_expression(expression: ir.Expression) -> "Counter[str]":
    parts = [_of_expression(each) for each in ir.children(expression)]
    if isinstance(expression, ir.Operation) and expression.name == "select":
        return parts[0] + (parts[1] | parts[2])
    total: Counter[str] = Counter()
    for each in parts:
        total += each
    if isinstance(expression, ir.Call):
        total += _of_function(expression.function)
    elif isinstance(expression, ir.Operation) and _is_of_floats(expression):
        if expression.name in _SIGNS:
            total[_SIGNS[expression.name]] += 1
        elif expression.name in arithmetic.FUNCTIONS:
            total[expression.name] += 1
    return total


def _is_of_floats(expression: ir.Operation) -> bool:
    return any(arithmetic.is_number(each.type) for each in expression.operands)
