"""All joints of a loop as C99: what `c` writes for each, and one struct, one init and one step for all of them."""

from collections.abc import Sequence

import numpy as np

from friction_hil.export import c
from friction_hil.export.c_printer import Printer, literal
from friction_hil.export.ir import Variable
from friction_hil.export.kernels import BUILT_IN, DEFINITIONS, INTRINSICS, PASSES, called
from friction_hil.export.subject import Subject, provenance
from friction_hil.export.translator import Translator
from friction_hil.export.values import State
from friction_hil.own_loop.kernel import demand

# what `demand` takes, with the types of C
_DEMAND = (("wide", "position"), ("real", "velocity"), ("real", "acceleration"), ("wide", "position_before"),
           ("real", "velocity_before"), ("real", "elapsed_s"), ("real", "lead_s"))  # fmt: skip
_INPUTS = (
    ("double", "q", "measured positions, rad or m"),
    ("{real}", "dq", "velocities of the drives; only an estimator of the kind drive uses them"),
    ("{real}", "tau", "actual torques, N m or N; only adaptation and kalman use them"),
    ("double", "q_des", "demanded positions of this cycle"),
    ("{real}", "dq_des", "demanded velocities; NAN: from the change of q_des"),
    ("{real}", "ddq_des", "demanded accelerations; NAN: from the change of the velocity"),
    ("{real}", "load", "torques of the load, positive if they oppose positive motion; NAN: by the model"),
    ("{real}", "temperature", "deg C"),
    ("bool", "is_fresh", "the values are of this cycle"),
    ("bool", "is_enabled", "fade in; otherwise fade out"),
)


def files(name: str, subjects: Sequence[Subject]) -> dict[str, str]:
    """Return headers and sources by the names of their files; a subject has a compensator and is called NAME_JOINT."""
    whole = f"{name}_compensators"
    made = {file: text for each in subjects for file, text in c.files(each).items()}
    return {f"{name}.h": _header(name, whole, subjects), f"{name}.c": _source(name, whole, subjects), **made}


def _joint(name: str, subject: Subject) -> str:
    return subject.name.removeprefix(f"{name}_")


def _header(name: str, whole: str, subjects: Sequence[Subject]) -> str:
    guard, real, most = f"{name.upper()}_H", f"{name}_real", f"{name.upper()}_JOINTS"
    rows = [(f"    {kind.format(real=real)} {field}[{most}];", text) for kind, field, text in _INPUTS]
    width = max(len(begin) for begin, _ in rows)
    inputs = [f"{'    uint32_t cycles;':<{width}} /* since the last step: 1, and more after missed cycles */"]
    inputs += [f"{begin:<{width}} /* {text} */" for begin, text in rows]
    order = ", ".join(_joint(name, each) for each in subjects)
    macros = " ".join(f"-D{each.name.upper()}_SINGLE" for each in subjects)
    about = [provenance(subjects[0])[0], f"Joints, in the order of all arrays: {order}.",
             f"In single precision: {macros}."]  # fmt: skip
    lines = [
        c.comment(about),
        f"#ifndef {guard}\n#define {guard}\n",
        "".join(f'#include "{each.name}.h"\n' for each in subjects),
        f"#define {most} {len(subjects)}\n\ntypedef {subjects[0].name}_real {real};\n",
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
        "typedef struct {\n"
        + "".join(f"    {each.name}_compensator {_joint(name, each)};\n" for each in subjects)
        + f"    double q_des[{most}]; /* of the last step */\n    {real} dq_des[{most}];\n}} {whole};\n",
        "/* Inputs of one cycle; NAN where something is unknown. */\ntypedef struct {\n"
        + "\n".join(inputs)
        + f"\n}} {whole}_input;\n",
        f"/* Begin at rest. */\nvoid {whole}_init({whole} *s);\n",
        c.comment(["Compute one cycle of all joints: the compensations, each within its limit. A step is due in every "
                   "period."]) + f"void {whole}_step({whole} *s, const {whole}_input *in, {real} *ff);\n",
        "#ifdef __cplusplus\n}\n#endif\n\n#endif\n",
    ]  # fmt: skip
    return "\n".join(lines)


