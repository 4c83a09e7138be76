"""Functions of a strict program as Structured Text of IEC 61131-3."""

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from friction_hil.export import ir
from friction_hil.export.arithmetic import binary, known
from friction_hil.export.ir import Block, Constant, Expression, Function, Operation, Variable
from friction_hil.export.values import Table

TYPES = {"real": "LREAL", "int": "DINT", "bool": "BOOL"}
STATE = "state"  # name of the variable that holds the state and the tables
# words of the language, its types and functions, and what CODESYS and TwinCAT add; capitals do not matter
_RESERVED = frozenset(
    (*("abs", "abstract", "acos", "action", "add", "adr", "and", "and_then", "any", "array", "asin", "at", "atan"),
     *("begin", "bit", "bool", "by", "byte", "cal", "case", "char", "class", "concat", "configuration", "constant"),
     *("continue", "cos", "ctd", "ctu", "ctud", "date", "date_and_time", "delete", "dint", "div", "do", "dt"),
     *("dword", "else", "elsif", "end_if", "end_for", "end_var", "eq", "exit", "exp", "expt", "extends", "f_edge"),
     *("f_trig", "false", "final", "find", "for", "from", "function", "function_block", "ge", "get", "gt", "if"),
     *("implements", "in", "initial_step", "insert", "int", "interface", "internal", "interval", "ld", "le"),
     *("left", "len", "limit", "lint", "ln", "log", "lreal", "lt", "ltime", "lword", "max", "method", "mid", "min"),
     *("mod", "move", "mul", "mux", "namespace", "ne", "neg", "new", "non_retain", "not", "null", "of", "on", "or"),
     *("or_else", "override", "persistent", "pointer", "priority", "private", "program", "property", "protected"),
     *("public", "r", "r_edge", "r_trig", "read_only", "read_write", "real", "ref", "reference", "repeat"),
     *("replace", "resource", "ret", "retain", "return", "right", "rol", "ror", "rs", "s", "sel", "set", "shl"),
     *("shr", "sin", "single", "sint", "sizeof", "sqrt", "sr", "st", "step", "stn", "string", "struct", "sub"),
     *("super", "tan", "task", "then", "this", "time", "time_of_day", "to", "tod", "tof", "ton", "tp", "transition"),
     *("true", "trunc", "type", "udint", "uint", "ulint", "union", "until", "usint", "using", "var", "var_input"),
     *("while", "with", "word", "wstring", "xor", STATE))
)  # fmt: skip
_PRECEDENCE = {
    **dict.fromkeys(("*", "/", "div", "mod"), 6),
    **dict.fromkeys(("+", "-"), 5),
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), 4),
    "and": 2,
    "or": 1,
}
_SIGNS = {"and": "AND", "or": "OR", "div": "/", "mod": "MOD", "==": "=", "!=": "<>"}
_FUNCTIONS = {"fabs": "ABS", "log": "LN", "pow": "EXPT", "truncate": "TRUNC", "cast": "DINT_TO_LREAL"}
_ATOM = 9
_WIDTH = 116


@dataclass(slots=True)
class Declared:
    """A variable as it is declared."""

    name: str
    type: str
    initial: str = ""
    comment: str = ""

    def text(self) -> str:
        """Return the declaration."""
        begin = f":= {self.initial}" if self.initial else ""
        line = wrapped(f"    {self.name} : {self.type} {begin}".rstrip() + ";")
        return f"{line} (* {self.comment} *)" if self.comment else line


@dataclass(slots=True)
class Pou:
    """A program organisation unit: a function or a function block."""

    kind: str
    name: str
    result: str = ""
    sections: dict[str, list[Declared]] = field(default_factory=dict)
    body: str = ""
    comment: str = ""

    def text(self) -> str:
        """Return it as text."""
        result = f" : {self.result}" if self.result else ""
        lines = [f"(* {self.comment} *)"] if self.comment else []
        lines.append(f"{self.kind} {self.name}{result}")
        for section, variables in self.sections.items():
            if variables:
                lines += [section, *(each.text() for each in variables), "END_VAR"]
        return "\n".join([*lines, self.statements(), f"END_{self.kind}"]) + "\n"

    def statements(self) -> str:
        """Return its statements as text."""
        return "\n".join(wrapped(line) for line in self.body.rstrip("\n").split("\n"))


class Names:
    """Names of one unit: none is a word of the language, none equals another but for capitals."""

    def __init__(self) -> None:
        self._given: dict[tuple[str, str], str] = {}
        self._taken: set[str] = set()

    def of(self, name: str, role: str = "") -> str:
        """Return the name for a thing of the program."""
        if (role, name) not in self._given:
            plain = re.sub(r"\W+|_+", "_", f"{role}_{name}").strip("_")
            shown = f"{plain}_value" if plain.lower() in _RESERVED else plain
            number = 2
            while shown.lower() in self._taken:
                shown = f"{plain}_{number}"
                number += 1
            self._taken.add(shown.lower())
            self._given[role, name] = shown
        return self._given[role, name]


