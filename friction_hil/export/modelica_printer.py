"""Functions of a strict program as functions of Modelica."""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from friction_hil.export import ir
from friction_hil.export.arithmetic import binary, known
from friction_hil.export.ir import Block, Constant, Expression, Function, Operation, Variable
from friction_hil.export.st_printer import wrapped
from friction_hil.export.strict import StrictProgram

TYPES = {"real": "Real", "int": "Integer", "bool": "Boolean"}
STATE, GIVEN, SIZE = "state", "state_given", "states"
TRUNCATED = """\
function truncated "Return a number without its fraction"
  input Real x;
  output Integer y;
algorithm
  if x < 0.0 then
    y := -integer(-x);
  else
    y := integer(x);
  end if;
end truncated;
"""
# words of the language, its functions and its types, and names that are used here
_RESERVED = frozenset(
    (*("abs", "acos", "actualStream", "algorithm", "and", "annotation", "asin", "assert", "atan", "atan2", "block"),
     *("break", "cardinality", "ceil", "change", "class", "connect", "connector", "constant", "constrainedby", "cos"),
     *("cosh", "cross", "delay", "der", "diagonal", "discrete", "div", "each", "edge", "else", "elseif", "elsewhen"),
     *("encapsulated", "end", "enumeration", "equation", "exp", "expandable", "extends", "external", "false", "fill"),
     *("final", "floor", "flow", "for", "function", "getInstanceName", "homotopy", "identity", "if", "import"),
     *("impure", "in", "initial", "inner", "input", "inStream", "integer", "linspace", "log", "log10", "loop"),
     *("matrix", "max", "min", "mod", "model", "ndims", "noEvent", "not", "ones", "operator", "or", "outer"),
     *("outerProduct", "output", "package", "parameter", "partial", "pre", "product", "protected", "public", "pure"),
     *("record", "redeclare", "reinit", "rem", "replaceable", "return", "sample", "scalar", "semiLinear", "sign"),
     *("sin", "sinh", "size", "skew", "smooth", "spatialDistribution", "sqrt", "stream", "String", "sum"),
     *("symmetric", "tan", "tanh", "terminal", "terminate", "then", "time", "transpose", "true", "type", "vector"),
     *("when", "while", "within", "zeros", "Real", "Integer", "Boolean", STATE, GIVEN, SIZE))
)  # fmt: skip
_PRECEDENCE = {
    **dict.fromkeys(("*", "/"), 6),
    **dict.fromkeys(("+", "-"), 5),
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), 4),
    "and": 2,
    "or": 1,
}
_ATOM = 9
_ZERO = {"Real": "0.0", "Integer": "0", "Boolean": "false"}


@dataclass(slots=True)
class Layout:
    """Where the fields of the state are in its array: index of the first element, from 1."""

    program: StrictProgram
    first: dict[str, int] = field(default_factory=dict)
    size: int = 0

    def __post_init__(self) -> None:
        for one in self.program.fields:
            self.first[one.name] = self.size + 1
            self.size += len(one.initial)

    def initial(self) -> list[float]:
        """Return the values that the state begins with."""
        return [value for one in self.program.fields for value in one.initial]


def name_of(name: str) -> str:
    """Return a name as the language takes it."""
    plain = re.sub(r"\W+", "_", name).strip("_")
    return f"{plain}_value" if plain in _RESERVED else plain


def index_name(name: str) -> str:
    """Return the name of the constant that holds the index of a field."""
    return f"{name_of(name)}_at"


def literal(value: float) -> str:
    """Return a finite number with all its digits."""
    return repr(float(value))


