"""Expressions of Python, translated: the part of a kernel's translation that computes values."""

import ast
import inspect
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

from friction_hil.export import arithmetic as math_of
from friction_hil.export import ir
from friction_hil.export.ir import Block, Constant, Expression, Function, Type, Variable
from friction_hil.export.values import (
    Choice,
    Known,
    Settings,
    Several,
    State,
    StateArray,
    StateRecord,
    Table,
    TableArray,
    TranslationError,
)

_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%", ast.BitAnd: "&"}
_COMPARE = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


def python_function(kernel: Any) -> Any:
    """Return the Python function of a kernel."""
    return getattr(kernel, "py_func", kernel)


@cache
def parsed(function: Any) -> tuple[ast.FunctionDef, str, int]:
    """Return the syntax tree of a function, its file, and the number of lines before it."""
    lines, first = inspect.getsourcelines(function)
    tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    if not isinstance(tree, ast.FunctionDef):
        raise TranslationError(f"{function.__qualname__} is no plain function")
    return tree, inspect.getsourcefile(function) or "?", first - 1


@cache
def names_outside(function: Any) -> dict[str, Any]:
    """Return what the names that a function does not define itself stand for."""
    found = inspect.getclosurevars(function)
    return {**found.builtins, **found.globals, **found.nonlocals}


@dataclass(slots=True)
class Translation(ABC):
    """What the functions of one program are translated from, and those made so far."""

    state: State  # that the kernels change
    # kernels that a function of this package stands for: it takes and returns values
    intrinsics: Mapping[Any, Callable[..., Any]]
    definitions: Mapping[Any, Any]  # kernels whose source is that of another function
    passes: Mapping[Any, int]  # largest number of passes of the loops of a kernel that depends on data
    built_in: Collection[Any] = ()  # kernels of a single expression that takes the place of a call
    functions: dict[Any, tuple[Function, Any]] = field(default_factory=dict)  # made so far, by what they were made of
    tables: dict[Any, Table] = field(default_factory=dict)

    def table(self, name: str, values: Any) -> Table:
        """Return the constant table of an array of the settings."""
        if name not in self.tables:
            self.tables[name] = Table(name, values)
        return self.tables[name]

    @abstractmethod
    def function(self, kernel: Any, arguments: Sequence[Any]) -> tuple[Function, Any]:
        """Return the function for a kernel with these arguments, and what a call of it gives."""

    def operands(self, function: Function, kernel: Any, arguments: Sequence[Any]) -> list[Expression]:
        """Return what a call of the function for a kernel with these arguments passes to its parameters."""
        plain = python_function(kernel)
        tree, _, _ = parsed(python_function(self.definitions.get(plain, plain)))
        names = [each.arg for each in tree.args.args]
        if tree.args.vararg is not None:
            names += [f"{tree.args.vararg.arg}_{i}" for i in range(len(arguments) - len(names))]
        kept = {each.name for each in function.parameters}
        found: list[Expression] = []
        for name, value in zip(names, arguments, strict=True):
            is_part = isinstance(value, (TableArray, StateArray))
            given = value.begin if is_part else value
            is_variable = isinstance(given, Expression) and not isinstance(given, Constant)
            if is_variable and (f"{name}_begin" if is_part else name) in kept:
                found.append(given)
        return found


