"""Model and compensator as C99: a header and a source file, for the firmware of a drive or a controller."""

import math
import textwrap
from collections.abc import Iterator, Sequence

from friction_hil.export import ir
from friction_hil.export.arithmetic import FUNCTIONS
from friction_hil.export.c_printer import Printer, literal
from friction_hil.export.counting import operations
from friction_hil.export.kernels import (
    CYCLES,
    LARGEST_INPUT,
    LARGEST_POSITION,
    MODEL_INPUTS,
    Program,
    compensator_program,
    model_program,
)
from friction_hil.export.subject import Subject, provenance

REBASED = 1048576  # cycles, 2^20: cycle numbers stay below twice that, which single precision holds exactly
MOST_CYCLES = 1 << 30  # longer gaps count as this: whole numbers of the source hold it with room to spare
_LARGEST_SINGLE = 3.4e38
_SMALLEST_SINGLE = 1.2e-38

_INPUTS = (
    ("uint32_t", "cycles", f"since the last step: 1, and more after missed cycles; above {MOST_CYCLES} as that"),
    ("double", "position", "{angle}, measured"),
    ("{real}", "velocity", "{angle}/s, of the drive; only an estimator of the kind drive uses it"),
    ("{real}", "torque", "{torque}, actual torque of the drive"),
    ("double", "position_demand", "{angle}, when the position was sampled"),
    ("{real}", "velocity_demand", "{angle}/s, when the position was sampled"),
    ("{real}", "velocity_demand_ahead", "{angle}/s, when this cycle's torque will act"),
    ("{real}", "acceleration_demand_ahead", "{angle}/s^2, likewise"),
    ("{real}", "temperature", "deg C, measured"),
    ("{real}", "load_torque", "{torque}, all of the load; NAN: by gravity and inertia of the model"),
    ("bool", "is_fresh", "the feedback is of this cycle"),
    ("bool", "is_enabled", "fade in; otherwise fade out"),
)

_HELPERS = {
    "least": "static real least(real a, real b)\n{\n    return (b < a) ? b : a;\n}\n",
    "largest": "static real largest(real a, real b)\n{\n    return (b > a) ? b : a;\n}\n",
    "least_wide": "static double least_wide(double a, double b)\n{\n    return (b < a) ? b : a;\n}\n",
    "largest_wide": "static double largest_wide(double a, double b)\n{\n    return (b > a) ? b : a;\n}\n",
    "least_int": "static int32_t least_int(int32_t a, int32_t b)\n{\n    return (b < a) ? b : a;\n}\n",
    "largest_int": "static int32_t largest_int(int32_t a, int32_t b)\n{\n    return (b > a) ? b : a;\n}\n",
    "floor_division": (
        "/* a / b, rounded down; b is above zero. */\nstatic int32_t floor_division(int32_t a, int32_t b)\n{\n"
        "    return (a >= 0) ? (a / b) : -((b - 1 - a) / b);\n}\n"
    ),
}


def files(subject: Subject) -> dict[str, str]:
    """Return header and source, by the names of their files."""
    model = _Part(subject.name, "model", model_program(subject.model_file.friction_model))
    parts = [model]
    if subject.compensator is not None:
        program = compensator_program(subject.compensator)
        parts.append(_Part(subject.name, "compensator", program))
    bodies = [part.body() for part in parts]
    return {
        f"{subject.name}.h": _header(subject, parts),
        f"{subject.name}.c": _source(subject, parts, bodies),
    }


