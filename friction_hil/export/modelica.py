"""Model and compensator as a package of Modelica: blocks with a sampled step, made of functions."""

from collections.abc import Iterator
from dataclasses import dataclass

from friction_hil.export import strict_library
from friction_hil.export.ir import Function
from friction_hil.export.kernels import Program, compensator_program, model_program
from friction_hil.export.modelica_printer import (
    GIVEN,
    SIZE,
    STATE,
    TRUNCATED,
    Layout,
    ModelicaPrinter,
    index_name,
    literal,
    name_of,
)
from friction_hil.export.st_printer import wrapped
from friction_hil.export.strict import OPTIONAL, PLAUSIBLE, UNKNOWN, strict
from friction_hil.export.strict_expressions import flag
from friction_hil.export.strict_library import UNLIMITED
from friction_hil.export.subject import Subject, provenance


@dataclass(frozen=True, slots=True)
class Input:
    """An input of a block; one with a value for when it is not used can be switched off."""

    name: str
    unit: str
    text: str
    unused: str = ""
    is_used: bool = False

    @property
    def connector(self) -> str:
        """Its type."""
        return "RealInput" if self.unit else "BooleanInput"


def files(subject: Subject) -> dict[str, str]:
    """Return one file with the package."""
    parts = [_Part(subject, "model", model_program(subject.model_file.friction_model))]
    if subject.compensator is not None:
        parts.append(_Part(subject, "compensator", compensator_program(subject.compensator)))
    about = [line.replace("\\", "/").replace('"', "'") for line in provenance(subject)]
    package = "".join(part.capitalize() for part in subject.name.split("_"))  # as packages are named by convention
    blocks = "\n".join(part.block() for part in parts)
    internal = "\n".join([_library(parts), *(part.package() for part in parts)])
    text = "\n".join(
        [
            f'package {package} "Friction of one axis, and its compensation"',
            *(f"  // {line}".rstrip() for line in about),
            "",
            _indented(_CONNECTORS, 1),
            _indented(blocks, 1),
            '  package Internal "The functions behind the blocks"',
            _indented(internal, 2) + "  end Internal;",
            f'  annotation(Documentation(info = "<html><pre>{_html(about)}</pre></html>"));',
            f"end {package};",
        ]
    )
    return {f"{package}.mo": text + "\n"}  # a package stands in a file of its name


def _html(lines: list[str]) -> str:
    return "\n".join(lines).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


_ICON = """\
  annotation(Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
    Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {0, 0, 127}),
    Text(extent = {{-100, 40}, {100, -40}}, textString = "%name")}));"""
_CONNECTORS = """\
connector RealInput = input Real "A number, as of Modelica.Blocks.Interfaces.RealInput"
  annotation(Icon(graphics = {Polygon(points = {{-100, 100}, {100, 0}, {-100, -100}}, lineColor = {0, 0, 127},
    fillColor = {0, 0, 127}, fillPattern = FillPattern.Solid)}));
connector BooleanInput = input Boolean "A condition, as of Modelica.Blocks.Interfaces.BooleanInput"
  annotation(Icon(graphics = {Polygon(points = {{-100, 100}, {100, 0}, {-100, -100}}, lineColor = {255, 0, 255},
    fillColor = {255, 0, 255}, fillPattern = FillPattern.Solid)}));
connector RealOutput = output Real "A number, as of Modelica.Blocks.Interfaces.RealOutput"
  annotation(Icon(graphics = {Polygon(points = {{-100, 100}, {100, 0}, {-100, -100}}, lineColor = {0, 0, 127},
    fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid)}));
connector BooleanOutput = output Boolean "A condition, as of Modelica.Blocks.Interfaces.BooleanOutput"
  annotation(Icon(graphics = {Polygon(points = {{-100, 100}, {100, 0}, {-100, -100}}, lineColor = {255, 0, 255},
    fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid)}));
"""


def _indented(text: str, depth: int) -> str:
    return "".join(f"{'  ' * depth}{line}".rstrip() + "\n" for line in text.rstrip("\n").split("\n"))


def _library(parts: "list[_Part]") -> str:
    used: dict[str, Function] = {}
    for part in parts:
        used |= {each.name: each for each in part.library}
    printer = parts[0].plain_printer()
    texts = [printer.function(each) for each in used.values()]
    if any(part.printer.uses_truncated for part in parts):
        texts.append(TRUNCATED)
    body = _indented("\n".join(texts), 1) if texts else ""
    return f'package Library "Functions that give a number where others stop"\n{body}end Library;\n'


