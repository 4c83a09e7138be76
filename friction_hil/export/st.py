"""Model and compensator as Structured Text of IEC 61131-3, for CODESYS, TwinCAT and others: function blocks."""

import textwrap
from collections.abc import Iterable

from friction_hil.export import plcopen, strict_library
from friction_hil.export.c import REBASED
from friction_hil.export.ir import Variable
from friction_hil.export.kernels import CYCLES, Program, compensator_program, model_program
from friction_hil.export.st_printer import STATE, Declared, Pou, StPrinter, field_name, literal, table_name
from friction_hil.export.strict import OPTIONAL, PLAUSIBLE, UNKNOWN, StrictField, strict
from friction_hil.export.strict_expressions import flag
from friction_hil.export.strict_library import UNLIMITED
from friction_hil.export.subject import Subject, provenance

_PUBLIC = {"dt": "elapsed"}  # dt is a type of the language

COMMENTS = {
    "model": {
        "velocity": "{angle}/s, held since the last call",
        "dt": "s since the last call, above zero",
        "position": "{angle}, now",
        "load_torque": "{torque}, positive if it opposes positive motion",
        "temperature": "deg C",
        "applied_torque": "{torque}, which a static map balances at rest",
    },
    "compensator": {
        "cycles": "since the last call: 1, and more after missed cycles",
        "position": "{angle}, measured",
        "velocity": "{angle}/s, of the drive; only an estimator of the kind drive uses it",
        "torque": "{torque}, actual torque of the drive",
        "position_demand": "{angle}, when the position was sampled",
        "velocity_demand": "{angle}/s, when the position was sampled",
        "velocity_demand_ahead": "{angle}/s, when this cycle's torque will act",
        "acceleration_demand_ahead": "{angle}/s^2, likewise",
        "temperature": "deg C, measured",
        "load_torque": "{torque}, all of the load; else by gravity and inertia of the model",
        "is_fresh": "the feedback is of this cycle",
        "is_enabled": "fade in; otherwise fade out",
    },
}


def files(subject: Subject) -> dict[str, str]:
    """Return all function blocks, functions and types, as text and as a project to import."""
    parts = [_Part(subject, "model", model_program(subject.model_file.friction_model))]
    if subject.compensator is not None:
        parts.append(_Part(subject, "compensator", compensator_program(subject.compensator)))
    types = {part.printer.state_type: part.fields() for part in parts if part.has_state}
    library = {name: each for part in parts for name, each in part.library().items()}
    units = [*library.values(), *(each for part in parts for each in part.units())]
    about = list(_about(subject))
    texts = [comment(about), *(_structure(*each) for each in types.items()), *(each.text() for each in units)]
    return {
        f"{subject.name}.st": "\n".join(texts),
        f"{subject.name}.xml": plcopen.project(subject.name, "\n".join(about), types, units),
    }


def _structure(name: str, fields: list[Declared]) -> str:
    inner = "\n".join(each.text() for each in fields)
    return f"TYPE {name} :\nSTRUCT\n{inner}\nEND_STRUCT;\nEND_TYPE\n"


def _about(subject: Subject) -> Iterable[str]:
    yield from provenance(subject)
    yield ""
    yield (
        f"{literal(UNKNOWN)}, which an input has that is not connected, stands for what is unknown, as does every "
        "number that is not plausible. Call each block once in every period of its task."
    )


def comment(lines: Iterable[str]) -> str:
    """Return a comment of several lines."""
    wrapped: list[str] = []
    for line in lines:
        indent = " " * (len(line) - len(line.lstrip()) + 2)
        wrapped += textwrap.wrap(line, 112, subsequent_indent=indent) or [""]
    inside = "\n".join(f"   {line}".rstrip() for line in wrapped).replace("*)", "* )").replace("(*", "( *")
    return f"(*{inside[2:]} *)\n"


