"""Model and compensator as functional mock-up units (FMI 2.0 and 3.0, co-simulation), made of the exported C."""

import hashlib
import html
import io
import math
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.resources import files as resources
from pathlib import Path

from friction_hil.errors import UsageError
from friction_hil.export import c, fmu_description
from friction_hil.export.fmu_description import Unit, Variable
from friction_hil.export.strict import PLAUSIBLE
from friction_hil.export.subject import Subject, provenance

_STANDARDS = ("2.0", "3.0")
_WHEN = (1980, 1, 1, 0, 0, 0)  # of every file in an archive, so that the same export gives the same bytes
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared")
_GLUE = ("fmi2.c", "fmi3.c")


def files(subject: Subject) -> dict[str, bytes]:
    """Return an archive for each of model and compensator and for each version of the standard.

    Raises `UsageError`: there is no C compiler, or it failed.
    """
    alone = replace(subject, compensator=None)
    units = [_model(alone)]
    if subject.compensator is not None:
        units.append(_compensator(subject))
    result = {}
    for unit, whole in zip(units, (alone, subject), strict=False):
        sources = {**c.files(whole), "fmu.h": _header(unit)}
        token = hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:32]
        sources["fmu.h"] = sources["fmu.h"].replace("TOKEN_OF_THE_SOURCES", token)
        sources |= {name: _resource(name) for name in _GLUE}
        library = _compiled(sources)
        for standard in _STANDARDS:
            name = f"{unit.name}_fmi{standard[0]}.fmu"
            result[name] = _archive(standard, unit, token, sources, library, provenance(subject))
    return result


def _resource(name: str) -> str:
    return (resources("friction_hil.export") / "fmi" / name).read_text(encoding="utf-8")


def _model(subject: Subject) -> Unit:
    angle, torque = _units(subject)
    optional = frozenset(("temperature",))
    texts = {
        "velocity": (f"{angle}/s", "velocity, held during a step"),
        "position": (angle, "position at the end of a step"),
        "load_torque": (torque, "torque of the load, positive if it opposes positive motion"),
        "temperature": ("degC", "temperature; that of the parameters if it is not set"),
        "applied_torque": (torque, "torque that a static map balances at rest"),
    }
    inputs = [Variable(name, unit, text, "input", is_optional=name in optional) for name, (unit, text) in texts.items()]
    outputs = [Variable("friction", torque, "friction, which opposes positive velocity where it is positive", "output")]
    return Unit(f"{subject.name}_model", [*inputs, *outputs, *_constants(subject)], None)


def _compensator(subject: Subject) -> Unit:
    assert subject.compensator is not None
    angle, torque = _units(subject)
    texts = {
        "position": (angle, "position, measured"),
        "velocity": (f"{angle}/s", "velocity of the drive; only an estimator of the kind drive uses it"),
        "torque": (torque, "actual torque of the drive"),
        "position_demand": (angle, "demanded position when the position was sampled"),
        "velocity_demand": (f"{angle}/s", "demanded velocity when the position was sampled"),
        "velocity_demand_ahead": (f"{angle}/s", "demanded velocity when this cycle's torque will act"),
        "acceleration_demand_ahead": (f"{angle}/s2", "demanded acceleration when this cycle's torque will act"),
        "temperature": ("degC", "temperature, measured"),
        "load_torque": (torque, "all of the load; if it is not set, by gravity and inertia of the model"),
    }
    inputs = [Variable(name, unit, text, "input", is_optional=True) for name, (unit, text) in texts.items()]
    inputs.append(Variable("is_fresh", "", "the feedback is of this cycle", "input", kind="Boolean", start=1.0))
    inputs.append(Variable("is_enabled", "", "fade in; otherwise fade out", "input", kind="Boolean"))
    outputs = [
        Variable("compensation", torque, "compensation, within its limit", "output"),
        Variable("is_faulty", "", "the model's torque is not finite; zero is used instead", "output", kind="Boolean"),
    ]
    period_s = subject.compensator.settings.period_s
    return Unit(f"{subject.name}_compensator", [*inputs, *outputs, *_constants(subject)], period_s)


def _units(subject: Subject) -> tuple[str, str]:
    return ("rad", "N.m") if subject.model_file.axis == "rotary" else ("m", "N")


