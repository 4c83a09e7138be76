"""A program for languages that know less than C: IEC 61131-3 Structured Text and Modelica.

They have no NaN, may stop at a division by zero or an overflow, evaluate both operands of ``and`` and ``or``, and have
no conditional expression that every implementation understands. Here a number that may be unknown gets a flag beside
it, which says whether it is known; infinity becomes `strict_library.UNLIMITED`; conditional expressions become
branches. What an operation does with NaN in C, the flags do here: a comparison with an unknown number is false.

What is left are assignments, branches, loops, calls and returns, with the operators + - * / neg < <= > >= == != and or
not, div and mod (of whole numbers, towards zero), cast (to a number), truncate (to a whole number), and the functions
min, max, fabs, sin, cos, exp, log, sqrt and pow. All numbers are double precision.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache

from friction_hil.compensator import INPUTS
from friction_hil.export import ir, strict_library
from friction_hil.export.arithmetic import binary, is_number, known
from friction_hil.export.ir import Block, Constant, Expression, Function, Operation, Type, Variable
from friction_hil.export.kernels import Program, called
from friction_hil.export.strict_library import UNLIMITED
from friction_hil.export.values import Table

UNKNOWN = 1e30  # an input that is not connected
PLAUSIBLE = 1e16  # numbers from here on, and NaN where there is one, are unknown
# inputs that may be unknown
OPTIONAL = {
    "model": ("temperature",),
    "compensator": tuple(name for name in INPUTS if name not in ("cycle", "is_fresh", "is_enabled")),
}
LARGEST_WHOLE = 2.0e9  # of a number that is made a whole number
_TRUE, _FALSE = known(True), known(False)


@dataclass(frozen=True, slots=True)
class StrictField:
    """A field of the state: its type and the values it begins with."""

    name: str
    type: Type
    initial: tuple[float, ...]
    is_array: bool


@dataclass(frozen=True, slots=True)
class StrictProgram:
    """A step in the narrow sense.

    Attributes
    ----------
    entry : Function
    inputs : tuple of Variable
        What the parameters of the entry are called outside, in their order; see `flag` for the names of flags.
    functions : tuple of Function
        In an order in which none calls a later one.
    fields : tuple of StrictField
    tables : tuple of Table
    """

    entry: Function
    inputs: tuple[Variable, ...]
    functions: tuple[Function, ...]
    fields: tuple[StrictField, ...]
    tables: tuple[Table, ...]


@dataclass(slots=True)
class _Findings:
    """What may be unknown; it grows until a translation finds nothing new."""

    variables: set[tuple[Function, str]] = field(default_factory=set)
    results: set[tuple[Function, int]] = field(default_factory=set)
    fields: set[str] = field(default_factory=set)

    def size(self) -> int:
        return len(self.variables) + len(self.results) + len(self.fields)


def flag(name: str) -> str:
    """Return the name of the flag of a number."""
    return f"{name}_known"


def strict(program: Program, unknown: Iterable[str]) -> StrictProgram:
    """Return a program in the narrow sense; the inputs named by ``unknown`` have a flag if it matters."""
    found, unread = _Findings(), set[tuple[Function, str]]()
    given = {each.name for each in program.operands} & set(unknown)
    pairs = zip(program.entry.parameters, program.operands, strict=True)
    found.variables |= {(program.entry, inner.name) for inner, outer in pairs if outer.name in given}
    while True:  # first what may be unknown, then what nobody asks for
        size, unused = found.size(), len(unread)
        whole = _Whole(found, unread)
        for function in program.functions:
            whole.made[function] = Function(function.name, function.summary)
        for function in program.functions:
            _Lowering(whole, function).run()
        if found.size() == size:
            unread |= whole.unread()
            if len(unread) == unused:
                break
    entry = whole.made[program.entry]
    pairs = zip(program.entry.parameters, program.operands, strict=True)
    names = {_given(program.entry, inner.name): outer.name for inner, outer in pairs}
    names |= {flag(inner): flag(outer) for inner, outer in names.items()}
    inputs = tuple(Variable(each.type, names[each.name]) for each in entry.parameters)
    fields = []
    for name, one in program.state.fields.items():
        if one.is_used:
            values = tuple(map(float, one.initial[: one.extent]))
            clean = tuple(_finite(each) for each in values)
            fields.append(StrictField(name, "real", clean, one.is_array))
            if name in found.fields:
                flags = tuple(float(not math.isnan(each)) for each in values)
                fields.append(StrictField(flag(name), "bool", flags, one.is_array))
    return StrictProgram(entry, inputs, tuple(called(entry)), tuple(fields), program.tables)


@cache
def _changed(function: Function) -> frozenset[str]:
    """Return the parameters that a function of the program in C assigns: here they are copied first."""
    return frozenset({each.name for each in function.parameters} & _assigned(function.body))


def _given(function: Function, name: str) -> str:
    """Return the name of the parameter for one of the program in C."""
    return f"{name}_given" if name in _changed(function) else name


def _finite(value: float) -> float:
    if math.isnan(value):
        return 0.0
    return math.copysign(UNLIMITED, value) if math.isinf(value) else value


@dataclass(slots=True)
class _Whole:
    """One pass over all functions."""

    found: _Findings
    skipped: set[tuple[Function, str]]
    made: dict[Function, Function] = field(default_factory=dict)

    def unread(self) -> set[tuple[Function, str]]:
        """Return the parameters that no statement reads."""
        result = set()
        for function, made in self.made.items():
            read = {e.name for s in ir.statements(made.body) for x in ir.expressions(s) for e in ir.walk(x)
                    if isinstance(e, Variable)}  # fmt: skip
            result |= {(function, each.name) for each in made.parameters if each.name not in read}
        return result


def _both(a: Expression, b: Expression) -> Expression:
    return _joined("and", a, b)


def _joined(name: str, a: Expression, b: Expression) -> Expression:
    """Return ``and`` or ``or``; a part that is known disappears."""
    decisive = name == "or"
    for one, other in ((a, b), (b, a)):
        if isinstance(one, Constant):
            return one if bool(one.value) == decisive else other
    return a if a == b else Operation("bool", name, (a, b))


def _inverted(value: Expression) -> Expression:
    if isinstance(value, Constant):
        return known(not value.value)
    return Operation("bool", "not", (value,))


class _Lowering:
    """The translation of one function; a pair is a value and the condition that it is known."""

    def __init__(self, whole: _Whole, function: Function) -> None:
        self._whole, self._old, self._new = whole, function, whole.made[function]
        self._certain: set[str] = set()  # variables that are known here, whatever they are elsewhere
        self._out: Block = []
        self._count = 0

    def run(self) -> None:
        """Fill the new function."""
        old, new, found = self._old, self._new, self._whole.found
        copies: Block = []
        for each in old.parameters:
            own, given = Variable(_type(each.type), each.name), Variable(_type(each.type), _given(old, each.name))
            pairs = [(own, given)]
            if (old, each.name) in found.variables:
                pairs.append((Variable("bool", flag(own.name)), Variable("bool", flag(given.name))))
            for variable, parameter in pairs:
                if (old, parameter.name) not in self._whole.skipped:
                    new.parameters.append(parameter)
                    if variable != parameter:
                        copies.append(ir.Assign(variable, parameter))
        flags: list[Type] = ["bool" for i in range(len(old.results)) if (old, i) in found.results]
        new.results = (*map(_type, old.results), *flags)
        new.reads_state, new.writes_state = old.reads_state, old.writes_state
        new.body = [*copies, *self._block(old.body)]
        kept = list(new.parameters)
        ir.without_unused(new)
        new.parameters = kept

    # --- statements

    def _block(self, block: Block) -> Block:
        outer, self._out = self._out, []
        try:
            for statement in block:
                self._statement(statement)
            return self._out
        finally:
            self._out = outer

    def _inside(self, work: Callable[[], object], certain: set[str]) -> tuple[Block, set[str]]:
        """Return the statements of some work, for which more is certain, and what is certain after it."""
        outer, before = self._out, self._certain
        self._out, self._certain = [], before | certain
        try:
            work()
            return self._out, self._certain
        finally:
            self._out, self._certain = outer, before

    def _statement(self, statement: ir.Statement) -> None:
        match statement:
            case ir.Assign(Variable(name=name) as target, value):
                self._into(Variable(_type(target.type), name), value)
            case ir.Assign(ir.Load(field=name, index=index), value):
                self._store(name, index, value)
            case ir.CallStatement(targets, function, operands):
                self._call(list(targets), function, operands)
            case ir.If(test, then, other):
                condition = self._value(test)
                yes, after_yes = self._inside(lambda: self._extend(then), _facts(test, True))
                no, after_no = self._inside(lambda: self._extend(other), _facts(test, False))
                self._branch(condition, yes, no)
                open_ends = [a for b, a in ((yes, after_yes), (no, after_no)) if not _is_closed(b)]
                self._certain = set.intersection(*open_ends) if open_ends else self._certain
            case ir.For(variable, start, stop, step, body, most):
                first, end = self._value(start), self._value(stop)
                self._certain -= _assigned(body)
                inner, _ = self._inside(lambda: self._extend(body), set())
                self._out.append(ir.For(Variable("int", variable.name), first, end, step, inner, most))
            case ir.While(test, body, most):
                self._while(test, body, most)
            case ir.Return(values):
                self._return(values)
            case ir.Jump():
                self._out.append(statement)

    def _extend(self, block: Block) -> None:
        for statement in block:
            self._statement(statement)

    def _branch(self, condition: Expression, yes: Block, no: Block) -> None:
        if isinstance(condition, Constant):
            self._out += yes if condition.value else no
        elif yes or no:
            test = condition if yes else _inverted(condition)
            self._out.append(ir.If(test, *((yes, no) if yes else (no, []))))

    def _while(self, test: Expression, body: Block, most: int) -> None:
        self._certain -= _assigned(body)
        conditions: list[Expression] = []
        before, _ = self._inside(lambda: conditions.append(self._value(test)), set())
        inner, _ = self._inside(lambda: self._extend(body), _facts(test, True))
        if before:
            leave = ir.If(_inverted(conditions[0]), [ir.Jump("break")], [])
            self._out.append(ir.While(_TRUE, [*before, leave, *inner], most))
        else:
            self._out.append(ir.While(conditions[0], inner, most))

    def _return(self, values: tuple[Expression, ...]) -> None:
        pairs = [self._pair(each) for each in values]
        found = self._whole.found
        for i, (_, is_known) in enumerate(pairs):
            if is_known != _TRUE:
                found.results.add((self._old, i))
        flags = [is_known for i, (_, is_known) in enumerate(pairs) if (self._old, i) in found.results]
        self._out.append(ir.Return((*(value for value, _ in pairs), *flags)))

    def _into(self, target: Variable, value: Expression) -> None:
        """Assign a value to a variable."""
        if isinstance(value, Operation) and value.name == "select":
            test, then, other = value.operands
            condition = self._value(test)
            yes, after_yes = self._inside(lambda: self._into(target, then), _facts(test, True))
            no, after_no = self._inside(lambda: self._into(target, other), _facts(test, False))
            self._branch(condition, yes, no)
            self._certain = (after_yes & after_no & {target.name}) | (self._certain - {target.name})
            return
        self._assign(target, *self._pair(value))

    def _assign(self, target: Variable, value: Expression, is_known: Expression) -> None:
        name, found = target.name, self._whole.found
        if is_known != _TRUE:
            found.variables.add((self._old, name))
        has_flag = (self._old, name) in found.variables
        if value != target:
            self._out.append(ir.Assign(target, value))
        if has_flag and is_known != Variable("bool", flag(name)):
            self._out.append(ir.Assign(Variable("bool", flag(name)), is_known))
        if is_known == _TRUE:
            self._certain.add(name)
        else:
            self._certain.discard(name)

    def _store(self, name: str, index: Expression | None, value: Expression) -> None:
        at = None if index is None else self._value(index)
        number, is_known = self._pair(value)
        found = self._whole.found
        if is_known != _TRUE:
            found.fields.add(name)
        self._out.append(ir.Assign(ir.Load("real", name, at), number))
        if name in found.fields:
            self._out.append(ir.Assign(ir.Load("bool", flag(name), at), is_known))

    def _operands(self, function: Function, operands: Iterable[Expression]) -> tuple[Expression, ...]:
        given: list[Expression] = []
        found, skipped = self._whole.found, self._whole.skipped
        for parameter, operand in zip(function.parameters, operands, strict=True):
            value, is_known = self._pair(operand)
            if is_known != _TRUE:
                found.variables.add((function, parameter.name))
            name = _given(function, parameter.name)
            if (function, name) not in skipped:
                given.append(value)
            if (function, parameter.name) in found.variables and (function, flag(name)) not in skipped:
                given.append(is_known)
        return tuple(given)

    def _call(self, targets: list[Variable], function: Function, operands: Iterable[Expression]) -> None:
        given, found = self._operands(function, operands), self._whole.found
        flags = []
        for i, each in enumerate(targets):
            self._certain.discard(each.name)
            if (function, i) in found.results:
                found.variables.add((self._old, each.name))
                flags.append(Variable("bool", flag(each.name)))
            else:
                self._certain.add(each.name)
        own = [Variable(_type(each.type), each.name) for each in targets]
        self._out.append(ir.CallStatement([*own, *flags], self._whole.made[function], given))
        for i, each in enumerate(targets):
            if (function, i) not in found.results and (self._old, each.name) in found.variables:
                self._out.append(ir.Assign(Variable("bool", flag(each.name)), _TRUE))

    # --- expressions

    def _temporary(self, kind: Type) -> Variable:
        self._count += 1
        return Variable(kind, f"u{self._count}")

    def _value(self, expression: Expression) -> Expression:
        return self._pair(expression)[0]

    def _pair(self, expression: Expression) -> tuple[Expression, Expression]:
        match expression:
            case Constant():
                return self._constant(expression)
            case Variable(name=name):
                is_flagged = (self._old, name) in self._whole.found.variables and name not in self._certain
                flagged = Variable("bool", flag(name)) if is_flagged else _TRUE
                return Variable(_type(expression.type), name, bounds=expression.bounds), flagged
            case ir.Load(field=name, index=index):
                at = None if index is None else self._value(index)
                is_known: Expression = ir.Load("bool", flag(name), at) if name in self._whole.found.fields else _TRUE
                return ir.Load("real", name, at), is_known
            case ir.Element(table=table, index=index):
                return ir.Element("real", table, self._value(index)), _TRUE
            case ir.Call(function=function, operands=operands):
                return self._called(expression.type, function, operands)
            case Operation():
                return self._operation(expression)
        raise TypeError(expression)

    @staticmethod
    def _constant(one: Constant) -> tuple[Expression, Expression]:
        if not is_number(one.type):
            return one, _TRUE
        return Constant("real", _finite(one.value), name=one.name), known(not math.isnan(one.value))

    def _called(self, kind: Type, function: Function, operands: Iterable[Expression]) -> tuple[Expression, Expression]:
        if (function, 0) not in self._whole.found.results:
            return ir.Call(_type(kind), self._whole.made[function], self._operands(function, operands)), _TRUE
        result = self._temporary(_type(kind))
        self._call([result], function, operands)
        return result, Variable("bool", flag(result.name))

    def _operation(self, one: Operation) -> tuple[Expression, Expression]:
        name, operands = one.name, one.operands
        if name == "select":
            result = self._temporary(_type(one.type))
            self._into(result, one)
            return self._pair(result)
        if name in ("and", "or"):
            return self._condition(name, *operands), _TRUE
        if name in ("//", "%", "&"):
            return self._of_whole_numbers(name, *operands), _TRUE
        pairs = [self._pair(each) for each in operands]
        values = tuple(value for value, _ in pairs)
        all_known: Expression = _TRUE
        for _, is_known in pairs:
            all_known = _both(all_known, is_known)
        match name:
            case "not":
                return _inverted(values[0]), _TRUE
            case "isnan":
                return _inverted(all_known), _TRUE
            case "isfinite":
                size = Operation("real", "fabs", values)
                return _both(all_known, Operation("bool", "<", (size, Constant("real", UNLIMITED)))), _TRUE
            case "<" | "<=" | ">" | ">=" | "==":
                return _both(all_known, Operation("bool", name, values)), _TRUE
            case "!=":
                return _joined("or", _inverted(all_known), Operation("bool", name, values)), _TRUE
            case "cast":
                return self._cast(values[0], one.type), all_known
            case "min" | "max":
                return self._extreme(one, pairs)
            case "/":
                return strict_library.quotient(*values), all_known
            case "+" | "-" | "*" | "neg" | "fabs":
                return Operation(_type(one.type), name, values, bounds=one.bounds), all_known
        return strict_library.value(name, values), all_known

    def _condition(self, name: str, first: Expression, second: Expression) -> Expression:
        """Return ``and`` or ``or``; where the second must not be evaluated in any case, by a branch."""
        a = self._value(first)
        results: list[Expression] = []
        block, _ = self._inside(lambda: results.append(self._value(second)), _facts(first, name == "and"))
        b = results[0]
        if not block and not _is_risky(b):
            return _joined(name, a, b)
        result = self._temporary("bool")
        self._out.append(ir.Assign(result, a))
        test = result if name == "and" else _inverted(result)
        self._out.append(ir.If(test, [*block, ir.Assign(result, b)], []))
        return result

    def _cast(self, value: Expression, kind: Type) -> Expression:
        if value.type == _type(kind):
            return value
        if value.type == "bool":
            result = self._temporary(_type(kind))
            ends = (known(1.0), known(0.0)) if is_number(kind) else (known(1), known(0))
            self._out.append(ir.If(value, [ir.Assign(result, ends[0])], [ir.Assign(result, ends[1])]))
            return result
        if is_number(kind):
            return Operation("real", "cast", (value,))
        if kind == "bool":
            zero = known(0) if value.type == "int" else known(0.0)
            return Operation("bool", "!=", (value, zero))
        least, most = Constant("real", -LARGEST_WHOLE), Constant("real", LARGEST_WHOLE)
        bounded = Operation("real", "max", (Operation("real", "min", (value, most)), least))
        return Operation("int", "truncate", (bounded,))

    def _of_whole_numbers(self, name: str, first: Expression, second: Expression) -> Expression:
        """Return //, % or &, for a first operand that may be negative where its bounds do not tell."""
        a, b = self._value(first), self._value(second)
        is_counting = first.bounds is not None and first.bounds[0] >= 0
        if name == "&":
            if not isinstance(b, Constant) or (int(b.value) + 1) & int(b.value):
                raise ValueError("& has a translation only where it takes the remainder by a power of two")
            name, b = "%", known(int(b.value) + 1)
        if name == "%":
            rest = Operation("int", "mod", (a, b))
            return rest if is_counting else Operation("int", "mod", (binary("+", rest, b), b))
        if is_counting:
            return Operation("int", "div", (a, b))
        # rounded down: minus the quotient rounded up
        result = self._temporary("int")
        up = Operation("int", "div", (binary("-", binary("-", b, known(1)), a), b))
        whole = Operation("int", "div", (a, b))
        test = Operation("bool", ">=", (a, known(0)))
        self._out.append(ir.If(test, [ir.Assign(result, whole)], [ir.Assign(result, Operation("int", "neg", (up,)))]))
        return result

    def _extreme(self, one: Operation, pairs: list[tuple[Expression, Expression]]) -> tuple[Expression, Expression]:
        """Return ``min`` or ``max``: the first, unless the second is known to be beyond it."""
        (a, a_known), (b, b_known) = pairs
        if a_known == _TRUE and b_known == _TRUE:
            return Operation(_type(one.type), one.name, (a, b), bounds=one.bounds), _TRUE
        result = self._temporary("real")
        sign = "<" if one.name == "min" else ">"
        test = _both(_both(a_known, b_known), Operation("bool", sign, (b, a)))
        self._out.append(ir.Assign(result, a))
        self._branch(test, [ir.Assign(result, b)], [])
        return result, a_known