class _Part:
    """Model or compensator: a type for the state, functions, and the function block."""

    def __init__(self, subject: Subject, kind: str, program: Program) -> None:
        self.optional = OPTIONAL[kind]
        self.kind, self.program = kind, strict(program, self.optional)
        self.outside = program.inputs
        used = set(map(id, map(strict_library.function, strict_library.NAMES)))
        own = [each for each in self.program.functions if id(each) in used]
        self.printer = StPrinter(subject.name, kind, self.program.tables, own)
        self._library, self.name = own, f"{subject.name}_{kind}"
        angle, torque = ("rad", "N m") if subject.model_file.axis == "rotary" else ("m", "N")
        self.comments = {name: text.format(angle=angle, torque=torque) for name, text in COMMENTS[kind].items()}
        self.torque = torque
        self.has_state = bool(self.program.fields or self.program.tables)

    def library(self) -> dict[str, Pou]:
        """Return the functions of the library, which several programs may share."""
        return {each.name: self.printer.function(each) for each in self._library}

    def units(self) -> list[Pou]:
        """Return everything else."""
        functions = [each for each in self.program.functions if each not in self._library]
        begin = [self._begin()] if self.has_state else []
        return [*map(self.printer.function, functions), *begin, self._block()]

    def fields(self) -> list[Declared]:
        """Return the fields of the state, and the tables, which nothing changes."""
        fields = []
        for one in self.program.fields:
            kind = _array(one.type, len(one.initial)) if one.is_array else _TYPE[one.type]
            fields.append(Declared(field_name(one.name), kind))
        for table in self.program.tables:
            low, high = table.used
            fields.append(Declared(table_name(table.name), _array("real", high - low + 1), "", "constant"))
        return fields

    def _begin(self) -> Pou:
        """Return the function that fills state and tables: a compiler drops initial values within a structure."""
        name = f"{self.name}_begin"
        lines = [f"{name} := TRUE;"]
        for one in self.program.fields:
            place = f"{STATE}.{field_name(one.name)}"
            values = [_initial(one, each) for each in one.initial]
            lines += _filled(place, values) if one.is_array else [f"{place} := {values[0]};"]
        for table in self.program.tables:
            low, high = table.used
            lines += _filled(
                f"{STATE}.{table_name(table.name)}", [literal(float(x)) for x in table.values[low : high + 1]]
            )
        sections = {"VAR_IN_OUT": [Declared(STATE, self.printer.state_type)]}
        return Pou("FUNCTION", name, "BOOL", sections, "\n".join(lines), "Begin at rest.")

    def _block(self) -> Pou:
        """Return the function block."""
        inputs, own, lines = self._inputs()
        result = "compensation" if self.kind == "compensator" else "friction"
        outputs = [Declared(result, "LREAL", "", self.torque), self._fault()]
        entry, is_known = self.program.entry, flag(result)
        others = [f"result_1 => {is_known}"] if len(entry.results) > 1 else []
        lines.append(f"{result} := {self.printer.call(entry, map(self._operand, self.program.inputs), others)};")
        if others:
            own.append(Declared(is_known, "BOOL"))
        if self.kind == "model":
            test = f"ABS({result}) >= {literal(UNLIMITED)}"
            lines.append(f"is_faulty := {f'NOT {is_known} OR ({test})' if others else test};")
            lines += ["IF is_faulty THEN", f"    {result} := 0.0;", "END_IF;"]
        if self.has_state:
            inputs.insert(0, Declared("reset", "BOOL", "", "begin anew, at rest"))
            begun = [Declared("is_begun", "BOOL"), Declared("done", "BOOL"), Declared(STATE, self.printer.state_type)]
            own = [*begun, *own]
            begin = f"    done := {self.name}_begin({STATE} := {STATE});"
            lines = ["IF reset OR NOT is_begun THEN", begin, "    is_begun := TRUE;", "END_IF;", *lines]
        names = {each.name for each in self.program.fields}
        if "cycle" in names:
            lines.append(f"IF {STATE}.cycle >= {literal(REBASED)} THEN (* it is kept small *)")
            kept = [f"{STATE}.{each}" for each in CYCLES if each in names]
            lines += [f"    {each} := {each} - {literal(REBASED)};" for each in kept]
            lines.append("END_IF;")
        if self.kind == "compensator":
            lines.append(f"is_faulty := {STATE}.is_faulty > 0.5;")
        sections = {"VAR_INPUT": inputs, "VAR_OUTPUT": outputs, "VAR": own}
        return Pou("FUNCTION_BLOCK", self.name, "", sections, "\n".join(lines), self._says())

    def _fault(self) -> Declared:
        text = "the friction is not finite; it is zero then"
        if self.kind == "compensator":
            text = "the model's torque is not finite; zero is used instead"
        return Declared("is_faulty", "BOOL", "", text)

    def _says(self) -> str:
        if self.kind == "model":
            return f"Advance by the time since the last call; friction, {self.torque}, opposes positive velocity."
        return f"Compute one cycle: the compensation, {self.torque}, within its limit. Due in every period."

    def _operand(self, one: Variable) -> str:
        """Return what the function block passes to the functions."""
        if one.type == "bool" or one.name == "cycle":
            return one.name
        has_own = one.name.startswith("is_") or one.name in self.optional
        return f"{one.name}_value" if has_own else _PUBLIC.get(one.name, one.name)

    def _inputs(self) -> tuple[list[Declared], list[Declared], list[str]]:
        """Return the inputs, the variables for what the functions take, and the statements that fill them."""
        inputs, own, lines = [], [], []
        taken = {each.name for each in self.program.inputs}
        for name in (each.name for each in self.outside):
            value = f"{name}_value"
            if name == "cycle":
                inputs.append(Declared("cycles", "DINT", "1", self.comments["cycles"]))
                lines.append(f"cycle := {STATE}.cycle + DINT_TO_LREAL(cycles);")
                own.append(Declared(name, "LREAL"))
            elif name.startswith("is_"):
                inputs.append(Declared(name, "BOOL", "TRUE" if name == "is_fresh" else "FALSE", self.comments[name]))
                lines += _either(name, f"{value} := 1.0;", f"{value} := 0.0;")
                own.append(Declared(value, "LREAL"))
            elif name not in self.optional:
                inputs.append(Declared(_PUBLIC.get(name, name), "LREAL", "", self.comments[name]))
            else:
                inputs.append(Declared(name, "LREAL", literal(UNKNOWN), self.comments[name]))
                if name in taken or flag(name) in taken:
                    lines.append(f"{flag(name)} := ABS({name}) < {literal(PLAUSIBLE)};")
                    lines += _either(flag(name), f"{value} := {name};", f"{value} := 0.0;")
                    own += [Declared(flag(name), "BOOL"), Declared(value, "LREAL")]
        return inputs, own, lines


def _either(test: str, then: str, other: str) -> list[str]:
    return [f"IF {test} THEN", f"    {then}", "ELSE", f"    {other}", "END_IF;"]


def _filled(place: str, values: list[str]) -> list[str]:
    return [f"{place}[{k}] := {each};" for k, each in enumerate(values)]


_TYPE = {"real": "LREAL", "bool": "BOOL"}


def _array(kind: str, size: int) -> str:
    return f"ARRAY[0..{size - 1}] OF {_TYPE[kind]}"


def _initial(one: StrictField, value: float) -> str:
    return ("TRUE" if value else "FALSE") if one.type == "bool" else literal(value)