def _constants(subject: Subject) -> Iterable[Variable]:
    """Return the parameters of the model; they are constants of the binary, and shown only."""
    model = subject.model_file.friction_model
    text = "parameter of the friction model, a constant of this unit"
    values = zip(model.packed_names, map(float, model.values), strict=False)
    # parameters of both directions that are the same stand in the model twice
    for name, value in {name: value for name, value in values if name and math.isfinite(value)}.items():
        yield Variable(f"parameter.{name}", "", text, "local", start=value)


# --- C


def _header(unit: Unit) -> str:
    """Return what the glue needs to know of this unit: its variables, and how it advances."""
    reals, booleans = unit.of("Real"), unit.of("Boolean")
    names = {each.name: f"d->reals[{k + 1}]" for k, each in enumerate(reals)}
    names |= {each.name: f"d->booleans[{k}]" for k, each in enumerate(booleans)}
    kinds = ", ".join(["0", *(str(_access(each)) for each in reals)])
    starts = ", ".join(["0.0", *(repr(each.start) for each in reals)])
    settable = ", ".join(str(int(each.causality == "input")) for each in booleans) or "0"
    flags = ", ".join(str(int(each.start)) for each in booleans) or "0"
    step = _model_step(unit, names) if unit.period_s is None else _compensator_step(unit, names)
    own = unit.name.removesuffix("_model").removesuffix("_compensator")
    return f"""/* What the glue for the FMI standard needs to know of {unit.name}. Made by a program. */

#ifndef FMU_H
#define FMU_H

#include "{own}.h"

#include <math.h>
#include <stddef.h>

#define FMU_TOKEN "TOKEN_OF_THE_SOURCES"
#define FMU_REALS {len(reals) + 1}U
#define FMU_BOOLEANS {len(booleans)}U
#define FMU_ROOM {max(len(booleans), 1)}U

/* A whole instance, which can be copied. */
typedef struct {{
    {unit.name} core;
    double start_time;
    double last_cycle;
    double reals[FMU_REALS]; /* by value reference, time first */
    bool booleans[FMU_ROOM]; /* by value reference behind them */
}} fmu_data;

/* 0: cannot be set, 1: an input, 2: an input that may be unknown */
static const unsigned char fmu_access[FMU_REALS] = {{{kinds}}};
static const double fmu_starts[FMU_REALS] = {{{starts}}};
static const bool fmu_settable[FMU_ROOM] = {{{settable}}};
static const bool fmu_flags[FMU_ROOM] = {{{flags}}};

static void fmu_start(fmu_data *d)
{{
    {unit.name}_init(&d->core);
    d->start_time = 0.0;
    d->last_cycle = -1.0;
    for (size_t i = 0; i < FMU_REALS; i++) {{
        d->reals[i] = fmu_starts[i];
    }}
    for (size_t i = 0; i < FMU_ROOM; i++) {{
        d->booleans[i] = fmu_flags[i];
    }}
}}

static bool fmu_get_real(const fmu_data *d, unsigned int ref, double *value)
{{
    if (ref >= FMU_REALS) {{
        return false;
    }}
    *value = d->reals[ref];
    return true;
}}

static bool fmu_set_real(fmu_data *d, unsigned int ref, double value)
{{
    if ((ref >= FMU_REALS) || (fmu_access[ref] == 0) || ((fmu_access[ref] == 1) && !isfinite(value))) {{
        return false;
    }}
    d->reals[ref] = value;
    return true;
}}

static bool fmu_get_boolean(const fmu_data *d, unsigned int ref, bool *value)
{{
    if ((ref < FMU_REALS) || (ref >= FMU_REALS + FMU_BOOLEANS)) {{
        return false;
    }}
    *value = d->booleans[ref - FMU_REALS];
    return true;
}}

static bool fmu_set_boolean(fmu_data *d, unsigned int ref, bool value)
{{
    if ((ref < FMU_REALS) || (ref >= FMU_REALS + FMU_BOOLEANS) || !fmu_settable[ref - FMU_REALS]) {{
        return false;
    }}
    d->booleans[ref - FMU_REALS] = value;
    return true;
}}

/* Return an input that may be unknown: NAN for a number that is not plausible, as every input is that was not set. */
static double fmu_known(double value)
{{
    return (fabs(value) < {PLAUSIBLE!r}) ? value : NAN;
}}

/* Advance from time by step, s; return NULL, or why that is not possible. */
static const char *fmu_step(fmu_data *d, double time, double step)
{{
    if (!(isfinite(time) && isfinite(step) && (step > 0.0))) {{
        return "a step must be a time above zero";
    }}
{step}    d->reals[0] = time + step;
    return NULL;
}}

#endif
"""


