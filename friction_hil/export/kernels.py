"""The kernels of model and compensator as programs: what is translated, and what a few functions stand for."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.compensator import INPUTS, Compensator, records
from friction_hil.compensator import kernel as compensator_kernel
from friction_hil.compensator import velocity as velocity_estimate
from friction_hil.export import arithmetic, ir
from friction_hil.export.arithmetic import FUNCTIONS, binary, cast, extreme, function, known, truth
from friction_hil.export.expressions import python_function
from friction_hil.export.ir import Expression, Function, Variable
from friction_hil.export.translator import Translator
from friction_hil.export.values import (
    Choice,
    Known,
    Settings,
    State,
    StateArray,
    StateRecord,
    Table,
    TableArray,
)
from friction_hil.friction import FrictionModel, armstrong, curves, dispatch, elementary, kernel, lanes, network, table
from friction_hil.numerics import dual

# Positions and what is compared with them: in single precision they would lose what the encoder resolves.
WIDE_INPUTS = ("position", "position_demand")
WIDE_STATES = ("motion_position", "motion_suspect", "resting_position")
# Cycle numbers in the state; they are kept small, so that single precision holds them.
CYCLES = ("cycle", "motion_cycle", "motion_position_cycle", "motion_suspect_cycle")
MODEL_INPUTS = ("velocity", "dt", "position", "load_torque", "temperature", "applied_torque")
# Inputs of a model beyond these count as these: squares and cubes stay within single precision.
LARGEST_INPUT = 1e9
LARGEST_POSITION = 1e15


@dataclass(frozen=True, slots=True)
class Program:
    """A step as a program."""

    entry: Function  # the step itself
    operands: tuple[Variable, ...]  # those of the inputs that are passed to its parameters
    inputs: tuple[Variable, ...]  # all, in the order of the step
    functions: tuple[Function, ...]  # in an order in which none calls a later one
    state: State
    tables: tuple[Table, ...]  # constant ones that are read by a variable index


def _add_products(
    sums: Any, at: int, values: Any, begin: int, stride: int, factors: Any, count: int
) -> None:  # of `lanes`, which exists as instructions only
    """Add to several sums the products of factors with as many rows of values."""
    for i in range(count):
        for lane in range(lanes.LANES):
            sums[at + lane] = sums[at + lane] + factors[i] * values[begin + i * stride + lane]


def _part(values: Any, begin: Any) -> Any:
    if isinstance(begin, Choice):
        return Choice(begin.test, _part(values, begin.then), _part(values, begin.other))
    moved = binary("+", values.begin, begin)
    return TableArray(values.table, moved) if isinstance(values, TableArray) else StateArray(values.path, moved)


def _whole(value: Expression) -> Expression:
    return cast(value, "int")


def _float(value: Expression) -> Expression:
    return value if arithmetic.is_number(value.type) else cast(value, "real")


# What is no Python function with a source, or has one for compiled code only
INTRINSICS: dict[Any, Any] = {
    abs: arithmetic.absolute,
    bool: truth,
    float: _float,
    int: _whole,
    max: lambda *values: extreme("max", list(values)),
    min: lambda *values: extreme("min", list(values)),
    math.isfinite: lambda value: function("isfinite", [value]),
    math.isnan: lambda value: function("isnan", [value]),
    dispatch.number: lambda kind: kind,
    dual.fma: lambda x, y, z: binary("+", binary("*", x, y), z),
    dual.primal: lambda x: x,
    elementary.is_differentiated: lambda x: known(False),
    elementary.part: _part,
    elementary.whole: _whole,
    **{getattr(math, name): lambda *values, name=name: function(name, list(values)) for name in FUNCTIONS},
    np.sin: lambda value: function("sin", [value]),
    np.cos: lambda value: function("cos", [value]),
}

# Functions that are compiled from another source than the one that Python runs
DEFINITIONS: dict[Any, Any] = {
    elementary.power: python_function(elementary._power),
    lanes.add_products: _add_products,
    kernel._learned_torque: kernel._choose_learned_torque(None, None, None),
}

# Largest number of passes of loops that depend on data
PASSES: dict[Any, int] = {
    python_function(table._interval): math.ceil(math.log2(table.MAX_POINTS)) + 1,
    python_function(armstrong._past): armstrong.HISTORY - 2,
    python_function(velocity_estimate.predict): velocity_estimate.MAX_GAP_CYCLES,
    python_function(network.step): network.MOST_STEPS,
}

# Functions of one expression that reads better in place
BUILT_IN = frozenset(
    (elementary.decay, elementary.approach, elementary.sin, elementary.cos, elementary.tanh, elementary.log,
     elementary.log1p, elementary.expm1, elementary.toward, python_function(curves.modified))
)  # fmt: skip


def _step_within(
    kind: Any,
    p: Any,
    s: Any,
    velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
    applied_torque: float,
) -> float:
    """Advance a model with inputs of any size, so that no finite input makes a number that is none."""
    held = min(max(velocity, -LARGEST_INPUT), LARGEST_INPUT)
    elapsed = min(dt, LARGEST_INPUT)
    place = min(max(position, -LARGEST_POSITION), LARGEST_POSITION)
    load = min(max(load_torque, -LARGEST_INPUT), LARGEST_INPUT)
    celsius = min(max(temperature, -LARGEST_INPUT), LARGEST_INPUT)
    applied = min(max(applied_torque, -LARGEST_INPUT), LARGEST_INPUT)
    return kernel.step(kind, p, s, held, held, elapsed, place, load, celsius, applied, 0.0)


def model_program(model: FrictionModel) -> Program:
    """Return the step of a model, as a simulation takes it, as a program: a static map sticks exactly."""
    state = State(
        np.zeros(1, [("friction", "f8", (kernel.STATE_ROOM,))]),
        pieces={"friction": _friction_pieces(model)},
    )
    velocity, dt, position, load_torque, temperature, applied = (
        Variable("wide" if name in WIDE_INPUTS else "real", name) for name in MODEL_INPUTS
    )

    def arguments(p: TableArray) -> list[Any]:
        return [known(model.kind), p, StateArray("friction", known(0)), *inputs]

    inputs = (velocity, dt, position, load_torque, temperature, applied)
    return _program(model, state, inputs, _step_within, arguments, "bounded")


def compensator_program(compensator: Compensator) -> Program:
    """Return the step of a compensator, with its settings and the state that it begins with, as a program."""
    model = compensator.model
    initial = np.zeros(1, records.STATE)
    records.begin(compensator.record, initial, model.initial_state())
    state = State(initial, wide=WIDE_STATES, pieces={"friction": _friction_pieces(model)})
    inputs = tuple(Variable("wide" if name in WIDE_INPUTS else "real", name) for name in INPUTS)

    def arguments(_: TableArray) -> list[Any]:
        return [Known([Settings(compensator.record[0])]), Known([StateRecord()]), *inputs]

    return _program(model, state, inputs, compensator_kernel.whole_step, arguments, "cycle")


def _program(
    model: FrictionModel,
    state: State,
    inputs: tuple[Variable, ...],
    step: Any,
    arguments: Callable[[TableArray], list[Any]],
    name: str,
) -> Program:
    """Translate until no further field of the state is found to change: until then it is taken for a constant."""
    while True:
        before = [one.is_changed for one in state.fields.values()]
        state.forget_use()
        translator = Translator(state, INTRINSICS, DEFINITIONS, PASSES, BUILT_IN)
        parameters = translator.table("friction", _used_values(model))
        parameters.names = _parameter_names(model)
        given = arguments(TableArray(parameters, known(0)))
        entry, _ = translator.function(step, given, name)
        if [one.is_changed for one in state.fields.values()] == before:
            break
    operands = tuple(each for each in translator.operands(entry, step, given) if isinstance(each, Variable))
    tables = tuple(each for each in translator.tables.values() if each.used)
    return Program(entry, operands, inputs, tuple(called(entry)), state, tables)


def called(entry: Function) -> list[Function]:
    """Return the functions that are called, callees first."""
    order: list[Function] = []

    def visit(one: Function) -> None:
        if one in order:
            return
        for statement in ir.statements(one.body):
            if isinstance(statement, ir.CallStatement):
                visit(statement.function)
            for expression in ir.expressions(statement):
                for each in ir.walk(expression):
                    if isinstance(each, ir.Call):
                        visit(each.function)
        order.append(one)

    visit(entry)
    return order


def _friction_pieces(model: FrictionModel) -> list[tuple[str, int, int]]:
    learned = 0 if model.network is None else model.network.structure.state_room
    end = kernel.NETWORK + max(learned, 1)
    return [
        ("friction", 0, kernel.DIRECTION),
        ("direction_of_motion", kernel.DIRECTION, kernel.DIRECTION + 1),
        ("since_reversal", kernel.DIRECTION + 1, kernel.NETWORK),
        ("network", kernel.NETWORK, end),
    ]


def _used_values(model: FrictionModel) -> Any:
    """Return the parameters without the unused room behind them, except what vectors of a network reach into."""
    end = len(model.packed_names)
    if model.network is not None:
        end += model.network.values.size + network.SPARE
    return model.values[:end]


def _parameter_names(model: FrictionModel) -> list[str]:
    return [name or "" for name in model.packed_names]
