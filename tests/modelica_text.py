"""A strict interpreter for the functions of an exported Modelica package: it compiles them to Python.

It refuses undeclared names, types that do not match, inputs that are assigned, and wrong numbers of arguments and
results. It stops at a division by zero, a number that is not finite, an index outside an array, and a whole number of
more than 32 bits. Blocks, connectors and annotations are skipped.
"""

import math
import re
from dataclasses import dataclass, field

from tests.structured_text import RefusedError, divided, number, whole
from tests.structured_text import element as from_zero

_TOKEN = re.compile(
    r"//[^\n]*|\s+|(?P<text>\"(?:[^\"\\]|\\.)*\")|(?P<real>\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+)|(?P<int>\d+)"
    r"|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)|(?P<sign>:=|<=|>=|<>|==|[-+*/^=<>()\[\]{}:;,])"
)
_TYPES = ("Real", "Integer", "Boolean")
_WORDS = frozenset(
    (*("abs", "algorithm", "and", "block", "break", "constant", "cos", "div", "each", "else", "elseif", "end", "exp"),
     *("false", "for", "function", "if", "in", "input", "integer", "log", "loop", "max", "min", "mod", "not", "or"),
     *("output", "package", "pre", "protected", "return", "sample", "sign", "sin", "sqrt", "sum", "tan"),
     *("tanh", "then", "time", "true", "type", "when", "while", "delay", "edge", "change", "product", "size"),
     *_TYPES)
)  # fmt: skip
_OF_ONE = {"exp": "exp", "log": "log", "sqrt": "sqrt", "sin": "sin", "cos": "cos"}


def element(values, index):
    return from_zero(values, index - 1)


def put(values, index, value):
    from_zero(values, index - 1)
    values[index - 1] = value


@dataclass
class Unit:
    path: str
    inputs: dict = field(default_factory=dict)  # name to type
    outputs: dict = field(default_factory=dict)
    own: dict = field(default_factory=dict)