class StPrinter:
    """Prints the functions of one program.

    ``prefix``: of the functions, of the type of the state and of the functions of the library. ``kind``: ``model`` or
    ``compensator``, the rest of the prefix of the functions; those of ``library`` are without it.
    """

    def __init__(self, prefix: str, kind: str, tables: Sequence[Table], library: Iterable[Function]) -> None:
        self._prefix, self._kind = prefix, kind
        self._tables = {each.name: each for each in tables}
        self._library = set(library)
        self._names = Names()
        self._constants: dict[str, float] = {}

    def name(self, function: Function) -> str:
        """Return the name of a function."""
        own = "" if function in self._library else f"{self._kind}_"
        return re.sub("_+", "_", f"{self._prefix}_{own}{function.name}")

    @property
    def state_type(self) -> str:
        """The type of the state."""
        return f"{self._prefix}_{self._kind}_state"

    def function(self, function: Function) -> Pou:
        """Return a function as a unit."""
        self._function, self._names, self._constants = function, Names(), {}
        self._read = {
            e.name
            for s in ir.statements(function.body)
            for x in ir.expressions(s)
            for e in ir.walk(x)
            if isinstance(e, Variable)
        }
        inputs = [Declared(self._names.of(each.name), TYPES[each.type]) for each in function.parameters]
        extra = list(enumerate(function.results))[1:]
        outputs = [Declared(self._names.of(str(i), "result"), TYPES[kind]) for i, kind in extra]
        self._locals: dict[str, str] = {}
        body = self._block(function.body, 0)
        if not function.results:
            body = f"{self.name(function)} := TRUE;\n{body}"
        constants = [Declared(self._names.of(name, "p"), "LREAL", literal(value))
                     for name, value in sorted(self._constants.items())]  # fmt: skip
        parameters = {each.name for each in function.parameters}
        own = [Declared(self._names.of(name), kind) for name, kind in sorted(self._locals.items())
               if name not in parameters]  # fmt: skip
        state = [Declared(STATE, self.state_type)] if needs_state(function) else []
        return Pou(
            "FUNCTION",
            self.name(function),
            TYPES[function.results[0]] if function.results else "BOOL",
            {"VAR_IN_OUT": state, "VAR_INPUT": inputs, "VAR_OUTPUT": outputs, "VAR": own, "VAR CONSTANT": constants},
            body,
            function.summary,
        )

    # --- statements

    def _block(self, block: Block, depth: int, *, is_last: bool = True) -> str:
        indent, lines = "    " * depth, []
        for k, statement in enumerate(block):
            lines += self._statement(statement, depth, is_last=is_last and k == len(block) - 1)
        return "".join(f"{indent}{line}\n" for line in lines)

    def _inner(self, block: Block, depth: int, *, is_last: bool) -> list[str]:
        text = self._block(block, depth + 1, is_last=is_last).rstrip("\n")
        margin = "    " * depth
        return [line.removeprefix(margin) for line in text.split("\n")]

    def _statement(self, statement: ir.Statement, depth: int, *, is_last: bool) -> list[str]:
        match statement:
            case ir.Assign(target, value):
                if isinstance(target, Variable):
                    self._locals[target.name] = TYPES[target.type]
                return [f"{self.expression(target)} := {self.expression(value)};"]
            case ir.CallStatement():
                return [self._call(statement)]
            case ir.If(test, then, other):
                lines = [f"IF {self.expression(test)} THEN", *self._inner(then, depth, is_last=is_last)]
                while len(other) == 1 and isinstance(other[0], ir.If):
                    lines.append(f"ELSIF {self.expression(other[0].test)} THEN")
                    lines += self._inner(other[0].then, depth, is_last=is_last)
                    other = other[0].other
                if other:
                    lines += ["ELSE", *self._inner(other, depth, is_last=is_last)]
                return [*lines, "END_IF;"]
            case ir.For(variable, start, stop, step, body):
                # a compiler ends a FOR whose last value is an expression a pass early
                self._locals[variable.name] = "DINT"
                name, before = self._names.of(variable.name), self.expression(binary("-", start, known(step)))
                last = self.expression(binary("-", stop, known(step)))
                head = f"WHILE {name} {'<' if step > 0 else '>'} {last} DO"
                count = f"    {name} := {name} {'+' if step > 0 else '-'} {abs(step)};"
                return [f"{name} := {before};", head, count, *self._inner(body, depth, is_last=False), "END_WHILE;"]
            case ir.While(test, body):
                head = f"WHILE {self.expression(test)} DO"
                return [head, *self._inner(body, depth, is_last=False), "END_WHILE;"]
            case ir.Return(values):
                lines = []
                if self._function.results:
                    for i, value in enumerate(values):
                        place = self._names.of(str(i), "result") if i else self.name(self._function)
                        lines.append(f"{place} := {self.expression(value)};")
                return lines if is_last and lines else [*lines, "RETURN;"]
            case ir.Jump(kind):
                return ["EXIT;" if kind == "break" else "CONTINUE;"]
        raise TypeError(statement)

    def _call(self, statement: ir.CallStatement) -> str:
        function, targets = statement.function, statement.targets
        for each in targets:
            if each.name in self._read:
                self._locals[each.name] = TYPES[each.type]
        place = "done"
        if targets:
            place = targets[0].name if targets[0].name in self._read else f"unread_{targets[0].type}"
        kind = targets[0].type if targets else "bool"
        self._locals[place] = TYPES[kind]
        outputs = [
            f"result_{i} => {self._names.of(each.name)}"
            for i, each in enumerate(targets)
            if i and each.name in self._read
        ]
        return f"{self._names.of(place)} := {self._called(function, statement.operands, outputs)};"

    def _called(self, function: Function, operands: Iterable[Expression], outputs: Iterable[str] = ()) -> str:
        return self.call(function, map(self.expression, operands), outputs)

    def call(self, function: Function, operands: Iterable[str], outputs: Iterable[str] = ()) -> str:
        """Return a call of a function with operands that are text already."""
        names = Names()  # those in the function that is called, which are given in this order
        given = [f"{STATE} := {STATE}"] if needs_state(function) else []
        for parameter, operand in zip(function.parameters, operands, strict=True):
            given.append(f"{names.of(parameter.name)} := {operand}")
        return f"{self.name(function)}({', '.join([*given, *outputs])})"

    # --- expressions

    def expression(self, expression: Expression) -> str:
        """Return an expression as text."""
        return self._text(expression)[0]

    def _text(self, expression: Expression) -> tuple[str, int]:
        match expression:
            case Constant():
                return self._literal(expression)
            case Variable(name=name):
                return self._names.of(name), _ATOM
            case ir.Load(field=name, index=index):
                return f"{STATE}.{field_name(name)}" + ("" if index is None else f"[{self.expression(index)}]"), _ATOM
            case ir.Element(table=table, index=index):
                at = binary("+", index, known(-self._tables[table].used[0]))
                return f"{STATE}.{table_name(table)}[{self.expression(at)}]", _ATOM
            case ir.Call(function=function, operands=operands):
                return self._called(function, operands), _ATOM
            case Operation():
                return self._operation(expression)
        raise TypeError(expression)

    def _operation(self, one: Operation) -> tuple[str, int]:
        name, operands = one.name, one.operands
        if name == "neg":
            return f"-{self._at_least(operands[0], _ATOM)}", 3
        if name == "not":
            return f"NOT {self._at_least(operands[0], _ATOM)}", 7
        if name in _PRECEDENCE:
            own = _PRECEDENCE[name]
            needed = 5 if own == 4 else own if own > 4 else _ATOM
            left = self._at_least(operands[0], own if own <= 2 and _is(operands[0], name) else needed)
            right = self._at_least(operands[1], needed + 1 if own > 4 else needed)
            return f"{left} {_SIGNS.get(name, name)} {right}", own
        shown = _FUNCTIONS.get(name, name.upper())
        return f"{shown}({', '.join(map(self.expression, operands))})", _ATOM

    def _at_least(self, expression: Expression, precedence: int) -> str:
        text, own = self._text(expression)
        return text if own >= precedence else f"({text})"

    def _literal(self, constant: Constant) -> tuple[str, int]:
        if constant.type == "bool":
            return ("TRUE" if constant.value else "FALSE"), _ATOM
        is_negative = math.copysign(1.0, constant.value) < 0.0
        if constant.type == "int":
            return str(int(constant.value)), 3 if is_negative else _ATOM
        if constant.name and self._constants.setdefault(constant.name, constant.value) == constant.value:
            return self._names.of(constant.name, "p"), _ATOM
        return literal(constant.value), 3 if is_negative else _ATOM


