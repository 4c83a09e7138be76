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
COMMAND = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion", "-O1",
           "-ffp-contract=off", "-shared", "-fPIC")  # fmt: skip
_ROOM = 16384  # bytes for a state


class _Input(ctypes.Structure):
    pass


def subject(model: FrictionModel, name: str = "axis", compensator: Compensator | None = None) -> Subject:
    """A model that is no file."""

    class Given(ModelFile):
        @property
        def friction_model(self) -> FrictionModel:
            return model

    content = {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 1.0}}}
    return Subject(name, Given.model_validate(content), "", compensator)


def compiled(folder: Path, subjects: list[Subject], *, single: bool = False, compiler: str = "gcc") -> ctypes.CDLL:
    """Compile several exports into one library; the compiler must have nothing to say."""
    sources = []
    for each in subjects:
        for name, text in c.files(each).items():
            (folder / name).write_text(text)
        sources.append(folder / f"{each.name}.c")
    library = folder / f"lib_{compiler}_{single}.so"
    macros = [f"-D{each.name.upper()}_SINGLE" for each in subjects] if single else []
    done = subprocess.run(
        [compiler, *COMMAND, *macros, "-o", str(library), *map(str, sources), "-lm"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return ctypes.CDLL(str(library))


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
            ("cycles", ctypes.c_uint32),
            ("position", ctypes.c_double),
            ("velocity", real),
            ("torque", real),
            ("position_demand", ctypes.c_double),
            ("velocity_demand", real),
            ("velocity_demand_ahead", real),
            ("acceleration_demand_ahead", real),
            ("temperature", real),
            ("is_fresh", ctypes.c_bool),
            ("is_enabled", ctypes.c_bool),
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