class _Part:
    """Model or compensator: a type for the state, a function that begins it, and one that advances it."""

    def __init__(self, name: str, kind: str, program: Program) -> None:
        self.real = f"{name}_real"
        self.name, self.kind, self.program = f"{name}_{kind}", kind, program
        self.printer = Printer(kind, self.name, program.tables)
        used = [(field, one) for field, one in program.state.fields.items() if one.is_used]
        self.fields = sorted(used, key=lambda pair: pair[1].type != "wide")  # no gaps between them

    def struct(self) -> str:
        """Return the type of the state."""
        lines = [
            f"    {'double' if one.type == 'wide' else self.real} {field}{f'[{one.extent}]' if one.is_array else ''};"
            for field, one in self.fields
        ]
        if not lines:
            lines = ["    uint8_t unused; /* this model has no state */"]
        return "typedef struct {\n" + "\n".join(lines) + f"\n}} {self.name};\n"

    def size(self, single: bool) -> int:
        """Return the size of the state in bytes."""
        total = sum(one.extent * (4 if single and one.type != "wide" else 8) for _, one in self.fields)
        has_wide = any(one.type == "wide" for _, one in self.fields)
        whole = 8 if has_wide or not single else 4
        return max(-(-total // whole) * whole, 0 if self.fields else 1) if self.fields else 1

    def cost(self) -> str:
        """Return the operations of a step in the worst case, as text."""
        count = operations(self.program.entry)
        return ", ".join(f"{number} {name}" for name, number in sorted(count.items(), key=_cost_order)) or "none"

    def body(self) -> str:
        """Return everything about it in the source file."""
        functions = [self.printer.function(each) for each in self.program.functions]
        tables = [self.printer.table(each) for each in self.program.tables]
        pairs = [
            "typedef struct {\n" + "".join(f"    {_C[kind]} v{i};\n" for i, kind in enumerate(kinds)) + f"}} {name};\n"
            for name, kinds in self.printer.pairs.items()
        ]
        step = self._model_step() if self.kind == "model" else self._compensator_step()
        return "\n".join([*pairs, *tables, *functions, self._init(), step])

    def _init(self) -> str:
        lines: list[str] = []
        for field, one in self.fields:
            values = one.initial[: one.extent]
            if not one.is_array:
                lines.append(f"    s->{field} = {literal(float(values[0]), one.type)};")
            elif all(value == values[0] for value in values):
                lines.append(f"    for (int32_t i = 0; i < {one.extent}; i++) {{")
                lines.append(f"        s->{field}[i] = {literal(float(values[0]), one.type)};\n    }}")
            else:
                lines += [f"    s->{field}[{i}] = {literal(float(each), one.type)};" for i, each in enumerate(values)]
        lines = lines or ["    s->unused = 0U;"]
        return f"void {self.name}_init({self.name} *s)\n{{\n" + "\n".join(lines) + "\n}\n"

    def _entry(self) -> str:
        entry = self.program.entry
        given = ["s"] if entry.reads_state else []
        return f"{self.printer.name(entry)}({', '.join([*given, *(each.name for each in self.program.operands)])})"

    def head(self) -> str:
        """Return the declaration of the step."""
        if self.kind == "compensator":
            return f"{self.real} {self.name}_step({self.name} *s, const {self.name}_input *in)"
        inputs = [f"{'double' if each.type == 'wide' else self.real} {each.name}" for each in self.program.inputs]
        given = textwrap.fill(", ".join([f"{self.name} *s", *inputs]), 112, subsequent_indent="    ")
        return f"{self.real} {self.name}_step(\n    {given})"

    def _model_step(self) -> str:
        used = {each.name for each in self.program.operands}
        lines = [f"    (void){name};" for name in MODEL_INPUTS if name not in used]
        if not self.program.entry.reads_state:
            lines.insert(0, "    (void)s;")
        return f"{self.head()}\n{{\n" + "\n".join([*lines, f"    return {self._entry()};"]) + "\n}\n"

    def _compensator_step(self) -> str:
        """Return the step with the count of cycles, which goes on for ever and is kept small."""
        lines = [f"    const uint32_t passed = (in->cycles < {MOST_CYCLES}U) ? in->cycles : {MOST_CYCLES}U;"]
        for each in self.program.operands:
            value = f"in->{each.name}"
            if each.name == "cycle":
                value = "s->cycle + (real)passed"
            elif each.name in ("is_fresh", "is_enabled"):
                value = f"{value} ? R(1.0) : R(0.0)"
            lines.append(f"    const {_C[each.type]} {each.name} = {value};")
        lines.append(f"    const real torque_ = {self._entry()};")
        lines.append(f"    if (s->cycle >= R({REBASED}.0)) {{")
        lines.append(f"        const real times = s->cycle / R({REBASED}.0);")
        lines.append("        const int32_t whole_times = (int32_t)times;")
        lines.append(f"        const real whole = R({REBASED}.0) * (real)whole_times;")
        lines += [f"        s->{field} -= whole;" for field, _ in self.fields if field in CYCLES]
        return f"{self.head()}\n{{\n" + "\n".join([*lines, "    }", "    return torque_;"]) + "\n}\n"

    def too_large(self) -> list[str]:
        """Return the names of numbers that single precision cannot hold."""
        statements = (each for function in self.program.functions for each in ir.statements(function.body))
        everything = (each for one in statements for whole in ir.expressions(one) for each in ir.walk(whole))
        constants = (each for each in everything if isinstance(each, ir.Constant))
        wrong = [each.name or repr(each.value) for each in constants if _is_beyond_single(each.value)]
        for table in self.program.tables:
            used = range(table.used[0], table.used[1] + 1)
            wrong += [table.name_of(k) or table.name for k in used if _is_beyond_single(float(table.values[k]))]
        return list(dict.fromkeys(wrong))


_C = {"real": "real", "wide": "double", "int": "int32_t", "bool": "bool"}


def _is_beyond_single(value: float) -> bool:
    return math.isfinite(value) and value != 0.0 and not _SMALLEST_SINGLE < abs(value) < _LARGEST_SINGLE


def _cost_order(item: tuple[str, int]) -> tuple[bool, str]:
    return item[0] in FUNCTIONS, item[0]


def comment(lines: Sequence[str]) -> str:
    """Return lines as a comment, which none of them can end."""
    wrapped: list[str] = []
    for line in lines:
        indent = " " * (len(line) - len(line.lstrip()) + 2)
        wrapped += textwrap.wrap(line, 116, subsequent_indent=indent, drop_whitespace=True) or [""]
    text = "\n".join(f" * {line}".rstrip() for line in wrapped)
    for own, shown in (("*/", "* /"), ("/*", "/ *"), ("??", "? ?")):  # ends, beginnings, trigraphs
        text = text.replace(own, shown)
    return "/*" + text[2:] + "\n */\n"


def _about(subject: Subject, parts: Sequence[_Part]) -> Iterator[str]:
    yield from provenance(subject)
    yield ""
    for part in parts:
        yield f"{part.name}: state {part.size(False)} bytes, in single precision {part.size(True)} bytes."
        yield f"  In the worst case a step takes {part.cost()}."
    yield ""
    macro = _macro(subject)
    yield (
        f"Numbers are double. With {macro} defined, here and in every file that includes this one, they are float; "
        "positions stay double, because a float does not hold what an encoder resolves."
    )
    yield "Compile without -ffast-math: NaN and infinity have a meaning here."


def _macro(subject: Subject) -> str:
    return f"{subject.name.upper()}_SINGLE"


def _header(subject: Subject, parts: Sequence[_Part]) -> str:
    guard, real = f"{subject.name.upper()}_H", f"{subject.name}_real"
    angle, torque = ("rad", "N m") if subject.model_file.axis == "rotary" else ("m", "N")
    macro = _macro(subject)
    lines = [
        comment(list(_about(subject, parts))),
        f"#ifndef {guard}\n#define {guard}\n",
        "#include <stdbool.h>\n#include <stdint.h>\n",
        f"#ifdef {macro}\ntypedef float {real};\n#else\ntypedef double {real};\n#endif\n",
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
    ]
    for part in parts:
        lines.append(part.struct())
        if part.kind == "compensator":
            lines.append(_input_struct(part, real, angle, torque))
        lines.append(f"/* Begin at rest. */\nvoid {part.name}_init({part.name} *s);\n")
        lines.append(f"{_explained(part, angle, torque)}{part.head()};\n")
    lines += ["#ifdef __cplusplus\n}\n#endif\n", "#endif\n"]
    return "\n".join(lines)


def _input_struct(part: _Part, real: str, angle: str, torque: str) -> str:
    rows = [(f"    {kind.format(real=real)} {name};", text) for kind, name, text in _INPUTS]
    width = max(len(begin) for begin, _ in rows)
    lines = [f"{begin:<{width}} /* {text.format(angle=angle, torque=torque)} */" for begin, text in rows]
    head = "/* Inputs of one cycle; NAN where something is unknown. */\ntypedef struct {\n"
    return head + "\n".join(lines) + f"\n}} {part.name}_input;\n"


def _explained(part: _Part, angle: str, torque: str) -> str:
    text = (
        f"Compute one cycle and return the compensation, {torque}, within its limit. A step is due in every period. "
        "Where the model's torque is not finite, zero is used instead and the field is_faulty is 1."
    )
    if part.kind == "model":
        text = (
            f"Advance by dt seconds with the velocity held, and return the friction, {torque}, which opposes positive "
            f"velocity where it is positive. position: {angle}, at the end of the step; load_torque: {torque}, "
            "positive if it opposes positive motion; temperature: deg C, NAN for that of the parameters; "
            f"applied_torque: {torque}, which a static map balances at rest. Inputs are finite but for the "
            f"temperature, and dt is above zero; those beyond {LARGEST_INPUT:g} (position: {LARGEST_POSITION:g}) count "
            "as that, so that the friction is finite; those that this model does not depend on are ignored."
        )
    return comment([text])


def _source(subject: Subject, parts: Sequence[_Part], bodies: Sequence[str]) -> str:
    used = set().union(*(part.printer.used for part in parts))
    macro = _macro(subject)
    functions = sorted(each for each in used if each.startswith("m_"))
    single = [f"#define {each} {each[2:]}f" for each in functions]
    double = [f"#define {each} {each[2:]}" for each in functions]
    wrong = [name for part in parts for name in part.too_large()]
    if wrong:
        single.append(f'#error "single precision cannot hold {", ".join(wrong)}"')
    constants = {name: value for part in parts for name, value in part.printer.constants.items()}
    lines = [
        f"/* {subject.name}.h says what this is. Made by a program; change the model and export it again. */\n",
        f'#include "{subject.name}.h"\n\n#include <math.h>\n',
        f"typedef {subject.name}_real real;\n",
        f"#ifdef {macro}\n" + "\n".join(single) + "\n#else\n" + "\n".join(double) + "\n#endif\n",
        "#define R(number) ((real)(number))\n",
        "".join(f"#define {name} {literal(value)}\n" for name, value in sorted(constants.items())),
        *(_HELPERS[each] for each in _HELPERS if each in used),
        *bodies,
    ]
    return "\n".join(line for line in lines if line)