class _Part:
    """Model or compensator: a package of functions, and the block."""

    def __init__(self, subject: Subject, kind: str, program: Program) -> None:
        self.kind, self.outside = kind, program.inputs
        self.program = strict(program, OPTIONAL[kind])
        own = set(map(id, map(strict_library.function, strict_library.NAMES)))
        self.library = [each for each in self.program.functions if id(each) in own]
        self.layout = Layout(self.program)
        self.printer = ModelicaPrinter(self.layout, {each: f"Library.{name_of(each.name)}" for each in self.library})
        self.angle, self.torque = ("rad", "N.m") if subject.model_file.axis == "rotary" else ("m", "N")
        self.title = "Model" if kind == "model" else "Compensator"
        self.period_s = 1e-3 if subject.compensator is None else subject.compensator.settings.period_s
        self.functions = [self.printer.function(each) for each in self.program.functions if each not in self.library]

    def plain_printer(self) -> ModelicaPrinter:
        """Return a printer for the library itself, whose functions call each other by their plain names."""
        return ModelicaPrinter(self.layout, {})

    @property
    def has_state(self) -> bool:
        """True if something is kept from one step to the next."""
        return self.layout.size > 0

    # --- functions

    def package(self) -> str:
        """Return the package of the functions."""
        lines = []
        if self.has_state:
            lines.append(f'constant Integer {SIZE} = {self.layout.size} "Numbers that are kept between steps";')
            lines += [f"constant Integer {index_name(name)} = {at};" for name, at in self.layout.first.items()]
        for table in self.program.tables:
            low, high = table.used
            values = ", ".join(literal(float(each)) for each in table.values[low : high + 1])
            lines.append(wrapped(f"constant Real {name_of(table.name)}_table[{high - low + 1}] = {{{values}}};"))
        content = "\n".join([*lines, "", *self.functions, self._step()])
        return f"package {self.title}Functions\n{_indented(content, 1)}end {self.title}Functions;\n"

    def _step(self) -> str:
        """Return the function that a block calls: it finds out what is unknown."""
        entry, program = self.program.entry, self.program
        kinds = {each.name: each.name.startswith("is_") for each in self.outside}
        taken = [each.name for each in program.inputs]
        lines = ['function step "Advance by one step"']
        if self.has_state:
            lines.append(f"  input Real {GIVEN}[{SIZE}];")
        names = ["cycles" if each == "cycle" else each for each in kinds]
        lines += [f"  input {'Boolean' if kinds.get(each) else 'Real'} {name_of(each)};" for each in names]
        lines.append("  output Real result;")
        if self.has_state:
            lines.append(f"  output Real {STATE}[{SIZE}];")
        lines.append("algorithm")
        operands = {}
        for each in dict.fromkeys(name for name in kinds if name in taken or flag(name) in taken):
            shown = name_of(each)
            known = f"abs({shown}) < {literal(PLAUSIBLE)}"
            operands[flag(each)] = f"({known})"
            if each == "cycle":
                operands[each] = f"{GIVEN}[{index_name('cycle')}] + cycles"
            elif kinds[each]:
                operands[each] = f"if {shown} then 1.0 else 0.0"
            else:
                operands[each] = f"if {known} then {shown} else 0.0" if each in OPTIONAL[self.kind] else shown
        given = [GIVEN] if entry.reads_state else []
        call = f"{self.printer.name(entry)}({', '.join([*given, *(operands[each] for each in taken)])})"
        results = ["result", *(["result_known"] if len(entry.results) > 1 else [])]
        test = f"abs(result) < {literal(UNLIMITED)}"
        if len(results) > 1:
            lines.insert(-1, "protected\n  Boolean result_known = true;")
            test = f"result_known and {test}"
        results += [STATE] if entry.writes_state else []
        lines.append(f"  {results[0] if len(results) == 1 else '(' + ', '.join(results) + ')'} := {call};")
        lines.append(f'  assert({test}, "the torque is not finite");')
        if self.has_state and not entry.writes_state:
            lines.append(f"  {STATE} := {GIVEN};")
        return "\n".join([*map(wrapped, lines), "end step;"]) + "\n"

    # --- the block

    def _inputs(self) -> Iterator[Input]:
        """Yield the inputs; those of which there is a value without them can be switched off."""
        angle, torque, unknown = self.angle, self.torque, literal(UNKNOWN)
        if self.kind == "model":
            yield Input("velocity", f"{angle}/s", "Velocity")
            yield Input("position", angle, "Position", "0.0")
            yield Input("load_torque", torque, "Load, positive if it opposes positive motion", "0.0")
            yield Input("temperature", "degC", "Temperature", unknown)
            yield Input("applied_torque", torque, "What a static map balances at rest", "0.0")
            return
        yield Input("position", angle, "Position, measured")
        yield Input("velocity", f"{angle}/s", "Velocity of the drive, for an estimator of the kind drive", unknown)
        yield Input("torque", torque, "Actual torque of the drive", unknown)
        yield Input("position_demand", angle, "Demanded position, when the position was sampled", unknown, True)
        yield Input("velocity_demand", f"{angle}/s", "Demanded velocity, when the position was sampled", unknown, True)
        ahead = "when this cycle's torque will act"
        yield Input("velocity_demand_ahead", f"{angle}/s", f"Demanded velocity, {ahead}", unknown, True)
        yield Input("acceleration_demand_ahead", f"{angle}/s2", f"Demanded acceleration, {ahead}", unknown)
        yield Input("temperature", "degC", "Temperature, measured", unknown)
        yield Input("is_fresh", "", "The feedback is of this cycle", "true")
        yield Input("is_enabled", "", "Fade in; otherwise fade out", "true")

    def block(self) -> str:
        """Return the block."""
        inputs = list(self._inputs())
        result, text = ("friction", "Friction, opposes positive velocity where positive")
        if self.kind == "compensator":
            result, text = "compensation", "Compensation, within its limit"
        lines = [f'block {self.title} "{text}; sampled"']
        fixed = "final parameter" if self.kind == "compensator" else "parameter"
        lines.append(f'  {fixed} Real period(unit = "s") = {literal(self.period_s)} "Time between steps";')
        for each in inputs:
            if each.unused:
                is_used = "true" if each.is_used else "false"
                lines.append(f'  parameter Boolean use_{each.name} = {is_used} "Use the input {each.name}";')
        for k, each in enumerate(inputs):
            height = 90 - round(180 * k / max(len(inputs) - 1, 1))
            place = f"{{{{-120, {height - 10}}}, {{-100, {height + 10}}}}}"
            unit = f'(unit = "{each.unit}")' if each.unit else ""
            condition = f" if use_{each.name}" if each.unused else ""
            lines.append(f'  {each.connector} {each.name}{unit}{condition} "{each.text}"')
            lines.append(f"    annotation(Placement(transformation(extent = {place})));")
        lines.append(f'  RealOutput {result}(unit = "{self.torque}", start = 0.0, fixed = true) "{text}"')
        lines.append("    annotation(Placement(transformation(extent = {{100, -10}, {120, 10}})));")
        if self.kind == "compensator":
            lines.append(
                '  BooleanOutput is_faulty(start = false, fixed = true) "The torque of the model is not finite"'
            )
            lines.append("    annotation(Placement(transformation(extent = {{100, -80}, {120, -60}})));")
        lines.append("protected")
        own = [each for each in inputs if each.unused]
        lines += [f"  {each.connector} {each.name}_used;" for each in own]
        functions = f"Internal.{self.title}Functions"
        if self.has_state:
            values = ", ".join(map(literal, self.layout.initial()))
            lines.append(f"  discrete Real {STATE}[{self.layout.size}](start = {{{values}}}, each fixed = true);")
        lines.append("equation")
        for each in own:
            lines.append(f"  connect({each.name}, {each.name}_used);")
            lines.append(f"  if not use_{each.name} then\n    {each.name}_used = {each.unused};\n  end if;")
        given = {each.name: f"{each.name}_used" if each.unused else each.name for each in inputs}
        given |= {"dt": "period", "cycle": "1.0"}
        operands = [f"pre({STATE})"] if self.has_state else []
        operands += [given[each.name] for each in self.outside]
        results = f"({result}, {STATE})" if self.has_state else result
        lines += ["algorithm", "  when sample(0.0, period) then"]
        lines.append(f"    {results} := {functions}.step({', '.join(operands)});")
        if self.kind == "compensator":
            lines.append(f"    is_faulty := {STATE}[{self.layout.first['is_faulty']}] > 0.5;")
        lines.append("  end when;")
        lines.append(_ICON)
        return "\n".join([*("\n".join(map(wrapped, line.split("\n"))) for line in lines), f"end {self.title};"]) + "\n"
