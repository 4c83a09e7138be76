"""Functions of a program as C99."""

import math
import re
from collections.abc import Iterable, Sequence

from friction_hil.export import ir
from friction_hil.export.arithmetic import FUNCTIONS
from friction_hil.export.ir import Block, Constant, Expression, Function, Variable
from friction_hil.export.values import Table

TYPES = {"real": "real", "wide": "double", "int": "int32_t", "bool": "bool"}
# words of C, and names in its library that a variable had better not have
_RESERVED = frozenset(
    (*("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern"),
     *("float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed"),
     *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while", "bool"),
     *("true", "false", "real", "s", "gamma", "y0", "y1", "yn", "j0", "j1", "jn", "index", "signal", "time", "div"),
     *("exp", "log", "sin", "cos", "tanh", "sqrt", "pow"))
)  # fmt: skip
_PRECEDENCE = {
    **dict.fromkeys(("*", "/", "//", "%"), 6),
    **dict.fromkeys(("+", "-"), 5),
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), 4),
    "&": 3,
    "and": 2,
    "or": 1,
}
_SIGNS = {"and": "&&", "or": "||", "//": "/"}
_ATOM = 9


class Printer:
    """Prints the functions of one program. ``prefix``: of the functions and tables, which are local to the file."""

    def __init__(self, prefix: str, state_type: str, tables: Sequence[Table]) -> None:
        self._prefix, self._state_type = prefix, state_type
        self._tables = {each.name: each for each in tables}
        self.constants: dict[str, float] = {}
        self.used: set[str] = set()  # functions of the library and helpers
        self.pairs: dict[str, tuple[ir.Type, ...]] = {}

    # --- whole functions and tables

    def function(self, function: Function) -> str:
        """Return the definition of a function."""
        read = {
            e.name
            for s in ir.statements(function.body)
            for x in ir.expressions(s)
            for e in ir.walk(x)
            if isinstance(e, Variable)
        }
        self._read = read
        self._results = function.results
        names = {each.name for each in function.parameters}
        declared = _Declarations(function.body, names)
        body = self._block(function.body, declared, 1)
        comment = f"/* {function.summary} */\n" if function.summary else ""
        return f"{comment}{self._head(function)}\n{{\n{body}}}\n"

    def _head(self, function: Function) -> str:
        parameters = [f"{self._state_type} *s"] if function.writes_state else []
        if function.reads_state and not function.writes_state:
            parameters = [f"const {self._state_type} *s"]
        parameters += [f"{TYPES[each.type]} {_name(each.name)}" for each in function.parameters]
        return f"static {self._result(function.results)} {self.name(function)}({', '.join(parameters) or 'void'})"

    def _result(self, results: Sequence[ir.Type]) -> str:
        if len(results) < 2:
            return TYPES[results[0]] if results else "void"
        name = f"{self._prefix}_" + "_".join(results)
        self.pairs[name] = tuple(results)
        return name

    def name(self, function: Function) -> str:
        """Return the name of a function in C."""
        return f"{self._prefix}_{function.name}"

    def table(self, table: Table) -> str:
        """Return the definition of a table, from the first element to the last one that is used."""
        low, high = table.used
        rows = [self._literal(Constant("real", float(each))) for each in table.values[low : high + 1]]
        lines = [f"    {', '.join(rows[k : k + 4])}," for k in range(0, len(rows), 4)]
        lines[-1] = lines[-1].rstrip(",")
        name = f"{self._prefix}_{table.name}_table"
        return f"static const real {name}[{len(rows)}] = {{\n" + "\n".join(lines) + "\n};\n"

    # --- statements

    def _block(self, block: Block, declared: "_Declarations", depth: int) -> str:
        lines: list[str] = []
        for statement in block:
            fresh = declared.before(statement)
            lines += self._statement(statement, declared, depth, fresh)
        indent = "    " * depth
        return "".join(f"{line if line.startswith(' ') else indent + line}\n" for line in lines)

    def _statement(
        self, statement: ir.Statement, declared: "_Declarations", depth: int, fresh: dict[str, tuple[ir.Type, bool]]
    ) -> list[str]:
        named: tuple[str, ...] = ir.targets(statement) if isinstance(statement, ir.Assign) else ()
        if isinstance(statement, ir.CallStatement) and len(statement.targets) == 1:
            named = ir.targets(statement)
        lines = [f"{TYPES[kind]} {_name(name)};" for name, (kind, _) in fresh.items() if name not in named]
        match statement:
            case ir.Assign(Variable(name=name), value):
                begin = _name(name)
                if name in fresh:
                    kind, is_constant = fresh[name]
                    begin = f"{'const ' if is_constant else ''}{TYPES[kind]} {begin}"
                lines.append(f"{begin} = {self.expression(value)};")
            case ir.Assign(target, value):
                lines.append(f"{self.expression(target)} = {self.expression(value)};")
            case ir.CallStatement():
                lines += self._call(statement, depth, fresh)
            case ir.If(test, then, other):
                lines.append(f"if ({self.expression(test)}) {{")
                inner, is_chain = self._block(then, declared, depth + 1), False
                while len(other) == 1 and isinstance(other[0], ir.If) and not declared.peek(other[0]):
                    lines += [inner.rstrip("\n"), f"}} else if ({self.expression(other[0].test)}) {{"]
                    inner, other, is_chain = self._block(other[0].then, declared, depth + 1), other[0].other, True
                lines.append(inner.rstrip("\n"))
                if other:
                    lines += ["} else {", self._block(other, declared, depth + 1).rstrip("\n")]
                elif is_chain:  # MISRA C:2012, rule 15.7
                    lines += ["} else {", "    " * (depth + 1) + "/* nothing */"]
                lines.append("}")
            case ir.For(variable, start, stop, step, body):
                name = _name(variable.name)
                sign, change = ("<", f"{name} += {step}") if step > 0 else (">", f"{name} -= {-step}")
                if abs(step) == 1:
                    change = f"{name}{'++' if step > 0 else '--'}"
                head = f"int32_t {name} = {self.expression(start)}; {name} {sign} {self.expression(stop)}; {change}"
                lines += [f"for ({head}) {{", self._block(body, declared, depth + 1).rstrip("\n"), "}"]
            case ir.While(test, body):
                inner = self._block(body, declared, depth + 1).rstrip("\n")
                lines += [f"while ({self.expression(test)}) {{", inner, "}"]
            case ir.Return(values):
                lines += self._return(values)
            case ir.Jump(kind):
                lines.append(f"{kind};")
        indent = "    " * depth
        return [line if "\n" in line or line.startswith(" ") else indent + line for line in lines]

    def _call(self, statement: ir.CallStatement, depth: int, fresh: dict[str, tuple[ir.Type, bool]]) -> list[str]:
        call = self._called(statement.function, statement.operands)
        wanted = [(i, each) for i, each in enumerate(statement.targets) if each.name in self._read]
        if not wanted:
            return [f"{'(void)' if statement.targets else ''}{call};"]
        if len(statement.targets) == 1:
            name = wanted[0][1].name
            kind = f"{'const ' if fresh[name][1] else ''}{TYPES[fresh[name][0]]} " if name in fresh else ""
            return [f"{kind}{_name(name)} = {call};"]
        result = self._result([each.type for each in statement.targets])
        lines = ["{", f"    const {result} got = {call};"]
        lines += [f"    {_name(each.name)} = got.v{i};" for i, each in wanted]
        return ["    " * depth + line for line in [*lines, "}"]]

    def _return(self, values: Sequence[Expression]) -> list[str]:
        if not values or not self._results:
            return ["return;"]
        if len(values) == 1:
            return [f"return {self.expression(values[0])};"]
        result = self._result(self._results)
        fields = ", ".join(map(self.expression, values))
        return [f"return ({result}){{{fields}}};"]

    # --- expressions

    def expression(self, expression: Expression) -> str:
        """Return an expression as text."""
        return self._text(expression)[0]

    def _text(self, expression: Expression) -> tuple[str, int]:
        match expression:
            case Constant():
                return self._literal(expression), _ATOM
            case Variable(name=name):
                return _name(name), _ATOM
            case ir.Load(field=field, index=index):
                return f"s->{field}" + ("" if index is None else f"[{self.expression(index)}]"), _ATOM
            case ir.Element(table=table, index=index):
                return self._element(table, index), _ATOM
            case ir.Call(function=function, operands=operands):
                return self._called(function, operands), _ATOM
            case ir.Operation():
                return self._operation(expression)
        raise TypeError(expression)

    def _element(self, table: str, index: Expression) -> str:
        from friction_hil.export.arithmetic import binary, known

        own = self._tables[table]
        return f"{self._prefix}_{table}_table[{self.expression(binary('+', index, known(-own.used[0])))}]"

    def _called(self, function: Function, operands: Iterable[Expression]) -> str:
        given = ["s"] if function.reads_state else []
        return f"{self.name(function)}({', '.join([*given, *map(self.expression, operands)])})"

    def _operation(self, operation: ir.Operation) -> tuple[str, int]:
        name, operands = operation.name, operation.operands
        if name == "cast":
            return f"({TYPES[operation.type]}){self._at_least(operands[0], _ATOM)}", 8
        if name == "neg":
            return f"-{self._at_least(operands[0], 8)}", 7
        if name == "not":
            return f"!{self._at_least(operands[0], 8)}", 8
        if name == "select":
            test, then, other = (self._at_least(each, 3) for each in operands)
            return f"({test} ? {then} : {other})", _ATOM
        if name == "//":
            self.used.add("floor_division")
            return f"floor_division({', '.join(map(self.expression, operands))})", _ATOM
        if name in _PRECEDENCE:
            return self._infix(operation)
        values = ", ".join(map(self.expression, operands))
        if name in ("isfinite", "isnan"):
            return f"({name}({values}) != 0)", _ATOM
        shown = name
        if operation.type == "wide":
            shown = {"min": "least_wide", "max": "largest_wide"}.get(name, name)
        elif name in ("min", "max"):
            shown = {"min": "least", "max": "largest"}[name] + ("_int" if operation.type == "int" else "")
        elif name in (*FUNCTIONS, "fabs"):
            shown = f"m_{name}"
        self.used.add(shown)
        return f"{shown}({values})", _ATOM

    def _infix(self, operation: ir.Operation) -> tuple[str, int]:
        name, (a, b) = operation.name, operation.operands
        own = _PRECEDENCE[name]
        needed = own
        if own <= 4:  # what is compared or joined stands in brackets, for the reader
            needed = 5 if own == 4 else _ATOM
        if "wide" in (a.type, b.type):  # in double precision, and said so
            a, b = (each if each.type == "wide" else _wide(each) for each in (a, b))
        left = self._at_least(a, own if name in ("and", "or") and _is_same(a, name) else needed)
        right = self._at_least(b, needed + 1 if own > 4 else needed)
        if isinstance(b, Constant) and b.type == "int" and b.value < 0 and name == "+":
            return f"{left} - {-int(b.value)}", own
        text = f"{left} {_SIGNS.get(name, name)} {right}"
        if operation.type == "real" and "wide" in (a.type, b.type):
            return f"(real)({text})", 8  # the difference of positions: small, and so held by single precision
        return text, own

    def _at_least(self, expression: Expression, precedence: int) -> str:
        text, own = self._text(expression)
        return text if own >= precedence else f"({text})"

    def _literal(self, constant: Constant) -> str:
        if constant.type == "bool":
            return "true" if constant.value else "false"
        if constant.type == "int":
            return str(int(constant.value))
        if constant.name:
            name = "P_" + re.sub(r"\W+", "_", constant.name).strip("_").upper()
            known = self.constants.setdefault(name, constant.value)
            if known == constant.value or (math.isnan(known) and math.isnan(constant.value)):
                return name
        return literal(constant.value, constant.type)


