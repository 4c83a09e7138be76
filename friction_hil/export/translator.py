"""Translation of compiled Python functions into a program (`ir`), specialised on everything that is constant.

The source of a kernel is its Python function; it is read as Python reads it, with the types of the compiled kernel.
An argument that is a constant is built in, and a branch that then cannot be reached disappears, as do variables that
nothing reads. What has no translation is refused with file and line.
"""

import ast
import inspect
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from friction_hil.export import arithmetic as math_of
from friction_hil.export import ir
from friction_hil.export.expressions import (
    Expressions,
    Translation,
    as_load,
    depends,
    jumps,
    names_outside,
    parsed,
    python_function,
    range_of,
)
from friction_hil.export.ir import Block, Constant, Expression, Function, Type, Variable
from friction_hil.export.values import (
    Known,
    Settings,
    Several,
    StateArray,
    StateRecord,
    TableArray,
    TranslationError,
)

_MOST_UNROLLED = 16  # passes of a loop that is written out


class Translator(Translation):
    """Translates kernels into the functions of one program."""

    def function(self, kernel: Any, arguments: Sequence[Any], name: str = "") -> tuple[Function, Any]:
        """Return the function for a kernel with these arguments, and what a call of it gives.

        Arguments that are variables become parameters; all others are built in. The second result is a known value,
        or types: None for no result, a type, or a tuple of types.
        """
        plain = python_function(kernel)
        key = (plain, tuple(map(_key, arguments)))
        if key not in self.functions:
            self.functions[key] = _Body(self, plain, arguments, name).translate()
        return self.functions[key]


def _key(value: Any) -> Any:
    """Return what distinguishes one specialisation from another."""
    match value:
        case Constant():
            return value.type, repr(value.value), value.name
        case Expression():
            return value.type, value.bounds
        case Several(values):
            return tuple(map(_key, values))
        case TableArray(table, begin):
            return table.name, _key(begin)
        case StateArray(path, begin):
            return "state", path, _key(begin)
        case StateRecord(path):
            return "state", path
        case Settings(record):
            return id(record)
        case Known(known):
            return id(known)
    return value


