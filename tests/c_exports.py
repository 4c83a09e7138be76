"""Exports to C, compiled and called from the tests."""

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.compensator import INPUTS, Compensator
from friction_hil.export import c
from friction_hil.export.subject import Subject
from friction_hil.models import FrictionModel
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array

# -ffp-contract=off: on processors with fused multiply-add the compiler would round less often than the kernels do
COMMAND = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion",
           "-ffp-contract=off", "-shared", "-fPIC")  # fmt: skip
_ROOM = 16384  # bytes for a state


def subject(model: FrictionModel, name: str = "axis", compensator: Compensator | None = None) -> Subject:
    """A model that is no file."""

    class Given(ModelFile):
        @property
        def friction_model(self) -> FrictionModel:
            return model

    content = {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 1.0}}}
    return Subject(name, Given.model_validate(content), "", compensator)


def write(folder: Path, subjects: list[Subject]) -> None:
    """Write the files of exports."""
    for each in subjects:
        for name, text in c.files(each).items():
            (folder / name).write_text(text)


def shared(folder: Path, sources: list[Path], *options: str, compiler: str = "gcc") -> Path:
    """Compile into a shared library; the compiler must have nothing to say."""
    library = folder / f"lib{'_'.join(options[:1])}.so"
    command = [compiler, *COMMAND, *options, "-o", str(library), *map(str, sources), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return library


def check(sources: list[Path], *options: str, compiler: str = "gcc") -> None:
    """Let a compiler read sources without making anything; it must have nothing to say."""
    command = [compiler, *COMMAND[:-2], "-fsyntax-only", *options, *map(str, sources)]
    assert subprocess.run(command, capture_output=True, text=True).stderr == ""


def compiled(folder: Path, subjects: list[Subject], *, single: bool = False) -> ctypes.CDLL:
    """Compile several exports into one library, with the sizes of their states as ``size_of_NAME``."""
    lines = []
    for each in subjects:
        lines.append(f'#include "{each.name}.h"')
        for kind in ("model", "compensator") if each.compensator is not None else ("model",):
            own = f"{each.name}_{kind}"
            lines.append(f"unsigned long size_of_{own};\nunsigned long size_of_{own} = sizeof({own});")
    (folder / "sizes.c").write_text("\n".join(lines) + "\n")
    options = ["-O0", *(f"-D{each.name.upper()}_SINGLE" for each in subjects)] if single else ["-O1"]
    return ctypes.CDLL(
        str(shared(folder, [folder / f"{each.name}.c" for each in subjects] + [folder / "sizes.c"], *options))
    )


def model_steps(library: ctypes.CDLL, name: str, rows: Any, *, single: bool = False) -> Array:
    """Torque of every step of a model; a row has velocity, dt, position, load, temperature and applied torque."""
    real = ctypes.c_float if single else ctypes.c_double
    step, begin = library[f"{name}_model_step"], library[f"{name}_model_init"]
    step.restype = real
    step.argtypes = [ctypes.c_void_p, real, real, ctypes.c_double, real, real, real]
    state = ctypes.create_string_buffer(_ROOM)
    begin(state)
    return np.array([step(state, *row) for row in rows])


def compensator_steps(library: ctypes.CDLL, name: str, rows: Any, *, single: bool = False) -> Array:
    """Compensation of every cycle; a row has the `INPUTS` in their order, with cycle numbers that increase."""
    real = ctypes.c_float if single else ctypes.c_double

    class Input(ctypes.Structure):
        _fields_ = (
            *(("cycles", ctypes.c_uint32), ("position", ctypes.c_double), ("velocity", real), ("torque", real)),
            *(("position_demand", ctypes.c_double), ("velocity_demand", real), ("velocity_demand_ahead", real)),
            *(("acceleration_demand_ahead", real), ("temperature", real), ("load_torque", real)),
            *(("is_fresh", ctypes.c_bool), ("is_enabled", ctypes.c_bool)),
        )

    step, begin = library[f"{name}_compensator_step"], library[f"{name}_compensator_init"]
    step.restype = real
    step.argtypes = [ctypes.c_void_p, ctypes.POINTER(Input)]
    state = ctypes.create_string_buffer(_ROOM)
    begin(state)
    last, torques = -1.0, []
    for row in rows:
        given = dict(zip(INPUTS, row, strict=True))
        cycle = given.pop("cycle")
        flags = {each: bool(given.pop(each)) for each in ("is_fresh", "is_enabled")}
        torques.append(step(state, ctypes.byref(Input(cycles=int(cycle - last), **given, **flags))))
        last = cycle
    return np.array(torques)
