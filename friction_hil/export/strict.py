"""A program for a language that knows less than C: IEC 61131-3 Structured Text.

It has no NaN, may stop at a division by zero or an overflow, evaluates both operands of ``and`` and ``or``, and has no
conditional expression that every implementation understands. Here a number that may be unknown gets a flag beside
it, which says whether it is known; infinity becomes `strict_library.UNLIMITED`; conditional expressions become
branches. What an operation does with NaN in C, the flags do here: a comparison with an unknown number is false. Zero
has no sign.

What is left are assignments, branches, loops, calls and returns, with the operators + - * / neg < <= > >= == != and or
not, div and mod (of whole numbers, towards zero), cast (to a number), truncate (to a whole number), and the functions
min, max, fabs, sin, cos, exp, log, sqrt and pow. All numbers are double precision.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from friction_hil.compensator import INPUTS
from friction_hil.export import ir
from friction_hil.export.ir import Block, Expression, Function, Type, Variable
from friction_hil.export.kernels import Program, called
from friction_hil.export.strict_expressions import (
    TRUE,
    Findings,
    StrictExpressions,
    Whole,
    assigned,
    facts,
    finite,
    flag,
    given_name,
    inverted,
    plain_type,
)
from friction_hil.export.values import Table

UNKNOWN = 1e30  # an input that is not connected
PLAUSIBLE = 1e16  # numbers from here on, and NaN where there is one, are unknown
# inputs that may be unknown
OPTIONAL = {
    "model": ("temperature",),
    "compensator": tuple(name for name in INPUTS if name not in ("cycle", "is_fresh", "is_enabled")),
}


@dataclass(frozen=True, slots=True)
class StrictField:
    """A field of the state: its type and the values it begins with."""

    name: str
    type: Type
    initial: tuple[float, ...]
    is_array: bool


@dataclass(frozen=True, slots=True)
class StrictProgram:
    """A step in the narrow sense."""

    entry: Function
    # what the parameters of the entry are called outside, in their order; see `flag` for the names of flags
    inputs: tuple[Variable, ...]
    functions: tuple[Function, ...]  # in an order in which none calls a later one
    fields: tuple[StrictField, ...]
    tables: tuple[Table, ...]


def strict(program: Program, unknown: Iterable[str]) -> StrictProgram:
    """Return a program in the narrow sense; the inputs named by ``unknown`` have a flag if it matters."""
    found, unread = Findings(), set[tuple[Function, str]]()
    given = {each.name for each in program.operands} & set(unknown)
    pairs = zip(program.entry.parameters, program.operands, strict=True)
    found.variables |= {(program.entry, inner.name) for inner, outer in pairs if outer.name in given}
    while True:  # first what may be unknown, then what nobody asks for
        size, unused = found.size(), len(unread)
        whole = Whole(found, unread)
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
    names = {given_name(program.entry, inner.name): outer.name for inner, outer in pairs}
    names |= {flag(inner): flag(outer) for inner, outer in names.items()}
    inputs = tuple(Variable(each.type, names[each.name]) for each in entry.parameters)
    fields = []
    for name, one in program.state.fields.items():
        if one.is_used:
            values = tuple(map(float, one.initial[: one.extent]))
            clean = tuple(finite(each) for each in values)
            fields.append(StrictField(name, "real", clean, one.is_array))
            if name in found.fields:
                flags = tuple(float(not math.isnan(each)) for each in values)
                fields.append(StrictField(flag(name), "bool", flags, one.is_array))
    return StrictProgram(entry, inputs, tuple(called(entry)), tuple(fields), program.tables)


class _Lowering(StrictExpressions):
    """The translation of one function; a pair is a value and the condition that it is known."""

    def __init__(self, whole: Whole, function: Function) -> None:
        self._whole, self._old, self._new = whole, function, whole.made[function]
        self._certain: set[str] = set()  # variables that are known here, whatever they are elsewhere
        self._out: Block = []
        self._count = 0

    def run(self) -> None:
        """Fill the new function."""
        old, new, found = self._old, self._new, self._whole.found
        copies: Block = []
        for each in old.parameters:
            own, given = (
                Variable(plain_type(each.type), each.name),
                Variable(plain_type(each.type), given_name(old, each.name)),
            )
            pairs = [(own, given)]
            if (old, each.name) in found.variables:
                pairs.append((Variable("bool", flag(own.name)), Variable("bool", flag(given.name))))
            for variable, parameter in pairs:
                if (old, parameter.name) not in self._whole.skipped:
                    new.parameters.append(parameter)
                    if variable != parameter:
                        copies.append(ir.Assign(variable, parameter))
        flags: list[Type] = ["bool" for i in range(len(old.results)) if (old, i) in found.results]
        new.results = (*map(plain_type, old.results), *flags)
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

    def _statement(self, statement: ir.Statement) -> None:
        match statement:
            case ir.Assign(Variable(name=name) as target, value):
                self._into(Variable(plain_type(target.type), name), value)
            case ir.Assign(ir.Load(field=name, index=index), value):
                self._store(name, index, value)
            case ir.CallStatement(targets, function, operands):
                self._call(list(targets), function, operands)
            case ir.If(test, then, other):
                condition = self._value(test)
                yes, after_yes = self._inside(lambda: self._extend(then), facts(test, True))
                no, after_no = self._inside(lambda: self._extend(other), facts(test, False))
                self._branch(condition, yes, no)
                open_ends = [a for b, a in ((yes, after_yes), (no, after_no)) if not _is_closed(b)]
                self._certain = set.intersection(*open_ends) if open_ends else self._certain
            case ir.For(variable, start, stop, step, body, most):
                first, end = self._value(start), self._value(stop)
                self._certain -= assigned(body)
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

    def _while(self, test: Expression, body: Block, most: int) -> None:
        self._certain -= assigned(body)
        conditions: list[Expression] = []
        before, _ = self._inside(lambda: conditions.append(self._value(test)), set())
        inner, _ = self._inside(lambda: self._extend(body), facts(test, True))
        if before:
            leave = ir.If(inverted(conditions[0]), [ir.Jump("break")], [])
            self._out.append(ir.While(TRUE, [*before, leave, *inner], most))
        else:
            self._out.append(ir.While(conditions[0], inner, most))

    def _return(self, values: tuple[Expression, ...]) -> None:
        pairs = [self._pair(each) for each in values]
        found = self._whole.found
        for i, (_, is_known) in enumerate(pairs):
            if is_known != TRUE:
                found.results.add((self._old, i))
        flags = [is_known for i, (_, is_known) in enumerate(pairs) if (self._old, i) in found.results]
        self._out.append(ir.Return((*(value for value, _ in pairs), *flags)))

    def _store(self, name: str, index: Expression | None, value: Expression) -> None:
        at = None if index is None else self._value(index)
        number, is_known = self._pair(value)
        found = self._whole.found
        if is_known != TRUE:
            found.fields.add(name)
        self._out.append(ir.Assign(ir.Load("real", name, at), number))
        if name in found.fields:
            self._out.append(ir.Assign(ir.Load("bool", flag(name), at), is_known))


def _is_closed(block: Block) -> bool:
    return bool(block) and isinstance(block[-1], (ir.Return, ir.Jump))