class Package:
    """The functions of a package, by their names within Internal; ``call`` runs one."""

    def __init__(self, text):
        begin = text.index('package Internal "')
        self._text, self._tokens, at = text, [], begin
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                raise RefusedError(f"line {text.count(chr(10), 0, at) + 1}: {text[at : at + 20]!r}")
            at = found.end()
            if found.lastgroup and found.lastgroup != "text":
                self._tokens.append((found.lastgroup, found.group(), found.start()))
        self._at, self._constants, self._units, self._lines = 0, {}, {}, []
        self.space = {"math": math, "number": number, "whole": whole, "element": element, "put": put,
                      "divided": divided}  # fmt: skip
        self._package("")
        exec(compile("\n".join(self._lines), "<modelica>", "exec"), self.space)

    def call(self, path, *given):
        return self.space[f"f_{path.replace('.', '_')}"](*given)

    # --- reading

    def _refuse(self, why):
        _, token, at = self._tokens[self._at]
        raise RefusedError(f"line {self._text.count(chr(10), 0, at) + 1}, {token!r}: {why}")

    def _is(self, *texts):
        return self._tokens[self._at][1] in texts

    def _take(self, text=""):
        value = self._tokens[self._at][1]
        if text and value != text:
            self._refuse(f"{text} is missing")
        self._at += 1
        return value

    def _name(self):
        kind, value, _ = self._tokens[self._at]
        if kind != "name" or value in _WORDS or "." in value:
            self._refuse("this is no name")
        self._at += 1
        return value

    # --- declarations

    def _package(self, outer):
        self._take("package")
        name = self._name()
        path = "" if name == "Internal" else f"{outer}{name}."
        while not self._is("end"):
            if self._is("package"):
                self._package(path)
            elif self._is("constant"):
                self._take()
                self._one_constant(path)
            else:
                self._function(path)
        for text in ("end", name, ";"):
            self._take(text)

    def _one_constant(self, path):
        kind, name, size = self._type(), self._name(), self._size(path)
        self._take("=")
        values = [self._number_text(kind)] if size is None else self._row(kind, size)
        self._take(";")
        place = f"c_{f'{path}{name}'.replace('.', '_')}"
        self._constants[path + name] = (kind, size, values[0])
        self._lines.append(f"{place} = {values[0] if size is None else '[' + ', '.join(values) + ']'}")

    def _row(self, kind, size):
        self._take("{")
        values = [self._number_text(kind)]
        while self._is(","):
            self._take()
            values.append(self._number_text(kind))
        self._take("}")
        if len(values) != size:
            self._refuse(f"{len(values)} values for {size}")
        return values

    def _number_text(self, kind):
        sign = self._take() if self._is("-") else ""
        found, text, _ = self._tokens[self._at]
        if found != {"Real": "real", "Integer": "int", "Boolean": "name"}[kind]:
            self._refuse(f"no {kind}")
        self._at += 1
        return sign + (text.title() if kind == "Boolean" else text)

    def _type(self):
        kind = self._take()
        if kind not in _TYPES:
            self._refuse("no type")
        return kind

    def _size(self, path):
        if not self._is("["):
            return None
        self._take()
        is_number = self._tokens[self._at][0] == "int"
        size = int(self._take() if is_number else self._constants[path + self._name()][2])
        self._take("]")
        return size

    def _function(self, path):
        self._take("function")
        name = self._name()
        self._own, self._path = Unit(path + name), path
        starts, declared = [], {}
        while not self._is("algorithm"):
            if self._is("protected"):
                self._take()
                continue
            word = self._take() if self._is("input", "output", "constant") else "own"
            kind, one, size = self._type(), self._name(), self._size(path)
            if one in declared:
                self._refuse("it is declared twice")
            declared[one] = (kind, size)
            if self._is("="):
                self._take()
                starts.append(f"    v_{one} = {self._number_text(kind)}")
            self._take(";")
            place = {"input": self._own.inputs, "output": self._own.outputs}.get(word, self._own.own)
            place[one] = (kind, size)
            if word == "constant":
                self._own.own[one] = ("constant", kind)
        self._take("algorithm")
        self._counting = {}
        body = self._block("    ")
        for text in ("end", name, ";"):
            self._take(text)
        if self._own.path in self._units:
            self._refuse("it exists already")
        self._units[self._own.path] = self._own
        given = ", ".join(f"v_{each}" for each in self._own.inputs)
        head = f"def f_{self._own.path.replace('.', '_')}({given}):"
        self._lines += [head, *starts, *body, f"    {self._return()}"]

    def _return(self):
        return f"return {', '.join(f'v_{each}' for each in self._own.outputs)}"

    # --- statements

    def _block(self, margin):
        lines = []
        while not self._is("end", "else", "elseif"):
            lines += self._statement(margin)
        return lines or [f"{margin}pass"]

    def _statement(self, margin):
        inner = f"{margin}    "
        if self._is("if"):
            lines, word = [], "if"
            while self._is("if", "elseif"):
                self._take()
                test = self._expected("Boolean")
                self._take("then")
                lines += [f"{margin}{word} {test}:", *self._block(inner)]
                word = "elif"
            if self._is("else"):
                self._take()
                lines += [f"{margin}else:", *self._block(inner)]
            self._end("if")
            return lines
        if self._is("while"):
            self._take()
            test = self._expected("Boolean")
            self._take("loop")
            lines = [f"{margin}while {test}:", *self._block(inner)]
            self._end("while")
            return lines
        if self._is("for"):
            return self._loop(margin)
        if self._is("assert"):
            for text in ("assert", "("):
                self._take(text)
            line = f"{margin}assert {self._expected('Boolean')}"
            for text in (",", ")", ";"):  # the message between them is no token
                self._take(text)
            return [line]
        if self._is("break", "return"):
            line = margin + ("break" if self._take() == "break" else self._return())
            self._take(";")
            return [line]
        return [margin + self._assignment()]

    def _end(self, word):
        for text in ("end", word, ";"):
            self._take(text)

    def _loop(self, margin):
        self._take("for")
        name = self._name()
        self._take("in")
        parts = [self._expected("Integer")]
        while self._is(":"):
            self._take()
            parts.append(self._expected("Integer"))
        self._take("loop")
        start, step, stop = (parts[0], "1", parts[1]) if len(parts) == 2 else parts
        self._counting[name] = True
        end = f"{stop} {'-' if '-' in step else '+'} 1"
        lines = [f"{margin}for v_{name} in range({start}, {end}, {step}):", *self._block(f"{margin}    ")]
        del self._counting[name]
        self._end("for")
        return lines

    def _assignment(self):
        if self._is("("):
            self._take()
            targets = [self._name()]
            while self._is(","):
                self._take()
                targets.append(self._name())
            self._take(")")
            self._take(":=")
            code, kinds = self._call(self._take())
            self._take(";")
            if kinds != [self._assignable(each) for each in targets]:
                self._refuse(f"{kinds} for {targets}")
            return f"{', '.join(f'v_{each}' for each in targets)} = {code}"
        name = self._name()
        kind, size = self._assignable(name)
        if self._is("["):
            self._take()
            index = self._expected("Integer")
            self._take("]")
            self._take(":=")
            value = self._expected(kind)
            self._take(";")
            return f"put(v_{name}, {index}, {self._checked(kind, value)})"
        self._take(":=")
        if size is not None and self._tokens[self._at + 1][1] == ";":
            other = self._name()
            self._take(";")
            if self._declared(other) != (kind, size):
                self._refuse("another array")
            return f"v_{name} = list(v_{other})"
        if size is not None:
            code, kinds = self._call(self._take())
            self._take(";")
            if kinds != [(kind, size)]:
                self._refuse(f"{kinds} for an array")
            return f"v_{name} = {code}"
        value = self._expected(kind)
        self._take(";")
        return f"v_{name} = {self._checked(kind, value)}"

    @staticmethod
    def _checked(kind, code):
        return {"Real": f"number({code})", "Integer": f"whole({code})"}.get(kind, code)

    def _assignable(self, name):
        if name in self._own.inputs or name in self._counting or self._own.own.get(name, ("",))[0] == "constant":
            self._refuse(f"{name} must not be assigned")
        return self._declared(name)

    def _declared(self, name):
        for place in (self._own.inputs, self._own.outputs, self._own.own):
            if name in place:
                kind, size = place[name]
                return (size, None) if kind == "constant" else (kind, size)
        if name in self._counting:
            return "Integer", None
        return self._refuse(f"{name} is not declared")

    # --- expressions: each method returns Python and the type

    def _expected(self, wanted):
        code, kind = self._expression()
        if kind == "Integer" and wanted == "Real":
            return f"float({code})"
        if kind != wanted:
            self._refuse(f"{kind} for {wanted}")
        return code

    def _expression(self):
        if not self._is("if"):
            return self._disjunction()
        self._take()
        test = self._expected("Boolean")
        self._take("then")
        then, kind = self._expression()
        self._take("else")
        return f"({then} if {test} else {self._expected(kind)})", kind

    def _chain(self, signs, inner, join):
        code, kind = inner()
        while self._is(*signs):
            code, kind = join(self._take(), code, kind, *inner())
        return code, kind

    def _disjunction(self):
        return self._chain(("or",), self._conjunction, self._logic)

    def _conjunction(self):
        return self._chain(("and",), self._negation, self._logic)

    def _logic(self, sign, a, first, b, second):
        if first != "Boolean" or second != "Boolean":
            self._refuse(f"{first} {sign} {second}")
        return f"({a} {'&' if sign == 'and' else '|'} {b})", "Boolean"

    def _negation(self):
        if not self._is("not"):
            return self._relation()
        self._take()
        code, kind = self._relation()
        if kind != "Boolean":
            self._refuse(f"not {kind}")
        return f"(not {code})", "Boolean"

    def _relation(self):
        code, kind = self._sum()
        if self._is("<", "<=", ">", ">=", "==", "<>"):
            sign = self._take()
            other, second = self._sum()
            if (kind == "Boolean") != (second == "Boolean"):
                self._refuse(f"{kind} {sign} {second}")
            return f"({code} {'!=' if sign == '<>' else sign} {other})", "Boolean"
        return code, kind

    def _sum(self):
        if self._is("-"):
            self._take()
            code, kind = self._product()
            if kind == "Boolean":
                self._refuse("- of a Boolean")
            first = f"(-{code})", kind
        else:
            first = self._product()
        code, kind = first
        while self._is("+", "-"):
            code, kind = self._computed(self._take(), code, kind, *self._product())
        return code, kind

    def _product(self):
        return self._chain(("*", "/"), self._power, self._computed)

    def _computed(self, sign, a, first, b, second):
        if "Boolean" in (first, second):
            self._refuse(f"{first} {sign} {second}")
        kind = "Integer" if first == second == "Integer" and sign != "/" else "Real"
        return f"({a} {sign} {b})", kind

    def _power(self):
        code, kind = self._primary()
        if self._is("^"):
            self._take()
            other, second = self._primary()
            if kind != "Real" or second != "Real":
                self._refuse(f"{kind} ^ {second}")
            return f"math.pow({code}, {other})", "Real"
        return code, kind

    def _primary(self):
        kind, text, _ = self._tokens[self._at]
        if kind in ("real", "int"):
            self._take()
            return text, "Real" if kind == "real" else "Integer"
        if self._is("("):
            self._take()
            code, kind = self._expression()
            self._take(")")
            return code, kind
        if self._is("true", "false"):
            return self._take().title(), "Boolean"
        if self._tokens[self._at + 1][1] == "(":
            name = self._take()
            if name in ("abs", "min", "max", "div", "mod", "integer", *_OF_ONE):
                return self._library(name)
            code, kinds = self._call(name)
            if len(kinds) != 1 or kinds[0][1] is not None:
                self._refuse(f"{name} has not one number as its result")
            return code, kinds[0][0]
        return self._variable()

    def _variable(self):
        name = self._name()
        if self._path + name in self._constants:
            kind, size, _ = self._constants[self._path + name]
            code = f"c_{f'{self._path}{name}'.replace('.', '_')}"
        else:
            kind, size = self._declared(name)
            code = f"v_{name}"
        if not self._is("["):
            if size is not None:
                self._refuse("an array in an expression")
            return code, kind
        self._take()
        index = self._expected("Integer")
        self._take("]")
        if size is None:
            self._refuse("no array")
        return f"element({code}, {index})", kind

    def _library(self, name):
        self._take("(")
        pairs = [self._expression()]
        while self._is(","):
            self._take()
            pairs.append(self._expression())
        self._take(")")
        kinds = {kind for _, kind in pairs}
        given = ", ".join(code for code, _ in pairs)
        if len(pairs) != (2 if name in ("min", "max", "div", "mod") else 1) or "Boolean" in kinds:
            self._refuse(f"{name} of {kinds}")
        if name in ("div", "mod"):
            if kinds != {"Integer"}:
                self._refuse(f"{name} of {kinds}")
            return (f"divided({given})" if name == "div" else f"(({pairs[0][0]}) % ({pairs[1][0]}))"), "Integer"
        if name == "integer":
            return f"whole(math.floor({given}))", "Integer"
        if name in ("abs", "min", "max"):
            return f"{name}({given})", "Integer" if kinds == {"Integer"} else "Real"
        return f"math.{_OF_ONE[name]}({given})", "Real"

    def _call(self, name):
        """Return the call of a function of the package, and the types of its results."""
        path = name if "." in name else self._path + name
        if path not in self._units:
            self._refuse(f"there is no function {path} before this one")
        unit, given = self._units[path], []
        self._take("(")
        for kind, size in unit.inputs.values():
            if given:
                self._take(",")
            if size is None:
                given.append(self._expected(kind))
            else:
                one = self._name()
                if self._declared(one) != (kind, size):
                    self._refuse("another array")
                given.append(f"v_{one}")
        self._take(")")
        return f"f_{path.replace('.', '_')}({', '.join(given)})", list(unit.outputs.values())