def literal(value: float, kind: ir.Type = "real") -> str:
    """Return a number as text, with all its digits."""
    if math.isfinite(value):
        text = repr(float(value))
        text = text if kind == "wide" else f"R({text})"
        return f"({text})" if kind == "wide" and value < 0.0 else text
    name = "NAN" if math.isnan(value) else "-INFINITY" if value < 0.0 else "INFINITY"
    return f"R({name})" if kind != "wide" else f"((double){name})"


def _wide(value: Expression) -> Expression:
    if isinstance(value, Constant):
        return Constant("wide", value.value)
    return ir.Operation("wide", "cast", (value,))


def _is_same(operand: Expression, name: str) -> bool:
    return isinstance(operand, ir.Operation) and operand.name == name


def _name(name: str) -> str:
    return f"{name}_" if name in _RESERVED else name


class _Declarations:
    """Where each variable is declared: in the innermost block with everything about it, before its first statement."""

    def __init__(self, body: Block, parameters: set[str]) -> None:
        self._at: dict[int, dict[str, tuple[ir.Type, bool]]] = {}
        types: dict[str, ir.Type] = {}
        assigned: dict[str, int] = {}
        for statement in ir.statements(body):
            variables: list[Variable] = []
            match statement:
                case ir.Assign(Variable() as one, _):
                    variables = [one]
                case ir.CallStatement(several):
                    variables = several
            for one in variables:
                types[one.name] = one.type
                assigned[one.name] = assigned.get(one.name, 0) + 1
        for name in types.keys() - parameters:
            self._place(name, types[name], assigned[name], body)

    def _place(self, name: str, kind: ir.Type, assigned: int, block: Block) -> None:
        using = [each for each in block if _mentions(each, name)]
        if not any(_is_read(each, name) for each in using):
            return  # a result that nobody wants
        if len(using) == 1 and not _mentions_itself(using[0], name):
            inner = [each for each in ir.blocks(using[0]) if any(_mentions(one, name) for one in each)]
            if len(inner) == 1:
                self._place(name, kind, assigned, inner[0])
                return
        first = using[0]
        is_single = isinstance(first, ir.CallStatement) and len(first.targets) == 1
        is_constant = assigned == 1 and (isinstance(first, ir.Assign) or is_single)
        self._at.setdefault(id(using[0]), {})[name] = kind, is_constant

    def before(self, statement: ir.Statement) -> dict[str, tuple[ir.Type, bool]]:
        """Return the variables to declare before or in a statement, each with its type and whether it is constant."""
        return dict(sorted(self._at.get(id(statement), {}).items()))

    def peek(self, statement: ir.Statement) -> bool:
        """Return True if something is to be declared before a statement."""
        return id(statement) in self._at


def _mentions_itself(statement: ir.Statement, name: str) -> bool:
    read = any(isinstance(e, Variable) and e.name == name for x in ir.expressions(statement) for e in ir.walk(x))
    return read or name in ir.targets(statement)


def _mentions(statement: ir.Statement, name: str) -> bool:
    return any(_mentions_itself(each, name) for each in ir.statements([statement]))


def _is_read(statement: ir.Statement, name: str) -> bool:
    return any(
        isinstance(e, Variable) and e.name == name
        for each in ir.statements([statement])
        for x in ir.expressions(each)
        for e in ir.walk(x)
    )