def _type(kind: Type) -> Type:
    return "real" if kind == "wide" else kind


def _facts(test: Expression, is_true: bool) -> set[str]:
    """Return the variables that are known where a condition of the program in C is true, or false."""
    if not isinstance(test, Operation):
        return set()
    if test.name == "not":
        return _facts(test.operands[0], not is_true)
    if test.name == ("and" if is_true else "or"):
        return _facts(test.operands[0], is_true) | _facts(test.operands[1], is_true)
    if (test.name == "isfinite" and is_true) or (test.name == "isnan" and not is_true):
        return _summed(test.operands[0])
    return set()


def _summed(value: Expression) -> set[str]:
    if isinstance(value, Variable):
        return {value.name}
    if isinstance(value, Operation) and value.name in ("+", "-", "*", "/", "neg", "fabs", "cast"):
        return set().union(*map(_summed, value.operands))
    return set()


def _is_closed(block: Block) -> bool:
    return bool(block) and isinstance(block[-1], (ir.Return, ir.Jump))


def _assigned(block: Block) -> set[str]:
    return {name for each in ir.statements(block) for name in ir.targets(each)}


def _is_risky(value: Expression) -> bool:
    """Return True if a value must only be computed where it is wanted: it may reach outside an array."""
    return any(
        (isinstance(e, (ir.Load, ir.Element)) and e.index is not None and not isinstance(e.index, Constant))
        or isinstance(e, ir.Call)
        for e in ir.walk(value)
    )