class _Body(Expressions):
    """The translation of one function for one set of arguments."""

    def __init__(self, translator: Translator, function: Any, arguments: Sequence[Any], name: str) -> None:
        self._translator = translator
        self._function = function
        source = python_function(translator.definitions.get(function, function))
        self._tree, self._file, self._before = parsed(source)
        self._outside = names_outside(source)
        self._arguments = arguments
        self._types: dict[str, Type] = {}
        self._carried: set[str] = set()  # variables that the innermost loop changes
        summary = (inspect.getdoc(function) or "").split("\n")[0].replace("`", "")
        self._result = Function(name or self._unique_name(), summary)

    def _unique_name(self) -> str:
        module = self._function.__module__.rpartition(".")[2]
        own = self._function.__name__.strip("_")
        name = own if own.startswith(module) else f"{module}_{own}"
        taken = {made.name for made, _ in self._translator.functions.values()}
        number = 2
        while name in taken:
            name = f"{module}_{own}_{number}"
            number += 1
        return name

    def translate(self) -> tuple[Function, Any]:
        """Translate until the types of all variables are settled."""
        while True:
            before = dict(self._types)
            self._temporaries = 0
            self._returned: list[Any] = []
            self._block: Block = []
            self._environment: dict[str, Any] = {}
            self._result.parameters = []
            self._bind()
            is_open = self._statements(self._tree.body)
            if is_open and self._returned:
                self._block.append(ir.Return(()))
            if self._types == before:
                break
        self._result.body = self._block
        outcome = self._outcome()
        ir.without_unused(self._result)
        everything = list(ir.statements(self._result.body))
        reads = [e for s in everything for e in ir.expressions(s)]
        calls = [s.function for s in everything if isinstance(s, ir.CallStatement)]
        stores = any(isinstance(s, ir.Assign) and isinstance(s.target, ir.Load) for s in everything)
        self._result.writes_state = stores or any(each.writes_state for each in calls)
        self._result.reads_state = (
            self._result.writes_state or any(map(ir.reads_state, reads)) or any(each.reads_state for each in calls)
        )
        return self._result, outcome

    def _bind(self) -> None:
        """Give the parameters their values; the variables among them become parameters of the result."""
        given = list(self._arguments)
        names = self._tree.args
        for each in names.args:
            self._environment[each.arg] = self._parameter(each.arg, given.pop(0))
        if names.vararg is not None:
            rest = [self._parameter(f"{names.vararg.arg}_{i}", value) for i, value in enumerate(given)]
            self._environment[names.vararg.arg] = Several(tuple(rest))
        elif given:
            raise TranslationError(f"{self._result.name}: too many arguments")

    def _parameter(self, name: str, value: Any) -> Any:
        if isinstance(value, Expression) and not isinstance(value, Constant):
            variable = Variable(value.type, name, bounds=value.bounds)
            self._result.parameters.append(variable)
            self._types[name] = math_of.united(self._types.get(name, value.type), value.type)
            if self._types[name] != value.type:
                raise TranslationError(f"{self._result.name}: {name} changes its type to {self._types[name]}")
            return variable
        if isinstance(value, (TableArray, StateArray)) and not isinstance(value.begin, Constant):
            begin = self._parameter(f"{name}_begin", value.begin)
            return TableArray(value.table, begin) if isinstance(value, TableArray) else StateArray(value.path, begin)
        return value

    def _outcome(self) -> Any:
        """Return what a call gives, and make all returns of the same type."""
        if not self._returned:
            return None
        first = self._returned[0]
        if isinstance(first, Constant) and all(first.is_same(each) for each in self._returned):
            for statement in ir.statements(self._result.body):
                if isinstance(statement, ir.Return):
                    statement.values = ()
            return first
        if not isinstance(first, (Expression, Several)):
            if any(each is not first for each in self._returned):
                raise self._refusal(self._tree, "it returns different things that are no numbers")
            return first
        rows = [each.values if isinstance(each, Several) else (each,) for each in self._returned]
        kinds = rows[0]
        types = tuple(
            [self._united([row[i].type for row in rows]) for i in range(len(kinds))],
        )
        self._result.results = types
        for statement in ir.statements(self._result.body):
            if isinstance(statement, ir.Return):
                statement.values = tuple(
                    math_of.cast(value, kind) for value, kind in zip(statement.values, types, strict=True)
                )
        bounds = [self._spanned([row[i] for row in rows]) for i in range(len(kinds))]
        results = tuple(zip(types, bounds, strict=True))
        return results if isinstance(first, Several) else results[0]

    @staticmethod
    def _united(types: list[Type]) -> Type:
        result = types[0]
        for each in types[1:]:
            result = math_of.united(result, each)
        return result

    # --- statements; each returns False if nothing after it can be reached

    def _statements(self, nodes: Sequence[ast.stmt]) -> bool:
        for node in nodes:
            method = getattr(self, f"_do_{type(node).__name__.lower()}", None)
            if method is None:
                raise self._refusal(node, f"{type(node).__name__} has no translation")
            try:
                is_open = method(node)
            except (IndexError, KeyError, ValueError, AttributeError) as error:
                raise self._refusal(node, str(error)) from error
            if not is_open:
                return False
        return True

    def _do_pass(self, node: ast.Pass) -> bool:
        return True

    def _do_expr(self, node: ast.Expr) -> bool:
        if not isinstance(node.value, ast.Constant):  # a docstring
            self._value(node.value)
        return True

    def _do_assign(self, node: ast.Assign) -> bool:
        value = self._value(node.value)
        for target in reversed(node.targets) if len(node.targets) > 1 else node.targets:
            self._assign(target, value)
        return True

    def _do_annassign(self, node: ast.AnnAssign) -> bool:
        if node.value is not None:
            self._assign(node.target, self._value(node.value))
        return True

    def _do_augassign(self, node: ast.AugAssign) -> bool:
        left = ast.copy_location(as_load(node.target), node)
        both = ast.copy_location(ast.BinOp(left, node.op, node.value), node)
        self._assign(node.target, self._value(both))
        return True

    def _assign(self, target: ast.expr, value: Any) -> None:
        if isinstance(target, ast.Tuple):
            names = {each.id for each in target.elts if isinstance(each, ast.Name)}
            is_stored = len(names) < len(target.elts)
            # all of them are computed before any is assigned
            values = [
                self._kept(each) if isinstance(each, Expression) and depends(each, names, is_stored) else each
                for each in self._unpacked(target, value)
            ]
            for each, one in zip(target.elts, values, strict=True):
                self._assign(each, one)
        elif isinstance(target, ast.Name):
            self._set(target.id, value)
        else:
            self._store(target, value)

    def _set(self, name: str, value: Any) -> None:
        if isinstance(value, Expression) and not isinstance(value, Constant):
            value = self._assigned(name, value)
        self._environment[name] = value

    def _store(self, target: ast.expr, value: Any) -> None:
        if not isinstance(value, Expression):
            raise self._refusal(target, "only a number can be stored")
        path, index = self._place(target)
        place = self._translator.state.target(path, index, value)
        if place is not None:
            self._block.append(ir.Assign(place, math_of.cast(value, place.type)))

    def _place(self, target: ast.expr) -> tuple[str, Expression | None]:
        if isinstance(target, ast.Attribute):
            record = self._value(target.value)
            if isinstance(record, StateRecord):
                return record.path + target.attr, None
        elif isinstance(target, ast.Subscript):
            array, index = self._value(target.value), self._number(target.slice)
            if isinstance(array, StateArray) and isinstance(index, Expression):
                return array.path, math_of.binary("+", array.begin, index)
        raise self._refusal(target, "only variables and the state can be changed")

    def _do_return(self, node: ast.Return) -> bool:
        value = None if node.value is None else self._value(node.value)
        if value is None:
            self._block.append(ir.Return(()))
            return False
        if isinstance(value, Several) and all(isinstance(each, Expression) for each in value.values):
            self._block.append(ir.Return(value.values))
        elif isinstance(value, Expression):
            self._block.append(ir.Return((value,)))
        self._returned.append(value)
        return False

    def _do_break(self, node: ast.Break) -> bool:
        self._flush(self._carried)
        self._block.append(ir.Jump("break"))
        return False

    def _do_continue(self, node: ast.Continue) -> bool:
        self._flush(self._carried)
        self._block.append(ir.Jump("continue"))
        return False

    def _do_if(self, node: ast.If) -> bool:
        test = math_of.truth(self._number(node.test))
        if isinstance(test, Constant):
            return self._statements(node.body if test.value else node.orelse)
        before = self._environment
        arms: list[tuple[Block, dict[str, Any], bool]] = []
        for body in (node.body, node.orelse):
            self._environment = dict(before)
            block, is_open = self._inside(partial(self._statements, body))
            arms.append((block, self._environment, is_open))
        self._block.append(ir.If(test, arms[0][0], arms[1][0]))
        self._environment = self._merged([(block, environment) for block, environment, is_open in arms if is_open])
        return any(is_open for _, _, is_open in arms)

    def _flush(self, names: set[str]) -> None:
        """Give the variables of the program the values of these names, at the end of a pass of a loop."""
        for name in sorted(names):
            value = self._environment.get(name)
            if isinstance(value, Expression):
                self._assigned(name, value)

    def _changed(self, nodes: Sequence[ast.stmt]) -> set[str]:
        """Return the names that exist and that a body assigns."""
        names = (each for node in nodes for each in ast.walk(node) if isinstance(each, ast.Name))
        return {each.id for each in names if isinstance(each.ctx, ast.Store)} & self._environment.keys()

    def _materialised(self, nodes: Sequence[ast.stmt]) -> set[str]:
        """Put what the body of a loop changes into variables; return their names."""
        changed = self._changed(nodes)
        for name in sorted(changed):
            value = self._environment[name]
            if not isinstance(value, Expression):
                raise self._refusal(nodes[0], f"{name} is no number, and changes in a loop")
            self._assigned(name, value)
            self._environment[name] = Variable(self._types[name], name)
        return changed

    def _loop(self, nodes: Sequence[ast.stmt], work: Callable[[], Any]) -> Block:
        outer = self._carried
        self._carried = self._materialised(nodes)
        after = dict(self._environment)

        def whole() -> None:
            if work():
                self._flush(self._carried)

        block, _ = self._inside(whole)
        for name in self._carried:
            after[name] = Variable(self._types[name], name)
        self._environment = after
        self._carried = outer
        return block

    def _do_while(self, node: ast.While) -> bool:
        most = self._translator.passes.get(self._function)
        if most is None or node.orelse:
            raise self._refusal(node, "the largest number of passes of this loop is not known")
        tests: list[Expression] = []

        def work() -> bool:
            tests.append(math_of.truth(self._number(node.test)))
            if self._block:
                raise self._refusal(node, "the condition of a loop must not change anything")
            return self._statements(node.body)

        body = self._loop(node.body, work)
        self._block.append(ir.While(tests[0], body, most))
        return True

    def _do_for(self, node: ast.For) -> bool:
        if not (isinstance(node.iter, ast.Call) and isinstance(node.iter.func, ast.Name) and not node.orelse):
            raise self._refusal(node, "only loops over a range have a translation")
        if node.iter.func.id != "range" or not isinstance(node.target, ast.Name):
            raise self._refusal(node, "only loops over a range have a translation")
        limits = [math_of.cast(self._number(each), "int") for each in node.iter.args]
        start, stop, step = range_of(limits)
        most = self._passes(node, start, stop, step)
        if most <= 0:
            return True
        name = node.target.id
        if isinstance(start, Constant) and isinstance(stop, Constant) and not jumps(node.body):
            counted = (self._environment.get(each) for each in self._changed(node.body))
            is_counting = any(isinstance(each, Constant) and each.type == "int" for each in counted)
            if most == 1 or (is_counting and most <= _MOST_UNROLLED):  # what is counted stays known
                for k in range(int(start.value), int(stop.value), step):
                    self._environment[name] = math_of.known(k)
                    if not self._statements(node.body):
                        return False
                return True
        ends = [each for each in (start.bounds, stop.bounds) if each is not None]
        bounds = None
        if len(ends) == 2:
            bounds = (ends[0][0], ends[1][1] - 1) if step > 0 else (ends[1][0] + 1, ends[0][1])
        stop = self._kept(stop)
        variable = Variable("int", name if name != "_" else self._temporary(), bounds=bounds)

        def work() -> bool:
            self._environment[name] = variable
            return self._statements(node.body)

        body = self._loop(node.body, work)
        self._environment.pop(name, None)
        self._block.append(ir.For(variable, start, stop, step, body, most))
        return True

    def _passes(self, node: ast.For, start: Expression, stop: Expression, step: int) -> int:
        first, last = (start, stop) if step > 0 else (stop, start)
        way = math_of.span(last)[1] - math_of.span(first)[0]
        if math.isfinite(way):
            return max(-(-int(way) // abs(step)), 0)
        most = self._translator.passes.get(self._function)
        if most is None:
            raise self._refusal(node, "the largest number of passes of this loop is not known")
        return most
