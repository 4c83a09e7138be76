"""Values of a program, translated for `strict`: each with the condition that it is known."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache

from friction_hil.export import ir, strict_library
from friction_hil.export.arithmetic import binary, is_number, known
from friction_hil.export.ir import Block, Constant, Expression, Function, Operation, Type, Variable
from friction_hil.export.strict_library import UNLIMITED

LARGEST_WHOLE = 2.0e9  # of a number that is made a whole number
TRUE = known(True)


@dataclass(slots=True)
class Findings:
    """What may be unknown; it grows until a translation finds nothing new."""

    variables: set[tuple[Function, str]] = field(default_factory=set)
    results: set[tuple[Function, int]] = field(default_factory=set)
    fields: set[str] = field(default_factory=set)

    def size(self) -> int:
        """Return how much was found."""
        return len(self.variables) + len(self.results) + len(self.fields)


def flag(name: str) -> str:
    """Return the name of the flag of a number."""
    return f"{name}_known"


@cache
def _changed(function: Function) -> frozenset[str]:
    """Return the parameters that a function of the program in C assigns: here they are copied first."""
    return frozenset({each.name for each in function.parameters} & assigned(function.body))


def given_name(function: Function, name: str) -> str:
    """Return the name of the parameter for one of the program in C."""
    return f"{name}_given" if name in _changed(function) else name


def finite(value: float) -> float:
    """Return what stands for a number: zero for NaN, beside its flag, and `UNLIMITED` for infinity."""
    if math.isnan(value):
        return 0.0
    return math.copysign(UNLIMITED, value) if math.isinf(value) else value


@dataclass(slots=True)
class Whole:
    """One pass over all functions."""

    found: Findings
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


_OPPOSITE = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "==", "and": "or", "or": "and"}


def inverted(value: Expression) -> Expression:
    """Return ``not`` of a condition, which stands before no expression in brackets: a compiler takes none."""
    if isinstance(value, Constant):
        return known(not value.value)
    if isinstance(value, Operation) and value.name == "not":
        return value.operands[0]
    if isinstance(value, Operation) and value.name in _OPPOSITE:
        parts = tuple(map(inverted, value.operands)) if value.name in ("and", "or") else value.operands
        return Operation("bool", _OPPOSITE[value.name], parts)
    return Operation("bool", "not", (value,))


class StrictExpressions:
    """Translates the values of one function; a pair is a value and the condition that it is known."""

    _whole: Whole
    _old: Function  # function that is translated
    _new: Function  # what it becomes
    _certain: set[str]  # variables that are known here, whatever they are elsewhere
    _out: Block  # the present block; statements that a value needs are added to it
    _count: int

    def _inside(self, work: Callable[[], object], certain: set[str]) -> tuple[Block, set[str]]:
        """Return the statements of some work, for which more is certain, and what is certain after it."""
        outer, before = self._out, self._certain
        self._out, self._certain = [], before | certain
        try:
            work()
            return self._out, self._certain
        finally:
            self._out, self._certain = outer, before

    def _branch(self, condition: Expression, yes: Block, no: Block) -> None:
        if isinstance(condition, Constant):
            self._out += yes if condition.value else no
        elif yes or no:
            test = condition if yes else inverted(condition)
            self._out.append(ir.If(test, *((yes, no) if yes else (no, []))))

    def _into(self, target: Variable, value: Expression) -> None:
        """Assign a value to a variable."""
        if isinstance(value, Operation) and value.name == "select":
            test, then, other = value.operands
            condition = self._value(test)
            yes, after_yes = self._inside(lambda: self._into(target, then), facts(test, True))
            no, after_no = self._inside(lambda: self._into(target, other), facts(test, False))
            self._branch(condition, yes, no)
            self._certain = (after_yes & after_no & {target.name}) | (self._certain - {target.name})
            return
        self._assign(target, *self._pair(value))

    def _assign(self, target: Variable, value: Expression, is_known: Expression) -> None:
        name, found = target.name, self._whole.found
        if is_known != TRUE:
            found.variables.add((self._old, name))
        has_flag = (self._old, name) in found.variables
        if value != target:
            self._out.append(ir.Assign(target, value))
        if has_flag and is_known != Variable("bool", flag(name)):
            self._out.append(ir.Assign(Variable("bool", flag(name)), is_known))
        if is_known == TRUE:
            self._certain.add(name)
        else:
            self._certain.discard(name)

    def _operands(self, function: Function, operands: Iterable[Expression]) -> tuple[Expression, ...]:
        given: list[Expression] = []
        found, skipped = self._whole.found, self._whole.skipped
        for parameter, operand in zip(function.parameters, operands, strict=True):
            value, is_known = self._pair(operand)
            if is_known != TRUE:
                found.variables.add((function, parameter.name))
            name = given_name(function, parameter.name)
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
        own = [Variable(plain_type(each.type), each.name) for each in targets]
        self._out.append(ir.CallStatement([*own, *flags], self._whole.made[function], given))
        for i, each in enumerate(targets):
            if (function, i) not in found.results and (self._old, each.name) in found.variables:
                self._out.append(ir.Assign(Variable("bool", flag(each.name)), TRUE))

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
                flagged = Variable("bool", flag(name)) if is_flagged else TRUE
                return Variable(plain_type(expression.type), name, bounds=expression.bounds), flagged
            case ir.Load(field=name, index=index):
                at = None if index is None else self._value(index)
                is_known: Expression = ir.Load("bool", flag(name), at) if name in self._whole.found.fields else TRUE
                return ir.Load("real", name, at), is_known
            case ir.Element(table=table, index=index):
                return ir.Element("real", table, self._value(index)), TRUE
            case ir.Call(function=function, operands=operands):
                return self._called(expression.type, function, operands)
            case Operation():
                return self._operation(expression)
        raise TypeError(expression)

    @staticmethod
    def _constant(one: Constant) -> tuple[Expression, Expression]:
        if not is_number(one.type):
            return one, TRUE
        return Constant("real", finite(one.value), name=one.name), known(not math.isnan(one.value))

    def _called(self, kind: Type, function: Function, operands: Iterable[Expression]) -> tuple[Expression, Expression]:
        if (function, 0) not in self._whole.found.results:
            return ir.Call(plain_type(kind), self._whole.made[function], self._operands(function, operands)), TRUE
        result = self._temporary(plain_type(kind))
        self._call([result], function, operands)
        return result, Variable("bool", flag(result.name))

    def _operation(self, one: Operation) -> tuple[Expression, Expression]:
        name, operands = one.name, one.operands
        if name == "select":
            result = self._temporary(plain_type(one.type))
            self._into(result, one)
            return self._pair(result)
        if name in ("and", "or"):
            return self._condition(name, *operands), TRUE
        if name in ("//", "%", "&"):
            return self._of_whole_numbers(name, *operands), TRUE
        pairs = [self._pair(each) for each in operands]
        values = tuple(value for value, _ in pairs)
        all_known: Expression = TRUE
        for _, is_known in pairs:
            all_known = _both(all_known, is_known)
        match name:
            case "not":
                return inverted(values[0]), TRUE
            case "isnan":
                return inverted(all_known), TRUE
            case "isfinite":
                size = Operation("real", "fabs", values)
                return _both(all_known, Operation("bool", "<", (size, Constant("real", UNLIMITED)))), TRUE
            case "<" | "<=" | ">" | ">=" | "==":
                return _both(all_known, Operation("bool", name, values)), TRUE
            case "!=":
                return _joined("or", inverted(all_known), Operation("bool", name, values)), TRUE
            case "cast":
                return self._cast(values[0], one.type), all_known
            case "min" | "max":
                return self._extreme(one, pairs)
            case "/":
                return strict_library.quotient(*values), all_known
            case "+" | "-" | "*" | "neg" | "fabs":
                return Operation(plain_type(one.type), name, values, bounds=one.bounds), all_known
        return strict_library.value(name, values), all_known

    def _condition(self, name: str, first: Expression, second: Expression) -> Expression:
        """Return ``and`` or ``or``; where the second must not be evaluated in any case, by a branch."""
        a = self._value(first)
        results: list[Expression] = []
        block, _ = self._inside(lambda: results.append(self._value(second)), facts(first, name == "and"))
        b = results[0]
        if not block and not _is_risky(b):
            return _joined(name, a, b)
        result = self._temporary("bool")
        self._out.append(ir.Assign(result, a))
        test = result if name == "and" else inverted(result)
        self._out.append(ir.If(test, [*block, ir.Assign(result, b)], []))
        return result

    def _cast(self, value: Expression, kind: Type) -> Expression:
        if value.type == plain_type(kind):
            return value
        if value.type == "bool":
            result = self._temporary(plain_type(kind))
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
        if a_known == TRUE and b_known == TRUE:
            return Operation(plain_type(one.type), one.name, (a, b), bounds=one.bounds), TRUE
        result = self._temporary("real")
        sign = "<" if one.name == "min" else ">"
        test = _both(_both(a_known, b_known), Operation("bool", sign, (b, a)))
        self._out.append(ir.Assign(result, a))
        self._branch(test, [ir.Assign(result, b)], [])
        return result, a_known


def plain_type(kind: Type) -> Type:
    """Return the type here: all numbers are of one."""
    return "real" if kind == "wide" else kind


def facts(test: Expression, is_true: bool) -> set[str]:
    """Return the variables that are known where a condition of the program in C is true, or false."""
    if not isinstance(test, Operation):
        return set()
    if test.name == "not":
        return facts(test.operands[0], not is_true)
    if test.name == ("and" if is_true else "or"):
        return facts(test.operands[0], is_true) | facts(test.operands[1], is_true)
    if (test.name == "isfinite" and is_true) or (test.name == "isnan" and not is_true):
        return _summed(test.operands[0])
    return set()


def _summed(value: Expression) -> set[str]:
    if isinstance(value, Variable):
        return {value.name}
    if isinstance(value, Operation) and value.name in ("+", "-", "*", "/", "neg", "fabs", "cast"):
        return set().union(*map(_summed, value.operands))
    return set()


def assigned(block: Block) -> set[str]:
    """Return the variables that a block assigns."""
    return {name for each in ir.statements(block) for name in ir.targets(each)}


def _is_risky(value: Expression) -> bool:
    """Return True if a value must only be computed where it is wanted: it may reach outside an array."""
    return any(
        (isinstance(e, (ir.Load, ir.Element)) and e.index is not None and not isinstance(e.index, Constant))
        or isinstance(e, ir.Call)
        for e in ir.walk(value)
    )
