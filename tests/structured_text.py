"""A strict interpreter for the part of Structured Text (IEC 61131-3) that exports use: it compiles it to Python.

It refuses what a controller might: undeclared names, names that differ in capitals only, types that do not match (no
number is converted silently), inputs and constants that are assigned, arguments that do not exist or are missing. It
refuses, too, what matiec or STruC++ refuse, or compile to something else: initial values within a structure (STruC++
drops them), numbers beyond single precision, VAR after VAR CONSTANT, FOR (matiec leaves out the last pass where its end
is an expression), and NOT before an expression. It evaluates both operands of AND and OR. It stops at what stops a
controller: a division by zero, a number that is not finite, an index outside an array, a whole number of more than 32
bits, a variable that is read before it has a value.
"""

import math
import re
from dataclasses import dataclass, field
from typing import Any

_TOKEN = re.compile(
    r"\(\*.*?\*\)|\s+|(?P<real>\d+\.\d+(?:E-?\d+)?)|(?P<int>\d+)|(?P<name>[A-Za-z]\w*)"
    r"|(?P<sign>:=|=>|<=|>=|<>|\.\.|[-+*/=<>()\[\]:;,.])",
    re.DOTALL,
)
_NUMBERS = ("LREAL", "DINT")
_LEVELS = (("OR",), ("AND",), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/", "MOD"))
_SUMS = 4  # level from which on the result is a number
_PYTHON = {"OR": "|", "AND": "&", "=": "==", "<>": "!="}
_TAKEN = {"OR": ("BOOL",), "AND": ("BOOL",), "=": ("BOOL", *_NUMBERS), "<>": ("BOOL", *_NUMBERS), "MOD": ("DINT",)}
_OF_ONE = {"SQRT": "sqrt", "LN": "log", "EXP": "exp", "SIN": "sin", "COS": "cos"}
_WORDS = frozenset(
    (*("ABS", "AND", "ARRAY", "BOOL", "BY", "CASE", "CONSTANT", "CONTINUE", "COS", "DATE", "DINT", "DO", "DT", "ELSE"),
     *("ELSIF", "EXIT", "EXP", "EXPT", "FALSE", "FOR", "FUNCTION", "IF", "INT", "LIMIT", "LN", "LOG", "LREAL", "MAX"),
     *("MIN", "MOD", "NOT", "OF", "OR", "R", "REAL", "REPEAT", "RETURN", "S", "SEL", "SIN", "SQRT", "ST", "STEP"),
     *("STRING", "STRUCT", "THEN", "TIME", "TO", "TRUE", "TRUNC", "TYPE", "UNTIL", "VAR", "WHILE", "WITH", "WORD"),
     "XOR")
)  # fmt: skip


class RefusedError(Exception):
    """The text is no correct program."""


class FaultError(Exception):
    """The program does what stops a controller."""


@dataclass
class Declared:
    type: Any
    section: str
    initial: str = ""  # Python


@dataclass
class Unit:
    name: str
    result: str = ""
    variables: dict[str, Declared] = field(default_factory=dict)

    def of(self, *sections):
        return [name for name, one in self.variables.items() if one.section in sections]


def number(value):
    if not -math.inf < value < math.inf:
        raise FaultError("a number is not finite")
    return value


def whole(value):
    if not -(2**31) <= value < 2**31:
        raise FaultError("a whole number has more than 32 bits")
    return value


def element(values, index):
    if not 0 <= index < len(values):
        raise FaultError(f"index {index} of {len(values)}")
    return values[index]


def put(values, index, value):
    element(values, index)
    values[index] = value


def divided(a, b):
    return whole(int(math.copysign(abs(a) // abs(b), a * b)))


def remainder(a, b):
    return int(math.fmod(a, b))


class Program:
    """The function blocks of a text; ``start`` makes an instance of one."""

    def __init__(self, text):
        self._text, self._tokens, at = text, [], 0
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                raise RefusedError(f"line {text.count(chr(10), 0, at) + 1}: {text[at : at + 20]!r}")
            at = found.end()
            if found.lastgroup:
                self._tokens.append((found.lastgroup, found.group(), found.start()))
        self._tokens.append(("end", "", 0))
        self._at = 0
        self._types, self._units = {}, {}
        self._space = {"math": math, "number": number, "whole": whole, "element": element, "put": put,
                       "divided": divided, "remainder": remainder}  # fmt: skip
        self._lines = []
        while self._tokens[self._at][0] != "end":
            self._declaration()
        exec(compile("\n".join(self._lines), "<structured text>", "exec"), self._space)

    def start(self, name):
        return self._space[f"f_{name}"]()

    def function(self, name):
        return self._space[f"f_{name}"]

    def structure(self, name):
        return self._space[f"t_{name}"]()

    # --- reading

    def _refuse(self, why):
        _, token, at = self._tokens[self._at]
        raise RefusedError(f"line {self._text.count(chr(10), 0, at) + 1}, {token!r}: {why}")

    def _is(self, *texts):
        return self._tokens[self._at][1].upper() in texts

    def _take(self, text=""):
        value = self._tokens[self._at][1]
        if text and value.upper() != text:
            self._refuse(f"{text} is missing")
        self._at += 1
        return value

    def _name(self):
        kind, value, _ = self._tokens[self._at]
        if kind != "name" or value.upper() in _WORDS or "__" in value or value.endswith("_"):
            self._refuse("this is no name")
        self._at += 1
        return value.lower()

    # --- declarations

    def _declaration(self):
        if self._is("TYPE"):
            self._structure()
        elif self._is("FUNCTION", "FUNCTION_BLOCK"):
            self._unit()
        else:
            self._refuse("no declaration")

    def _structure(self):
        self._take("TYPE")
        name = self._name()
        self._take(":")
        self._take("STRUCT")
        fields = {}
        while not self._is("END_STRUCT"):
            self._one_variable(fields, "FIELD")
        for text in ("END_STRUCT", ";", "END_TYPE"):
            self._take(text)
        if not fields:
            self._refuse("an empty structure")
        self._types[name] = {key: one.type for key, one in fields.items()}
        self._lines += [f"class t_{name}:", f"    __slots__ = {tuple(fields)!r}", "    def __init__(self):"]
        for key, one in fields.items():
            empty = f"[None] * {one.type[1]}" if isinstance(one.type, tuple) else "None"
            self._lines.append(f"        self.{key} = {empty}")

    def _type(self):
        if self._is("ARRAY"):
            self._take()
            for text in ("[", "0", ".."):
                self._take(text)
            size = int(self._take()) + 1
            self._take("]")
            self._take("OF")
            return ("ARRAY", size, self._type())
        if self._is("LREAL", "DINT", "BOOL"):
            return self._take().upper()
        name = self._name()
        if name not in self._types:
            self._refuse("there is no such type")
        return name

    def _one_variable(self, variables, section):
        name = self._name()
        if name in variables:
            self._refuse(f"{name} exists already")
        self._take(":")
        kind, initial = self._type(), ""
        if self._is(":="):
            if section == "FIELD":
                self._refuse("an initial value within a structure")
            self._take()
            initial = self._constant(kind)
        self._take(";")
        variables[name] = Declared(kind, section, initial)

    def _constant(self, wanted):
        code, kind = self._unary()
        if kind != wanted:
            self._refuse(f"{kind} for {wanted}")
        return code

    def _unit(self):
        self._is_block = self._take().upper() == "FUNCTION_BLOCK"
        self._own = Unit(self._name())
        if self._own.name in self._units:
            self._refuse("it exists already")
        if not self._is_block:
            self._take(":")
            self._own.result = self._take().upper()
        while self._is("VAR", "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT"):
            section = self._take().upper()
            if self._is("CONSTANT"):
                section = f"{section} {self._take().upper()}"
            elif self._own.of("VAR CONSTANT"):
                self._refuse(f"{section} after VAR CONSTANT")
            while not self._is("END_VAR"):
                self._one_variable(self._own.variables, section)
            self._take()
        body = self._block("    " if not self._is_block else "        ")
        self._take("END_FUNCTION_BLOCK" if self._is_block else "END_FUNCTION")
        (self._write_block if self._is_block else self._write_function)(body)
        self._units[self._own.name] = self._own

    def _write_function(self, body):
        own = self._own
        given = [f"v_{each}" for each in own.of("VAR_IN_OUT", "VAR_INPUT")]
        self._lines.append(f"def f_{own.name}({', '.join(given)}):")
        self._lines += [f"    v_{each} = {own.variables[each].initial}" for each in own.of("VAR CONSTANT")]
        self._lines += [*body, f"    {self._return()}"]

    def _write_block(self, body):
        own, empty = self._own, {"LREAL": "0.0", "DINT": "0", "BOOL": "False"}
        self._lines += [f"class f_{own.name}:", "    def __init__(self):"]
        for name, one in own.variables.items():
            self._lines.append(f"        self.v_{name} = {one.initial or empty.get(one.type) or f't_{one.type}()'}")
        self._lines.append("    def __call__(self, **given):")
        self._lines.append(f"        if not given.keys() <= {set(own.of('VAR_INPUT'))!r}: raise KeyError(given)")
        self._lines.append("        for name, value in given.items(): setattr(self, 'v_' + name, value)")
        self._lines += body
        outputs = ", ".join(f"{each!r}: self.v_{each}" for each in own.of("VAR_OUTPUT"))
        self._lines.append(f"        return {{{outputs}}}")

    def _return(self):
        if self._is_block:
            self._refuse("RETURN in a function block")
        outputs = [f"v_{each}" for each in self._own.of("VAR_OUTPUT")]
        return f"return {', '.join(['result', *outputs])}"

    # --- statements

    def _block(self, margin):
        lines = []
        while not (self._is("ELSE", "ELSIF") or self._tokens[self._at][1].upper().startswith("END_")):
            lines += self._statement(margin)
        return lines or [f"{margin}pass"]

    def _statement(self, margin):
        inner = f"{margin}    "
        if self._is("IF"):
            lines, word = [], "if"
            while self._is("IF", "ELSIF"):
                self._take()
                test = self._expected("BOOL")
                self._take("THEN")
                lines += [f"{margin}{word} {test}:", *self._block(inner)]
                word = "elif"
            if self._is("ELSE"):
                self._take()
                lines += [f"{margin}else:", *self._block(inner)]
            self._take("END_IF")
        elif self._is("WHILE"):
            self._take()
            lines = [f"{margin}while {self._expected('BOOL')}:"]
            self._take("DO")
            lines += self._block(inner)
            self._take("END_WHILE")
        elif self._is("RETURN"):
            self._take()
            lines = [margin + self._return()]
        elif self._is("EXIT"):
            self._take()
            lines = [f"{margin}break"]
        else:
            lines = [margin + self._assignment()]
        self._take(";")
        return lines

    def _assignment(self):
        name = self._name()
        if name == self._own.name and not self._is_block:
            kind, target = self._own.result, "result = {}"
        else:
            one = self._variable(name)
            if one.section in ("VAR_INPUT", "VAR CONSTANT"):
                self._refuse(f"{name} must not be assigned")
            kind, target = self._target(name, one.type)
        self._take(":=")
        code, outputs = self._with_outputs(kind)
        check = {"LREAL": f"number({code})", "DINT": f"whole({code})"}.get(kind, code)
        if not outputs:
            return target.format(check)
        if "= {}" not in target or "element" in target:
            self._refuse("results go to variables")
        return f"{target.removesuffix(' = {}')}, {', '.join(outputs)} = {code}"

    def _target(self, name, kind):
        code, kind, index = self._walk(self._place(name), kind)
        if index:
            return kind, f"put({code}, {index}, {{}})"
        if isinstance(kind, tuple) or kind in self._types:
            self._refuse("only single values are assigned")
        return kind, f"{code} = {{}}"

    def _walk(self, code, kind):
        """Follow fields up to an index, if there is one."""
        while self._is(".", "["):
            if self._take() == "[":
                if not isinstance(kind, tuple):
                    self._refuse("no array")
                index = self._expected("DINT")
                self._take("]")
                return code, kind[2], index
            part = self._name()
            if isinstance(kind, tuple) or part not in self._types.get(kind, {}):
                self._refuse(f"there is no {part}")
            code, kind = f"{code}.{part}", self._types[kind][part]
        return code, kind, ""

    def _variable(self, name):
        if name not in self._own.variables:
            self._refuse(f"{name} is not declared")
        return self._own.variables[name]

    def _place(self, name):
        return f"self.v_{name}" if self._is_block else f"v_{name}"

    # --- expressions: each method returns Python and the type

    def _with_outputs(self, wanted):
        self._outputs = None
        return self._expected(wanted), self._outputs

    def _expected(self, wanted):
        code, kind = self._expression()
        if kind != wanted:
            self._refuse(f"{kind} for {wanted}")
        return code

    def _expression(self, level=0):
        """Operators of one level bind less than those of the next."""
        if level == len(_LEVELS):
            return self._unary()
        code, kind = self._expression(level + 1)
        while self._is(*_LEVELS[level]):
            sign = self._take().upper()
            other, second = self._expression(level + 1)
            if kind != second or kind not in _TAKEN.get(sign, _NUMBERS):
                self._refuse(f"{kind} {sign} {second}")
            if kind == "DINT" and sign in ("/", "MOD"):
                code = f"{'divided' if sign == '/' else 'remainder'}({code}, {other})"
                continue
            code = f"({code} {_PYTHON.get(sign, sign)} {other})"
            kind = "BOOL" if level < _SUMS else kind
        return code, kind

    def _unary(self):
        if not self._is("-", "NOT"):
            return self._primary()
        sign = self._take().upper()
        if sign == "NOT" and self._is("("):
            self._refuse("NOT before an expression")
        code, kind = self._primary()
        if kind not in (("BOOL",) if sign == "NOT" else _NUMBERS):
            self._refuse(f"{sign} of {kind}")
        return (f"(not {code})" if sign == "NOT" else f"(-{code})"), kind

    def _primary(self):
        kind, text, _ = self._tokens[self._at]
        if kind in ("real", "int"):
            if float(text) > 3.4e38:
                self._refuse("a number beyond single precision")
            self._take()
            return text, "LREAL" if kind == "real" else "DINT"
        if self._is("("):
            self._take()
            code, kind = self._expression()
            self._take(")")
            return code, kind
        if self._is("TRUE", "FALSE"):
            return self._take().title(), "BOOL"
        if self._tokens[self._at + 1][1] == "(":
            return self._call()
        name = self._name()
        code, kind, index = self._walk(self._place(name), self._variable(name).type)
        return (f"element({code}, {index})" if index else code), kind

    def _call(self):
        text = self._take()
        self._take("(")
        known = text.upper()
        if known in ("ABS", "MIN", "MAX", "EXPT", "TRUNC", "DINT_TO_LREAL", *_OF_ONE):
            result = self._library(known)
        else:
            result = self._own_function(text.lower())
        self._take(")")
        return result

    def _library(self, name):
        first, kind = self._expression()
        values = [first]
        while self._is(","):
            self._take()
            values.append(self._expected(kind))
        wanted = "DINT" if name == "DINT_TO_LREAL" else kind if name in ("ABS", "MIN", "MAX") else "LREAL"
        if len(values) != (2 if name in ("MIN", "MAX", "EXPT") else 1) or kind != wanted or kind not in _NUMBERS:
            self._refuse(f"{name} of {len(values)} {kind}")
        given = ", ".join(values)
        if name == "TRUNC":
            return f"whole(int({given}))", "DINT"
        if name == "DINT_TO_LREAL":
            return f"float({given})", "LREAL"
        plain = {"ABS": "abs", "MIN": "min", "MAX": "max", "EXPT": "math.pow"}
        return f"{plain.get(name) or f'math.{_OF_ONE[name]}'}({given})", kind

    def _own_function(self, name):
        if name not in self._units or not self._units[name].result:
            self._refuse(f"there is no function {name}")
        unit, given, outputs = self._units[name], {}, {}
        while not self._is(")"):
            parameter = self._name()
            section = unit.variables[parameter].section if parameter in unit.variables else "none"
            kind = unit.variables[parameter].type if parameter in unit.variables else None
            if section == "VAR_OUTPUT":
                self._take("=>")
                variable = self._name()
                own = self._variable(variable)
                if own.type != kind or own.section not in ("VAR", "VAR_OUTPUT"):
                    self._refuse("the result does not fit")
                outputs[parameter] = self._place(variable)
            elif section in ("VAR_INPUT", "VAR_IN_OUT"):
                self._take(":=")
                given[parameter] = self._expected(kind)
            else:
                self._refuse(f"{name} takes no {parameter}")
            if not self._is(")"):
                self._take(",")
        parameters = unit.of("VAR_IN_OUT", "VAR_INPUT")
        if given.keys() != set(parameters):
            self._refuse(f"{name} needs {parameters}")
        code = f"f_{name}({', '.join(given[each] for each in parameters)})"
        results = unit.of("VAR_OUTPUT")
        if results:
            if self._tokens[self._at + 1][1] != ";":
                self._refuse("a function with several results in an expression")
            self._outputs = [outputs.get(each, "_") for each in results]
        return code, unit.result
