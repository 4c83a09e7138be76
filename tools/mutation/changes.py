"""Changes of a module's source, one at a time: comparisons, constants, conditions and returns. Pure.

A change is told apart by its function and its text before and after, not by its line: lines move.
"""

import ast
import copy
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType

_Function = ast.FunctionDef | ast.AsyncFunctionDef
_COMPILED = ("compiled", "inlined", "njit", "overload", "intrinsic")  # decorators of compiled kernels
_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
# What is only true at the very moment is no difference between times.
_OF_TIMES: dict[type[ast.cmpop], type[ast.cmpop]] = {ast.Lt: ast.Gt, ast.LtE: ast.Gt, ast.Gt: ast.Lt, ast.GtE: ast.Lt}
_TIME = re.compile(r"_n?s\b|_N?S\b")  # names of times end with their unit
_SMALL = 10  # below, an integer counts something; from here on one more would be hardly another time
_RETURNS: dict[str, float | int | str] = {"float": 0.0, "int": 0, "str": ""}  # by the annotation; bool: the opposite
_NOT_ITSELF = ("body", "orelse", "finalbody", "handlers", "cases", "annotation", "decorator_list", "args", "returns")
_WORDS = (ast.JoinedStr, ast.Raise, ast.Assert, ast.Import, ast.ImportFrom)  # messages, and what is no behaviour


@dataclass(frozen=True, slots=True)
class Change:
    """A change.

    Attributes
    ----------
    where : str
        Function with its class, or the constant of the module.
    line : int
    before, after : str
        The statement, without those that it contains.
    function : (str, int) or None
        Name and first line of the function whose code is replaced; None for a constant.
    """

    where: str
    line: int
    before: str
    after: str
    function: tuple[str, int] | None

    @property
    def identity(self) -> str:
        """What remains the same when lines move."""
        return f"{self.where}: {self.before} -> {self.after}"


def changes_of(source: str) -> list[Change]:
    """Return all changes of a module that make a difference in its text."""
    return list(_changes(ast.parse(source)))


def codes_of(source: str, number: int, file: str) -> list[CodeType]:
    """Return the code of all functions, and last that of the module, with one of its changes."""
    tree = ast.parse(source)
    next(itertools.islice(_changes(tree), number, None))  # the tree stays changed until the generator goes on
    code = compile(tree, file, "exec")
    return [*_codes(code), code]


def _changes(tree: ast.Module) -> Iterator[Change]:
    """Yield each change; the tree has it until the next one is asked for."""
    for statement in tree.body:
        if isinstance(statement, _Function):
            yield from _of_function(statement, statement.name)
        elif isinstance(statement, ast.ClassDef):
            for member in statement.body:
                if isinstance(member, _Function):
                    yield from _of_function(member, f"{statement.name}.{member.name}")
        elif isinstance(statement, ast.Assign | ast.AnnAssign) and _is_constant(statement):
            yield from _of_statement(statement, ast.unparse(_target(statement)), None)


def _codes(code: CodeType) -> Iterator[CodeType]:
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield each
            yield from _codes(each)


def _is_constant(statement: ast.Assign | ast.AnnAssign) -> bool:
    target = _target(statement)
    return isinstance(target, ast.Name) and target.id.isupper() and statement.value is not None


def _target(statement: ast.Assign | ast.AnnAssign) -> ast.expr:
    return statement.targets[0] if isinstance(statement, ast.Assign) else statement.target


def _of_function(function: _Function, where: str) -> Iterator[Change]:
    decorators = {part.id for each in function.decorator_list for part in ast.walk(each) if isinstance(part, ast.Name)}
    if decorators & set(_COMPILED):
        return
    # the code of a decorated function begins with its first decorator
    line = min([function.lineno, *(each.lineno for each in function.decorator_list)])
    for statement in _statements(function.body):
        yield from _of_statement(statement, where, (function.name, line), function.returns)


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    for statement in body:
        if isinstance(statement, _WORDS):
            continue
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            continue  # a docstring
        yield statement
        for name in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(statement, name, []))
        for part in (*getattr(statement, "handlers", ()), *getattr(statement, "cases", ())):
            yield from _statements(part.body)


