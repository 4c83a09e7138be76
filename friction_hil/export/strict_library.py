"""Functions for a language whose arithmetic has no NaN and may stop the program at an overflow or a division by zero.

Where C gives infinity or NaN they give a number of the size `UNLIMITED`, which counts as not finite.
"""

from collections.abc import Callable

from friction_hil.export import ir
from friction_hil.export.ir import Block, Constant, Expression, Function, Operation, Variable

UNLIMITED = 1e30  # stands for infinity; products of three do not overflow; a compiler takes LREAL up to 3.4e38 only
_LARGEST_EXPONENT = 69.0  # exp(69) is about 1e30


def _number(value: float) -> Constant:
    return Constant("real", value)


def _of(name: str, *operands: Expression) -> Operation:
    is_condition = name in ("<", "<=", ">", ">=", "==", "!=", "and", "or", "not")
    return Operation("bool" if is_condition else "real", name, operands)


def _when(test: Expression, value: Expression) -> ir.If:
    return ir.If(test, [ir.Return((value,))], [])


_X, _Y = Variable("real", "x"), Variable("real", "y")


def _divide() -> Block:
    is_beyond = _of("<=", _of("*", _of("fabs", _Y), _number(UNLIMITED)), _of("fabs", _X))
    signs = [
        _when(_of("and", _of("<", _X, _number(0.0)), _of(">=", _Y, _number(0.0))), _number(-UNLIMITED)),
        _when(_of("and", _of(">=", _X, _number(0.0)), _of("<", _Y, _number(0.0))), _number(-UNLIMITED)),
    ]
    return [ir.If(is_beyond, [*signs, ir.Return((_number(UNLIMITED),))], []), ir.Return((_of("/", _X, _Y),))]


def _exponential() -> Block:
    return [
        _when(_of(">", _X, _number(_LARGEST_EXPONENT)), _number(UNLIMITED)),
        ir.Return((_of("exp", _X),)),
    ]


def _root() -> Block:
    return [_when(_of("<", _X, _number(0.0)), _number(UNLIMITED)), ir.Return((_of("sqrt", _X),))]


def _logarithm() -> Block:
    return [_when(_of("<=", _X, _number(0.0)), _number(-UNLIMITED)), ir.Return((_of("log", _X),))]


def _power() -> Block:
    """Return the statements of x to the power of y for x of zero and above."""
    exponent = Variable("real", "exponent")
    return [
        ir.If(
            _of("<=", _X, _number(0.0)),
            [
                _when(_of("==", _Y, _number(0.0)), _number(1.0)),
                _when(_of("and", _of("==", _X, _number(0.0)), _of(">", _Y, _number(0.0))), _number(0.0)),
                ir.Return((_number(UNLIMITED),)),
            ],
            [],
        ),
        ir.Assign(exponent, _of("*", _Y, _of("log", _X))),
        _when(_of(">", exponent, _number(_LARGEST_EXPONENT)), _number(UNLIMITED)),
        ir.Return((_of("pow", _X, _Y),)),
    ]


def _expm1() -> Block:
    """W. Kahan's way: the error of exp is undone by that of its logarithm (Higham 2002, section 1.14.1)."""
    u = Variable("real", "u")
    return [
        _when(_of(">", _X, _number(_LARGEST_EXPONENT)), _number(UNLIMITED)),
        _when(_of("<", _X, _number(-40.0)), _number(-1.0)),
        ir.Assign(u, _of("exp", _X)),
        _when(_of("==", u, _number(1.0)), _X),
        ir.Return((_of("/", _of("*", _of("-", u, _number(1.0)), _X), _of("log", u)),)),
    ]


def _log1p() -> Block:
    """W. Kahan's way, likewise."""
    u = Variable("real", "u")
    return [
        _when(_of("<=", _X, _number(-1.0)), _number(-UNLIMITED)),
        ir.Assign(u, _of("+", _number(1.0), _X)),
        _when(_of("==", u, _number(1.0)), _X),
        ir.Return((_of("/", _of("*", _of("log", u), _X), _of("-", u, _number(1.0))),)),
    ]


def _tanh() -> Block:
    u = Variable("real", "u")
    return [
        _when(_of(">", _X, _number(20.0)), _number(1.0)),
        _when(_of("<", _X, _number(-20.0)), _number(-1.0)),
        ir.Assign(u, ir.Call("real", function("expm1"), (_of("*", _number(2.0), _X),))),
        ir.Return((_of("/", u, _of("+", u, _number(2.0))),)),
    ]