class Expressions:
    """Translates the expressions of one function; statements that they need are added to the present block."""

    _translator: Translation
    _function: Any
    _file: str
    _before: int
    _outside: dict[str, Any]
    _types: dict[str, Type]  # of each variable of the program
    _block: Block
    _environment: dict[str, Any]  # what each name stands for
    _temporaries: int

    def _refusal(self, node: Any, why: str) -> TranslationError:
        line = self._before + getattr(node, "lineno", 1)
        return TranslationError(f"{self._file}:{line}: in {self._function.__name__}: {why}")

    def _inside(self, work: Callable[[], Any]) -> tuple[Block, Any]:
        """Collect the statements of ``work`` in a block of their own."""
        outer, self._block = self._block, []
        try:
            result = work()
            return self._block, result
        finally:
            self._block = outer

    def _merged(self, arms: list[tuple[Block, dict[str, Any]]]) -> dict[str, Any]:
        """Return what is known after branches; values that differ between them get into variables."""
        if len(arms) < 2:
            return arms[0][1] if arms else {}
        result: dict[str, Any] = {}
        for name in [each for each in arms[0][1] if each in arms[1][1]]:  # in an order that no hash decides
            first, second = (environment[name] for _, environment in arms)
            if is_same(first, second):
                result[name] = first
            elif isinstance(first, Expression) and isinstance(second, Expression):
                for block, environment in arms:
                    self._block, outer = block, self._block
                    self._assigned(name, environment[name])
                    self._block = outer
                bounds = self._spanned([first, second])
                result[name] = Variable(self._types[name], name, bounds=bounds)
            # what differs and is no number does not exist after the branches
        return result

    def _assigned(self, name: str, value: Expression) -> Variable:
        """Assign a value to the variable ``name`` of the program."""
        kind = math_of.united(self._types.get(name, value.type), value.type)
        self._types[name] = kind
        variable = Variable(kind, name, bounds=value.bounds)
        if value != variable:
            self._block.append(ir.Assign(variable, math_of.cast(value, kind)))
        return variable

    def _unpacked(self, node: ast.expr, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, Several):
            raise self._refusal(node, "this is no tuple")
        return value.values

    @staticmethod
    def _spanned(values: list[Expression]) -> ir.Bounds | None:
        known = [each.bounds for each in values if each.bounds is not None]
        if len(known) < len(values):
            return None
        return min(low for low, _ in known), max(high for _, high in known)

    def _number(self, node: ast.expr) -> Expression:
        value = self._value(node)
        if isinstance(value, Choice):
            value = math_of.selected(value.test, value.then, value.other)
        if not isinstance(value, Expression):
            raise self._refusal(node, "this is no number")
        return value

    def _value(self, node: ast.expr) -> Any:
        method = getattr(self, f"_see_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._refusal(node, f"{type(node).__name__} has no translation")
        return method(node)

    def _numbers(self, nodes: Sequence[ast.expr]) -> list[Expression]:
        values = [
            math_of.selected(each.test, each.then, each.other) if isinstance(each, Choice) else each
            for each in self._values(nodes)
        ]
        for node, value in zip(nodes, values, strict=True):
            if not isinstance(value, Expression):
                raise self._refusal(node, "this is no number")
        return values

    def _values(self, nodes: Sequence[ast.expr]) -> list[Any]:
        """Evaluate operands in their order, also where a later one changes what an earlier one has read."""
        values: list[Any] = []
        for node in nodes:
            before = len(self._block)
            value = self._value(node)
            if len(self._block) > before:
                later, self._block = self._block[before:], self._block[:before]
                values = [
                    self._kept(each) if isinstance(each, Expression) and ir.reads_state(each) else each
                    for each in values
                ]
                self._block += later
            values.append(value)
        return values

    def _temporary(self) -> str:
        self._temporaries += 1
        return f"t{self._temporaries}"

    def _kept(self, value: Expression) -> Expression:
        """Put a value into a variable of its own, unless it is a constant."""
        if isinstance(value, Constant):
            return value
        return self._assigned(self._temporary(), value)

    def _see_constant(self, node: ast.Constant) -> Any:
        if not isinstance(node.value, (bool, int, float)):
            raise self._refusal(node, f"{node.value!r} has no translation")
        return math_of.known(node.value)

    def _see_name(self, node: ast.Name) -> Any:
        if node.id in self._environment:
            return self._environment[node.id]
        if node.id not in self._outside:
            raise self._refusal(node, f"{node.id} has no single meaning here")
        return _as_value(self._outside[node.id])

    def _see_attribute(self, node: ast.Attribute) -> Any:
        owner = self._value(node.value)
        if isinstance(owner, Known):
            return _as_value(getattr(owner.value, node.attr))
        if isinstance(owner, StateRecord):
            return self._of_state(owner.path + node.attr)
        if isinstance(owner, Settings):
            value = owner.record[node.attr]
            if getattr(value, "dtype", None) is not None and value.dtype.names:
                return Settings(value)
            if getattr(value, "shape", ()):
                return TableArray(self._translator.table(node.attr, value), math_of.known(0))
            return Constant("real", float(value), name=node.attr)
        raise self._refusal(node, f"{node.attr} has no translation")

    def _of_state(self, path: str) -> Any:
        fields = self._translator.state
        if fields.is_array(path):
            return StateArray(path, math_of.known(0))
        return fields.load(path, None) if fields.is_scalar(path) else StateRecord(f"{path}_")

    def _see_subscript(self, node: ast.Subscript) -> Any:
        array, index = self._values([node.value, node.slice])
        if isinstance(index, Choice):
            index = math_of.selected(index.test, index.then, index.other)
        if isinstance(array, Known) and isinstance(index, Constant):
            return _as_value(array.value[int(index.value)])
        if isinstance(array, Several) and isinstance(index, Constant):
            return array.values[int(index.value)]
        if isinstance(array, Choice) and isinstance(index, Expression):
            then, other = (self._element(node, each, index) for each in (array.then, array.other))
            return math_of.selected(array.test, then, other)
        return self._element(node, array, index)

    def _element(self, node: ast.AST, array: Any, index: Any) -> Expression:
        if isinstance(index, Expression) and isinstance(array, (TableArray, StateArray)):
            at = math_of.binary("+", array.begin, math_of.cast(index, "int"))
            if isinstance(array, TableArray):
                return array.table.at(at)
            return self._translator.state.load(array.path, at)
        raise self._refusal(node, "this has no elements")

    def _see_tuple(self, node: ast.Tuple) -> Several:
        return Several(tuple(self._values(node.elts)))

    def _see_binop(self, node: ast.BinOp) -> Expression:
        a, b = self._numbers([node.left, node.right])
        if isinstance(node.op, ast.Pow):
            return math_of.function("pow", [a, b])
        if type(node.op) not in _BINARY:
            raise self._refusal(node, f"{type(node.op).__name__} has no translation")
        return math_of.binary(_BINARY[type(node.op)], a, b)

    def _see_unaryop(self, node: ast.UnaryOp) -> Expression:
        value = self._number(node.operand)
        if isinstance(node.op, ast.USub):
            return math_of.negative(value)
        if isinstance(node.op, ast.Not):
            return math_of.inverted(value)
        raise self._refusal(node, f"{type(node.op).__name__} has no translation")

    def _see_compare(self, node: ast.Compare) -> Expression:
        values = self._numbers([node.left, *node.comparators])
        results = [math_of.compared(_COMPARE[type(op)], values[i], values[i + 1]) for i, op in enumerate(node.ops)]
        return math_of.joined("and", results)

    def _see_boolop(self, node: ast.BoolOp) -> Expression:
        name = "and" if isinstance(node.op, ast.And) else "or"
        values: list[Expression] = []
        for each in node.values:
            before = len(self._block)
            values.append(self._number(each))
            if values[1:] and len(self._block) > before:
                raise self._refusal(each, "a condition that is not always evaluated must not change anything")
            if isinstance(values[-1], Constant) and bool(values[-1].value) == (name == "or"):
                return math_of.truth(values[-1])  # whatever stands before it
        return math_of.joined(name, values)

    def _see_ifexp(self, node: ast.IfExp) -> Any:
        test = math_of.truth(self._number(node.test))
        if isinstance(test, Constant):
            return self._value(node.body if test.value else node.orelse)
        then_block, then = self._inside(lambda: self._value(node.body))
        other_block, other = self._inside(lambda: self._value(node.orelse))
        return self._chosen(test, (then_block, then), (other_block, other))

    def _chosen(self, test: Expression, then: tuple[Block, Any], other: tuple[Block, Any]) -> Any:
        """Return one of two values, each with the statements that compute it."""
        if not then[0] and not other[0]:
            if is_same(then[1], other[1]):
                return then[1]
            if isinstance(then[1], Constant) and isinstance(other[1], Constant) and then[1].type == "int":
                return Choice(self._kept(test), then[1], other[1])
            return math_of.selected(test, then[1], other[1])
        name = self._temporary()
        environments = [{name: value} for _, value in (then, other)]
        self._block.append(ir.If(test, then[0], other[0]))
        return self._merged([(then[0], environments[0]), (other[0], environments[1])])[name]

    def _see_call(self, node: ast.Call) -> Any:
        if node.keywords:
            raise self._refusal(node, "arguments by name have no translation")
        plain = [each.value if isinstance(each, ast.Starred) else each for each in node.args]
        callee, *given = self._values([node.func, *plain])
        arguments: list[Any] = []
        for each, value in zip(node.args, given, strict=True):
            arguments += self._unpacked(node, value) if isinstance(each, ast.Starred) else [value]
        if not isinstance(callee, Known):
            raise self._refusal(node, "this cannot be called")
        return self._called(node, callee.value, arguments)

    def _called(self, node: ast.Call, kernel: Any, arguments: list[Any]) -> Any:
        for k, argument in enumerate(arguments):
            if isinstance(argument, Choice):  # one call for each, so that in each everything is known
                before, after = arguments[:k], arguments[k + 1 :]
                ways = [
                    self._inside(partial(self._called, node, kernel, [*before, way, *after]))
                    for way in (argument.then, argument.other)
                ]
                if isinstance(ways[0][1], (TableArray, StateArray)):
                    return Choice(argument.test, ways[0][1], ways[1][1])
                return self._chosen(argument.test, ways[0], ways[1])
        intrinsic = self._translator.intrinsics.get(kernel) if kernel.__hash__ is not None else None
        if intrinsic is not None:
            return intrinsic(*arguments)
        plain = python_function(kernel)
        if not inspect.isfunction(self._translator.definitions.get(plain, plain)):
            raise self._refusal(node, f"{getattr(kernel, '__name__', kernel)} has no translation")
        function, outcome = self._translator.function(kernel, arguments)
        operands = self._translator.operands(function, kernel, arguments)
        return self._result_of(kernel, function, outcome, operands)

    def _result_of(self, kernel: Any, function: Function, outcome: Any, operands: list[Expression]) -> Any:
        is_number = isinstance(outcome, tuple) and isinstance(outcome[0], str)
        if outcome is None or isinstance(outcome, Constant) or not isinstance(outcome, tuple):
            if function.writes_state:
                self._block.append(ir.CallStatement([], function, tuple(operands)))
            return outcome
        if is_number and not function.writes_state:
            body = function.body
            if (
                len(body) == 1
                and isinstance(body[0], ir.Return)
                and python_function(kernel) in self._translator.built_in
            ):
                given = dict(zip((each.name for each in function.parameters), operands, strict=True))
                return math_of.substituted(body[0].values[0], given)
            return ir.Call(outcome[0], function, tuple(operands), bounds=outcome[1])
        kinds = [outcome] if is_number else list(outcome)
        variables = []
        for kind, bounds in kinds:
            name = self._temporary()
            self._types[name] = kind
            variables.append(Variable(kind, name, bounds=bounds))
        self._block.append(ir.CallStatement(variables, function, tuple(operands)))
        return variables[0] if is_number else Several(tuple(variables))


def depends(value: Expression, names: set[str], is_stored: bool) -> bool:
    """Return True if a value may change when variables of these names, or also the state, do."""
    return (is_stored and ir.reads_state(value)) or any(
        isinstance(e, Variable) and e.name in names for e in ir.walk(value)
    )


def _as_value(value: Any) -> Any:
    if isinstance(value, (Settings, StateRecord)):
        return value
    return math_of.known(value) if isinstance(value, (bool, int, float)) else Known(value)


@cache
def as_load(node: ast.expr) -> ast.expr:
    """Return the target of an assignment as an expression; sources are read once, and so are their nodes."""
    return ast.parse(ast.unparse(node), mode="eval").body


def is_same(a: Any, b: Any) -> bool:
    """Return True for two values that are the same in any case."""
    if isinstance(a, Constant):
        return a.is_same(b)
    return a is b or (type(a) is type(b) and a == b)


def range_of(limits: list[Expression]) -> tuple[Expression, Expression, int]:
    """Return start, stop and step of a range with these arguments."""
    if len(limits) == 1:
        return math_of.known(0), limits[0], 1
    step = limits[2] if len(limits) == 3 else math_of.known(1)
    if not isinstance(step, Constant):
        raise ValueError("the step of a range must be constant")
    return limits[0], limits[1], int(step.value)


def jumps(nodes: Sequence[ast.stmt]) -> bool:
    """Return True if a loop of these statements can end early."""
    return any(isinstance(each, (ast.Break, ast.Continue)) for node in nodes for each in ast.walk(node))