def _of_statement(
    statement: ast.stmt, where: str, function: tuple[str, int] | None, returns: ast.expr | None = None
) -> Iterator[Change]:
    for parent, name, node in _expressions(statement):
        if node is getattr(statement, "value", None) and _is_first_time(statement):
            continue
        others = list(_others(node))
        if isinstance(statement, ast.Return) and node is statement.value:
            others += _other_return(node, returns)
        before = _head(statement)
        for other in others:
            _replace(parent, name, node, ast.fix_missing_locations(ast.copy_location(other, node)))
            yield Change(where, node.lineno, before, _head(statement), function)
            _replace(parent, name, other, node)


def _replace(parent: ast.AST, name: str, node: ast.expr, other: ast.expr) -> None:
    value = getattr(parent, name)
    setattr(parent, name, [other if each is node else each for each in value] if isinstance(value, list) else other)


def _expressions(parent: ast.AST) -> Iterator[tuple[ast.AST, str, ast.expr]]:
    """Yield the expressions of a statement itself, outside of messages, with where they are."""
    for name, value in ast.iter_fields(parent):
        if name in _NOT_ITSELF and isinstance(parent, ast.stmt | ast.ExceptHandler):
            continue
        for part in list(value) if isinstance(value, list) else [value]:
            if not isinstance(part, ast.AST) or isinstance(part, _WORDS) or _is_strict(part):
                continue
            if isinstance(part, ast.expr):
                yield parent, name, part
            yield from _expressions(part)


def _others(node: ast.expr) -> Iterator[ast.expr]:
    """Yield what may stand in the place of an expression."""
    if isinstance(node, ast.Compare):
        table = _OF_TIMES if _is_of_times(node) else _COMPARISONS
        for k, operator in enumerate(node.ops):
            other = table.get(type(operator), _COMPARISONS[type(operator)])()
            yield ast.Compare(node.left, [*node.ops[:k], other, *node.ops[k + 1 :]], node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "abs":
        yield node.args[0]
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        value = node.value
        is_count = isinstance(value, int) and abs(value) < _SMALL
        yield ast.Constant(value + 1 if is_count else 2 * value if value else 1.0)


def _is_first_time(statement: ast.stmt) -> bool:
    """Return True for ``self.next_ns = 0``: a nanosecond later is no other time."""
    if not isinstance(statement, ast.Assign) or not isinstance(statement.value, ast.Constant):
        return False
    return statement.value.value == 0 and all(_TIME.search(ast.unparse(each)) for each in statement.targets)


def _is_strict(part: ast.AST) -> bool:
    """Return True for ``strict=``, a check of the program by itself."""
    return isinstance(part, ast.keyword) and part.arg == "strict"


def _is_of_times(node: ast.Compare) -> bool:
    return all(_TIME.search(ast.unparse(side)) for side in (node.left, *node.comparators))


def _other_return(value: ast.expr, returns: ast.expr | None) -> Iterator[ast.expr]:
    kind = ast.unparse(returns) if returns is not None else ""
    if isinstance(value, ast.Constant | ast.Compare | ast.BoolOp | ast.UnaryOp):
        return
    if kind == "bool":
        yield ast.UnaryOp(ast.Not(), value)
    elif kind in _RETURNS:
        yield ast.Constant(_RETURNS[kind])


def _head(statement: ast.stmt) -> str:
    """Return a statement without those that it contains."""
    alone = copy.copy(statement)
    for name in ("body", "orelse", "finalbody", "handlers", "cases"):
        if hasattr(alone, name):
            setattr(alone, name, [ast.Pass()] if name == "body" else [])
    return ast.unparse(alone).splitlines()[0].strip()