def wrapped(line: str) -> str:
    """Return a line as several that are not too long."""
    indent = " " * (len(line) - len(line.lstrip()))
    rows = textwrap.wrap(line.strip(), _WIDTH, initial_indent=indent, subsequent_indent=f"{indent}    ",
                         break_long_words=False, break_on_hyphens=False)  # fmt: skip
    return "\n".join(rows)


def literal(value: float) -> str:
    """Return a finite number with all its digits."""
    digits, _, exponent = repr(float(value)).partition("e")
    point = "" if "." in digits else ".0"
    return f"{digits}{point}" + (f"E{int(exponent)}" if exponent else "")


def needs_state(function: Function) -> bool:
    """Return True if a function, or one that it calls, reads or writes the state or reads a table."""
    for statement in ir.statements(function.body):
        places = [statement.target] if isinstance(statement, ir.Assign) else []
        if isinstance(statement, ir.CallStatement) and needs_state(statement.function):
            return True
        for each in (e for x in (*places, *ir.expressions(statement)) for e in ir.walk(x)):
            if isinstance(each, (ir.Load, ir.Element)) or (isinstance(each, ir.Call) and needs_state(each.function)):
                return True
    return False


def field_name(name: str) -> str:
    """Return the name of a field of the state."""
    plain = re.sub("_+", "_", name).strip("_")
    return f"{plain}_value" if plain.lower() in _RESERVED else plain


def table_name(name: str) -> str:
    """Return the name of a table in the state."""
    return f"{field_name(name)}_table"


def _is(operand: Expression, name: str) -> bool:
    return isinstance(operand, Operation) and operand.name == name