def _asinh() -> Block:
    size, square = Variable("real", "size"), Variable("real", "square")
    root = _of("+", _number(1.0), _of("sqrt", _of("+", _number(1.0), square)))
    return [
        ir.Assign(size, _of("fabs", _X)),
        ir.Assign(square, _of("*", size, size)),
        ir.Assign(size, ir.Call("real", function("log1p"), (_of("+", size, _of("/", square, root)),))),
        _when(_of("<", _X, _number(0.0)), _of("neg", size)),
        ir.Return((size,)),
    ]


def _copysign() -> Block:
    return [_when(_of("<", _Y, _number(0.0)), _of("neg", _of("fabs", _X))), ir.Return((_of("fabs", _X),))]


_BODIES: dict[str, tuple[Callable[[], Block], str]] = {
    "divide": (_divide, f"Return x / y, of the size {UNLIMITED:g} at most, also where y is zero."),
    "exponential": (_exponential, f"Return exp x, at most {UNLIMITED:g}."),
    "root": (_root, f"Return the square root of x; {UNLIMITED:g} where it has none."),
    "logarithm": (_logarithm, f"Return the natural logarithm of x; {-UNLIMITED:g} where it has none."),
    "power": (_power, f"Return x to the power of y; {UNLIMITED:g} where it has no value or a larger one."),
    "expm1": (_expm1, "Return exp x - 1, exact also for small x."),
    "log1p": (_log1p, f"Return the natural logarithm of 1 + x, exact also for small x; {-UNLIMITED:g} if none."),
    "tanh": (_tanh, "Return the hyperbolic tangent of x."),
    "asinh": (_asinh, "Return the inverse hyperbolic sine of x."),
    "copysign": (_copysign, "Return the size of x with the sign of y."),
}
NAMES = tuple(_BODIES)
_MADE: dict[str, Function] = {}


def function(name: str) -> Function:
    """Return a function of this library."""
    if name not in _MADE:
        body, summary = _BODIES[name]
        statements = body()
        read = {e.name for s in ir.statements(statements) for x in ir.expressions(s) for e in ir.walk(x)
                if isinstance(e, Variable)}  # fmt: skip
        parameters = [each for each in (_X, _Y) if each.name in read]
        _MADE[name] = Function(name, summary, parameters, ("real",), statements)
    return _MADE[name]


def quotient(a: Expression, b: Expression) -> Expression:
    """Return a / b."""
    return _of("/", a, b) if is_positive(b) or _is_negative_constant(b) else _called("divide", a, b)


def value(name: str, operands: tuple[Expression, ...]) -> Expression:
    """Return a function of the mathematical library."""
    x = operands[0]
    if name in ("sin", "cos"):
        return _of(name, x)
    if name == "exp":
        return _of("exp", x) if is_nonpositive(x) else _called("exponential", x)
    if name == "sqrt":
        return _of("sqrt", x) if is_nonnegative(x) else _called("root", x)
    if name == "log":
        return _of("log", x) if is_positive(x) else _called("logarithm", x)
    return _called({"pow": "power"}.get(name, name), *operands)


def _called(name: str, *operands: Expression) -> Expression:
    return ir.Call("real", function(name), operands)


def _is_negative_constant(value: Expression) -> bool:
    return isinstance(value, Constant) and value.value < 0.0


def is_positive(value: Expression) -> bool:
    """Return True if an expression is certainly above zero, by what is written in it."""
    if isinstance(value, Constant):
        return value.value > 0.0
    if not isinstance(value, Operation):
        return False
    parts = value.operands
    if value.name == "+":
        return any(map(is_positive, parts)) and all(map(is_nonnegative, parts))
    if value.name == "max":
        return any(map(is_positive, parts))
    return value.name == "min" and all(map(is_positive, parts))


def is_nonnegative(value: Expression) -> bool:
    """Return True if an expression is certainly not below zero."""
    if isinstance(value, Constant):
        return value.value >= 0.0
    if not isinstance(value, Operation):
        return False
    parts = value.operands
    if value.name in ("exp", "sqrt", "fabs"):
        return True
    if value.name == "*" and parts[0] == parts[1]:
        return True
    if value.name in ("+", "*", "/", "min"):
        return all(map(is_nonnegative, parts))
    if value.name == "neg":
        return is_nonpositive(parts[0])
    return value.name == "max" and any(map(is_nonnegative, parts))


def is_nonpositive(value: Expression) -> bool:
    """Return True if an expression is certainly not above zero."""
    if isinstance(value, Constant):
        return value.value <= 0.0
    return isinstance(value, Operation) and value.name == "neg" and is_nonnegative(value.operands[0])