def _access(one: Variable) -> int:
    return 0 if one.causality != "input" else 2 if one.is_optional else 1


def _model_step(unit: Unit, names: dict[str, str]) -> str:
    values = {name: f"fmu_known({place})" if name == "temperature" else place for name, place in names.items()}
    order = ("velocity", "dt", "position", "load_torque", "temperature", "applied_torque")
    given = ", ".join({"dt": "step"}.get(name) or values[name] for name in order)
    return f"""\
    const double friction = {unit.name}_step(&d->core, {given});
    if (!isfinite(friction)) {{
        return "the friction is not finite";
    }}
    {names["friction"]} = friction;
"""


def _compensator_step(unit: Unit, names: dict[str, str]) -> str:
    assert unit.period_s is not None
    inputs = [each.name for each in unit.variables if each.causality == "input"]
    given = "".join(
        f"    in.{name} = {names[name] if name.startswith('is_') else f'fmu_known({names[name]})'};\n"
        for name in inputs
    )
    return f"""\
    /* The cycles are due at whole numbers of periods after the start; this step runs those from time on. */
    const double period = {unit.period_s!r};
    const double last = ceil((time + step - d->start_time) / period - 1e-6) - 1.0;
    const double passed = last - d->last_cycle;
    if (passed > 4e9) {{
        return "a step has more cycles than can be counted";
    }}
    if (passed > 0.5) {{
        {unit.name}_input in;
        in.cycles = (uint32_t)passed;
{given.replace("    in", "        in")}\
        {names["compensation"]} = {unit.name}_step(&d->core, &in);
        {names["is_faulty"]} = d->core.is_faulty > 0.5;
        d->last_cycle = last;
    }}
"""


def _compiler() -> list[str]:
    given = shlex.split(os.environ.get("CC", "")) or ["cc"]
    if shutil.which(given[0]) is None:
        raise UsageError(
            f"an FMU holds a binary, and there is no C compiler {given[0]!r} here to make it: install one, on Debian "
            "with sudo apt install gcc, or name one in the environment variable CC"
        )
    return given


def _compiled(sources: dict[str, str]) -> bytes:
    command = _compiler()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        inputs = [file for file in sources if file.endswith(".c")]
        position = [] if sys.platform == "win32" else ["-fPIC"]
        whole = [*command, *_FLAGS, *position, "-o", "unit.so", *inputs, "-lm"]
        done = subprocess.run(whole, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise UsageError(f"{shlex.join(whole)} failed: {done.stderr.strip() or f'status {done.returncode}'}")
        return (folder / "unit.so").read_bytes()


def _place(standard: str) -> str:
    """Return the folder for binaries of this machine."""
    system = {"linux": "linux", "darwin": "darwin", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = {"AMD64": "x86_64", "amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    if standard == "2.0" and machine == "x86_64":
        return {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}.get(system, system)
    return f"{machine}-{system}"


# --- the archive


def _archive(
    standard: str, unit: Unit, token: str, sources: dict[str, str], library: bytes, about: Sequence[str]
) -> bytes:
    own = [name for name in sources if name.endswith(".c") and name not in _GLUE]
    compiled = [f"fmi{standard[0]}.c", *own]
    used = {name: text for name, text in sources.items() if name not in _GLUE or name in compiled}
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    content: dict[str, str | bytes] = {
        "modelDescription.xml": fmu_description.description(standard, unit, token, compiled, about),
        "documentation/index.html": _page(unit, about),
        f"binaries/{_place(standard)}/{unit.name}{suffix}": library,
        **{f"sources/{name}": text for name, text in used.items()},
    }
    if standard == "3.0":
        content["sources/buildDescription.xml"] = fmu_description.build(unit, compiled)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, each in content.items():
            archive.writestr(zipfile.ZipInfo(name, _WHEN), each, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _page(unit: Unit, about: Sequence[str]) -> str:
    rows = "".join(
        f"<tr><td>{each.name}</td><td>{each.causality}</td><td>{each.unit}</td><td>{html.escape(each.text)}</td></tr>\n"
        for each in unit.variables
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{unit.name}</title></head><body>\n'
        f"<h1>{unit.name}</h1>\n<pre>{html.escape(chr(10).join(about))}</pre>\n"
        f"<p>{html.escape(unit.says())}</p>\n<table>\n{rows}</table>\n</body></html>\n"
    )