def _source(name: str, whole: str, subjects: Sequence[Subject]) -> str:
    translator = Translator(State(np.zeros(1, [("unused", "f8")])), INTRINSICS, DEFINITIONS, PASSES, BUILT_IN)
    given = [Variable(kind, each) for kind, each in _DEMAND]  # type: ignore[arg-type]
    entry, _ = translator.function(demand, given, "of_cycle")
    printer = Printer("demand", whole, ())
    functions = "\n".join(printer.function(each) for each in called(entry))
    (pair,) = printer.pairs
    used = sorted(each for each in printer.used if each.startswith("m_"))
    steps = "".join(_step(name, k, each, pair) for k, each in enumerate(subjects))
    begin = "".join(
        f"    {each.name}_compensator_init(&s->{_joint(name, each)});\n    s->q_des[{k}] = (double)NAN;\n"
        f"    s->dq_des[{k}] = (real)NAN;\n"
        for k, each in enumerate(subjects)
    )
    return "\n".join(
        [
            f"/* {name}.h says what this is. Made by a program; change the models and export them again. */\n",
            f'#include "{name}.h"\n\n#include <math.h>\n',
            f"typedef {name}_real real;\n\n#define R(number) ((real)(number))\n"
            + "".join(f"#define {each}(x) R({each[2:]}((double)(x)))\n" for each in used)
            + "".join(f"#define {each} {literal(value)}\n" for each, value in sorted(printer.constants.items())),
            f"typedef struct {{\n    real v0;\n    real v1;\n}} {pair};\n",
            functions,
            f"void {whole}_init({whole} *s)\n{{\n{begin}}}\n",
            f"void {whole}_step({whole} *s, const {whole}_input *in, real *ff)\n{{\n"
            f"    const real passed = (in->cycles < {c.MOST_CYCLES}U) ? (real)in->cycles : R({c.MOST_CYCLES}.0);\n"
            f"{steps}}}\n",
        ]
    )


def _step(name: str, k: int, subject: Subject, pair: str) -> str:
    """Return the statements that compute one joint."""
    assert subject.compensator is not None
    given, own = subject.compensator.settings, f"{subject.name}_real"
    reals = {"velocity": f"in->dq[{k}]", "torque": f"in->tau[{k}]", "velocity_demand": "now.v0",
             "velocity_demand_ahead": "now.v1", "acceleration_demand_ahead": f"in->ddq_des[{k}]",
             "temperature": f"in->temperature[{k}]", "load_torque": f"in->load[{k}]"}  # fmt: skip
    lines = [
        f"const {pair} now = demand_of_cycle(in->q_des[{k}], in->dq_des[{k}], in->ddq_des[{k}], s->q_des[{k}],",
        f"    s->dq_des[{k}], passed * {literal(given.period_s)}, {literal(given.lead_s)});",
        f"const {subject.name}_compensator_input one = {{",
        "    .cycles = in->cycles,",
        f"    .position = in->q[{k}],",
        f"    .position_demand = in->q_des[{k}],",
        *(f"    .{field} = ({own})({value})," for field, value in reals.items()),
        f"    .is_fresh = in->is_fresh[{k}],",
        f"    .is_enabled = in->is_enabled[{k}],",
        "};",
        f"ff[{k}] = (real){subject.name}_compensator_step(&s->{_joint(name, subject)}, &one);",
        f"s->q_des[{k}] = in->q_des[{k}];",
        f"s->dq_des[{k}] = now.v0;",
    ]
    return f"    /* {_joint(name, subject)} */\n    {{\n" + "".join(f"        {line}\n" for line in lines) + "    }\n"