class ModelicaPrinter:
    """Prints the functions of one program.

    Parameters
    ----------
    layout : Layout
    library : mapping of Function to str
        Functions that stand elsewhere, with their whole names.
    """

    def __init__(self, layout: Layout, library: Mapping[Function, str]) -> None:
        self._layout, self._library = layout, library
        self._tables = {each.name: each for each in layout.program.tables}
        self.uses_truncated = False

    def name(self, function: Function) -> str:
        """Return the name of a function, as it is called."""
        return self._library.get(function) or name_of(function.name)

    def function(self, function: Function) -> str:
        """Return the definition of a function."""
        self._function = function
        self._constants: dict[str, float] = {}
        self._read = {
            e.name
            for s in ir.statements(function.body)
            for x in ir.expressions(s)
            for e in ir.walk(x)
            if isinstance(e, Variable)
        }
        self._locals: dict[str, str] = {}
        body = self._block(_nested(function.body), 1, is_last=True)
        summary = function.summary.replace('"', "'").rstrip(".")
        lines = [f'function {name_of(function.name)} "{summary}"' if summary else f"function {name_of(function.name)}"]
        if function.reads_state:
            lines.append(f"  input Real {GIVEN if function.writes_state else STATE}[{SIZE}];")
        lines += [f"  input {TYPES[each.type]} {name_of(each.name)};" for each in function.parameters]
        lines += [f"  output {TYPES[kind]} result_{i};" for i, kind in enumerate(function.results)]
        if function.writes_state:
            lines.append(f"  output Real {STATE}[{SIZE}];")
        parameters = {each.name for each in function.parameters}
        own = [
            f"  {kind} {name_of(name)} = {_ZERO[kind]};"
            for name, kind in sorted(self._locals.items())
            if name not in parameters
        ]
        own += [
            f"  constant Real p_{name_of(name)} = {literal(value)};" for name, value in sorted(self._constants.items())
        ]
        begin = [f"  {STATE} := {GIVEN};"] if function.writes_state else []
        whole = [*lines, *(["protected", *own] if own else []), "algorithm", *begin, *body]
        return "\n".join([whole[0], *map(wrapped, whole[1:]), f"end {name_of(function.name)};"]) + "\n"

    # --- statements

    def _block(self, block: Block, depth: int, *, is_last: bool) -> list[str]:
        lines: list[str] = []
        for k, statement in enumerate(block):
            lines += self._statement(statement, depth, is_last=is_last and k == len(block) - 1)
        return lines

    def _statement(self, statement: ir.Statement, depth: int, *, is_last: bool) -> list[str]:
        indent = "  " * depth
        match statement:
            case ir.Assign(target, value):
                return [f"{indent}{self._target(target)} := {self._stored(target, value)};"]
            case ir.CallStatement(targets, function, operands):
                return [f"{indent}{self._results(targets, function)} := {self._called(function, operands)};"]
            case ir.If(test, then, other):
                lines = [f"{indent}if {self.expression(test)} then", *self._block(then, depth + 1, is_last=is_last)]
                while len(other) == 1 and isinstance(other[0], ir.If):
                    lines.append(f"{indent}elseif {self.expression(other[0].test)} then")
                    lines += self._block(other[0].then, depth + 1, is_last=is_last)
                    other = other[0].other
                if other:
                    lines += [f"{indent}else", *self._block(other, depth + 1, is_last=is_last)]
                return [*lines, f"{indent}end if;"]
            case ir.For(variable, start, stop, step, body):
                last = self.expression(binary("-" if step > 0 else "+", stop, known(1)))
                by = "" if step == 1 else f"{f'({step})' if step < 0 else step}:"
                head = f"{indent}for {name_of(variable.name)} in {self.expression(start)}:{by}{last} loop"
                return [head, *self._block(body, depth + 1, is_last=False), f"{indent}end for;"]
            case ir.While(test, body):
                head = f"{indent}while {self.expression(test)} loop"
                return [head, *self._block(body, depth + 1, is_last=False), f"{indent}end while;"]
            case ir.Return(values):
                lines = []
                if self._function.results:
                    lines = [f"{indent}result_{i} := {self.expression(value)};" for i, value in enumerate(values)]
                return lines if is_last and lines else [*lines, f"{indent}return;"]
            case ir.Jump("break"):
                return [f"{indent}break;"]
        raise ValueError(f"{statement} has no translation")

    def _target(self, target: Variable | ir.Load) -> str:
        if isinstance(target, Variable):
            self._locals[target.name] = TYPES[target.type]
            return name_of(target.name)
        return self._place(target)

    def _stored(self, target: Variable | ir.Load, value: Expression) -> str:
        text = self.expression(value)
        if isinstance(target, ir.Load) and target.type == "bool":
            return {"true": "1.0", "false": "0.0"}.get(text) or f"if {text} then 1.0 else 0.0"
        return text

    def _results(self, targets: Iterable[Variable], function: Function) -> str:
        places = []
        for each in targets:
            name = each.name if each.name in self._read else f"unread_{each.type}"
            self._locals[name] = TYPES[each.type]
            places.append(name_of(name))
        if function.writes_state:
            places.append(STATE)
        return places[0] if len(places) == 1 else f"({', '.join(places)})"

    # --- expressions

    def expression(self, expression: Expression) -> str:
        """Return an expression as text."""
        return self._text(expression)[0]

    def _place(self, one: ir.Load) -> str:
        first = index_name(one.field)
        if one.index is None or (isinstance(one.index, Constant) and one.index.value == 0):
            return f"{STATE}[{first}]"
        return f"{STATE}[{first} + {self._at_least(one.index, 6)}]"

    def _text(self, expression: Expression) -> tuple[str, int]:
        match expression:
            case Constant():
                return self._literal(expression)
            case Variable(name=name):
                return name_of(name), _ATOM
            case ir.Load(type=kind):
                place = self._place(expression)
                return (place, _ATOM) if kind != "bool" else (f"({place} > 0.5)", _ATOM)
            case ir.Element(table=table, index=index):
                at = binary("+", index, known(1 - self._tables[table].used[0]))
                return f"{name_of(table)}_table[{self.expression(at)}]", _ATOM
            case ir.Call(function=function, operands=operands):
                return self._called(function, operands), _ATOM
            case Operation():
                return self._operation(expression)
        raise TypeError(expression)

    def _called(self, function: Function, operands: Iterable[Expression]) -> str:
        given = [STATE] if function.reads_state else []
        return f"{self.name(function)}({', '.join([*given, *map(self.expression, operands)])})"

    def _operation(self, one: Operation) -> tuple[str, int]:
        name, operands = one.name, one.operands
        if name == "neg":
            return f"-{self._at_least(operands[0], _ATOM)}", 3
        if name == "not":
            return f"not {self._at_least(operands[0], _ATOM)}", 3
        if name == "cast":
            return self._text(operands[0])  # a whole number where a number is wanted becomes one
        if name == "pow":
            return f"{self._at_least(operands[0], _ATOM)} ^ {self._at_least(operands[1], _ATOM)}", 7
        if name in _PRECEDENCE:
            own = _PRECEDENCE[name]
            needed = 5 if own == 4 else own if own > 4 else _ATOM
            is_chain = own <= 2 and isinstance(operands[0], Operation) and operands[0].name == name
            left = self._at_least(operands[0], own if is_chain else needed)
            right = self._at_least(operands[1], needed + 1 if own > 4 else needed)
            return f"{left} {'<>' if name == '!=' else name} {right}", own
        if name == "truncate":
            self.uses_truncated = True
        shown = {"fabs": "abs", "truncate": "Library.truncated"}.get(name, name)
        return f"{shown}({', '.join(map(self.expression, operands))})", _ATOM

    def _at_least(self, expression: Expression, precedence: int) -> str:
        text, own = self._text(expression)
        return text if own >= precedence else f"({text})"

    def _literal(self, constant: Constant) -> tuple[str, int]:
        if constant.type == "bool":
            return ("true" if constant.value else "false"), _ATOM
        is_negative = math.copysign(1.0, constant.value) < 0.0
        if constant.type == "int":
            return str(int(constant.value)), 3 if is_negative else _ATOM
        if constant.name and self._constants.setdefault(constant.name, constant.value) == constant.value:
            return f"p_{name_of(constant.name)}", _ATOM
        return literal(constant.value), 3 if is_negative else _ATOM


def _nested(block: Block) -> Block:
    """Return a block with what follows a branch that returns in the other branch, where ``return`` is not needed."""
    result: Block = []
    for k, statement in enumerate(block):
        if not isinstance(statement, ir.If):
            result.append(statement)
            continue
        then, other, rest = _nested(statement.then), _nested(statement.other), block[k + 1 :]
        if rest and _returns(then):
            return [*result, ir.If(statement.test, then, _nested([*other, *rest]))]
        if rest and _returns(other):
            return [*result, ir.If(statement.test, _nested([*then, *rest]), other)]
        result.append(ir.If(statement.test, then, other))
    return result


def _returns(block: Block) -> bool:
    """Return True if a block ends the function in any case."""
    if not block:
        return False
    last = block[-1]
    return isinstance(last, ir.Return) or (isinstance(last, ir.If) and _returns(last.then) and _returns(last.other))
