"""A program as the translation leaves it: typed expressions and statements, for any language to print.

Everything is of one of four types: ``real``, the working precision; ``wide``, double precision in any case, for
positions; ``int``; ``bool``. All memory is one flat state, whose fields are scalars or arrays of fixed length, and
constant tables. There are no pointers, and no function calls itself.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

Type = Literal["real", "wide", "int", "bool"]
Bounds = tuple[int, int]  # smallest and largest value of a whole number


@dataclass(frozen=True, slots=True)
class Expression:
    """A value: its type, and its bounds if it is a whole number and they are known."""

    type: Type
    bounds: Bounds | None = field(default=None, kw_only=True, compare=False)


@dataclass(frozen=True, slots=True)
class Constant(Expression):
    """A number that is known; ``name`` is that of the parameter or setting it comes from."""

    value: float
    name: str = field(default="", kw_only=True, compare=False)

    def is_same(self, other: object) -> bool:
        """Return True for a constant of the same type and value; NaN equals NaN."""
        if not isinstance(other, Constant) or self.type != other.type:
            return False
        both_nan = math.isnan(self.value) and math.isnan(other.value)
        same = self.value == other.value and math.copysign(1.0, self.value) == math.copysign(1.0, other.value)
        return both_nan or same


@dataclass(frozen=True, slots=True)
class Variable(Expression):
    """A local variable or an argument."""

    name: str


@dataclass(frozen=True, slots=True)
class Load(Expression):
    """A field of the state, or the element ``index`` of one that is an array."""

    field: str
    index: Expression | None = None


@dataclass(frozen=True, slots=True)
class Element(Expression):
    """Element ``index`` of a constant table."""

    table: str
    index: Expression


@dataclass(frozen=True, slots=True)
class Operation(Expression):
    """An operator, or a function of the mathematical library.

    The operators are + - * / // % & neg, the comparisons < <= > >= == !=, and or not, ``select`` (condition, value,
    other), and ``cast`` to the type.
    """

    name: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Call(Expression):
    """A call of a function that has one result and changes nothing."""

    function: "Function"
    operands: tuple[Expression, ...]


@dataclass(slots=True)
class Assign:
    """Assignment to a variable or to the state."""

    target: Variable | Load
    value: Expression


@dataclass(slots=True)
class CallStatement:
    """A call of a function whose results, if any, go to variables."""

    targets: list[Variable]
    function: "Function"
    operands: tuple[Expression, ...]


@dataclass(slots=True)
class If:
    """Two branches, the second of which may be empty."""

    test: Expression
    then: "Block"
    other: "Block"


@dataclass(slots=True)
class For:
    """A loop over whole numbers from ``start`` to before ``stop``; ``most`` is the largest number of passes."""

    variable: Variable
    start: Expression
    stop: Expression
    step: int
    body: "Block"
    most: int


@dataclass(slots=True)
class While:
    """A loop of at most ``most`` passes."""

    test: Expression
    body: "Block"
    most: int


@dataclass(slots=True)
class Return:
    """The end of a function."""

    values: tuple[Expression, ...]


@dataclass(slots=True)
class Jump:
    """``break`` or ``continue``."""

    kind: Literal["break", "continue"]


Statement = Assign | CallStatement | If | For | While | Return | Jump
Block = list[Statement]


@dataclass(slots=True, eq=False)
class Function:
    """A function of the program, after a Python function that was specialised."""

    name: str
    summary: str  # first line of its description
    parameters: list[Variable] = field(default_factory=list)  # those that are used
    results: tuple[Type, ...] = ()  # types
    body: Block = field(default_factory=list)
    reads_state: bool = False
    writes_state: bool = False


def children(expression: Expression) -> tuple[Expression, ...]:
    """Return the operands of an expression."""
    if isinstance(expression, (Operation, Call)):
        return expression.operands
    if isinstance(expression, Element) or (isinstance(expression, Load) and expression.index is not None):
        assert expression.index is not None
        return (expression.index,)
    return ()


def walk(expression: Expression) -> Iterator[Expression]:
    """Yield an expression and all its operands."""
    yield expression
    for child in children(expression):
        yield from walk(child)


def expressions(statement: Statement) -> tuple[Expression, ...]:
    """Return the expressions that a statement itself evaluates, without those of its blocks."""
    match statement:
        case Assign(target, value):
            return (*children(target), value)
        case CallStatement(_, _, operands):
            return operands
        case If(test) | While(test):
            return (test,)
        case For(_, start, stop):
            return (start, stop)
        case Return(values):
            return values
    return ()


def blocks(statement: Statement) -> tuple[Block, ...]:
    """Return the blocks inside a statement."""
    match statement:
        case If(_, then, other):
            return (then, other)
        case For(body=body) | While(body=body):
            return (body,)
    return ()


def targets(statement: Statement) -> tuple[str, ...]:
    """Return the names of the variables that a statement itself assigns."""
    match statement:
        case Assign(Variable(name=name)):
            return (name,)
        case CallStatement(variables):
            return tuple(each.name for each in variables)
        case For(Variable(name=name)):
            return (name,)
    return ()


def statements(block: Block) -> Iterator[Statement]:
    """Yield all statements of a block and of the blocks inside."""
    for statement in block:
        yield statement
        for inner in blocks(statement):
            yield from statements(inner)


def reads_state(expression: Expression) -> bool:
    """Return True if the value depends on the state."""
    return any(isinstance(e, Load) or (isinstance(e, Call) and e.function.reads_state) for e in walk(expression))


def without_unused(function: Function) -> None:
    """Remove what has no effect: assignments to variables that nothing reads, empty branches, unused parameters."""
    while True:
        read = {e.name for s in statements(function.body) for x in expressions(s) for e in walk(x)
                if isinstance(e, Variable)}  # fmt: skip
        before = sum(1 for _ in statements(function.body))
        function.body = _pruned(function.body, read)
        if sum(1 for _ in statements(function.body)) == before:
            function.parameters = [each for each in function.parameters if each.name in read]
            return


def _pruned(block: Block, read: set[str]) -> Block:
    kept: Block = []
    for statement in block:
        match statement:
            case Assign(Variable(name=name)) if name not in read:
                continue
            case CallStatement(variables, called) if not called.writes_state and not {v.name for v in variables} & read:
                continue
            case If(test, then, other):
                then, other = _pruned(then, read), _pruned(other, read)
                if not then and not other:
                    continue
                if not then:
                    test, then, other = Operation("bool", "not", (test,)), other, []
                statement = If(test, then, other)
            case For() | While():
                statement.body = _pruned(statement.body, read)
                if not statement.body and isinstance(statement, For):
                    continue
        kept.append(statement)
        if isinstance(statement, (Return, Jump)):
            break
    return kept
