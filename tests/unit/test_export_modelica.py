"""Exports to Modelica do what this library does: in a strict interpreter, and in the compiler and simulator Rumoca."""

import math
import re
from functools import cache

import numpy as np
import pytest
import rumoca

from friction_hil.compensator import INPUTS
from friction_hil.export import modelica
from tests.c_exports import subject
from tests.export_subjects import COMPENSATORS, EVERY_MODEL, compensations, cycles, model_torques, steps
from tests.modelica_text import Package
from tests.structured_text import FaultError, RefusedError

UNKNOWN = 1e30
SIMULATED = ("coulomb", "dahl", "gms", "karnopp", "lugre_modified", "power_law", "stribeck")  # no loops that end early


def text(model, compensator=None):
    ((name, result),) = modelica.files(subject(model, "axis_x", compensator)).items()
    assert name == "AxisX.mo"
    return result


@cache
def compensator_text(name):
    each = COMPENSATORS[name]
    return text(each.model, each)


def begin(content):
    """The state that the last block of a package begins with; None if it has none."""
    found = re.findall(r"discrete Real state\[\d+\]\(start = \{(.*?)\}", content, re.DOTALL)
    return [float(each) for each in found[-1].split(",")] if found else None


def known(value):
    return UNKNOWN if math.isnan(value) else value


def test_every_model_gives_the_torque_of_this_library():
    for name, model in EVERY_MODEL.items():
        content = text(model)
        package, state, got = Package(content), begin(content), []
        rows = steps()[:40] if model.network is not None else steps()[:500]
        for row in rows:
            inputs = map(known, row)
            if state is None:
                got.append(package.call("ModelFunctions.step", *inputs))
            else:
                torque, state = package.call("ModelFunctions.step", state, *inputs)
                got.append(torque)
        wanted = model_torques(name)[: len(rows)]
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-12 * model.level, err_msg=name)


@pytest.mark.parametrize("name", ["kalman", "geared"])
def test_the_whole_compensator_gives_the_torque_of_this_library(name):
    content = compensator_text(name)
    package, state, last, got = Package(content), begin(content), -1.0, []
    rows = cycles() if name == "kalman" else cycles()[:600]
    for row in rows:
        inputs = dict(zip(INPUTS, row, strict=True))
        inputs["cycle"], last = inputs["cycle"] - last, inputs["cycle"]
        given = [bool(value) if one.startswith("is_") else known(value) for one, value in inputs.items()]
        torque, state = package.call("CompensatorFunctions.step", state, *given)
        got.append(torque)
    error = np.abs(np.array(got) - compensations(name)[: len(rows)]) / COMPENSATORS[name].model.level
    assert error.max() < 1e-12


def loaded(content, block, inputs, output):
    """A simulation of a block in Rumoca; inputs are expressions of time, with those that are switched on."""
    equations = "\n".join(f"  one.{name} = {expression};" for name, expression in inputs.items())
    uses = ", ".join(f"use_{name} = true" for name in inputs if name != "velocity") if block == "Model" else ""
    run = f"model Run\n  AxisX.{block} one({uses});\n  Real y;\nequation\n{equations}\n  y = one.{output};\nend Run;"
    return rumoca.Session().loads(f"{content}\n{run}\n", model="Run")


def simulated(model, end):
    """Output at every millisecond."""
    result = model.simulate(t=(0.0, end), dt=1e-3)
    at = {round(1e3 * t): value for t, value in zip(result.time, result["y"], strict=True)}  # the last one at a time
    return np.array([at[k] for k in range(round(1e3 * end))])


@pytest.mark.parametrize("name", SIMULATED)
def test_a_compiler_of_another_project_simulates_the_block(name):
    model, t = EVERY_MODEL[name], np.arange(100) * 1e-3
    inputs = {
        "velocity": "0.3 * sin(40.0 * time)",
        "position": "0.1 * time",
        "load_torque": "0.2 * cos(30.0 * time)",
        "temperature": "20.0 + 100.0 * time",
        "applied_torque": "0.05",
    }
    got = simulated(loaded(text(model), "Model", inputs, "friction"), 0.1)
    values = zip(0.3 * np.sin(40.0 * t), 0.1 * t, 0.2 * np.cos(30.0 * t), 20.0 + 100.0 * t, strict=True)
    runner = model.start("simulation")
    wanted = [
        runner.step(v, 1e-3, position=x, load_torque=load, temperature=celsius, applied_torque=0.05)
        for v, x, load, celsius in values
    ]
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9 * model.level)
    assert np.abs(got).max() > 0.1 * model.level


def test_its_front_end_takes_the_compensator():
    """Its simulator has no loops that depend on data; text, names and types are checked before it finds that out."""
    content = compensator_text("geared")
    inputs = {"position": "time", "position_demand": "time", "velocity_demand": "1.0", "velocity_demand_ahead": "1.0"}
    message = ""
    try:
        loaded(content, "Compensator", inputs, "compensation")
    except rumoca.CompileError as error:
        message = str(error)
    assert message == "" or message.startswith("todae failed")
    assert rumoca.validate_source(content) == []
    with pytest.raises(rumoca.CompileError, match="kernel_gains"):
        loaded(content.replace("kernel_gain(", "kernel_gains(", 1), "Compensator", inputs, "compensation")


BEGIN = 'package A\n  package Internal "x"\n    package F\n      constant Integer n = 2;\n      function f\n'
END = "\n      end f;\n    end F;\n  end Internal;\nend A;\n"
DECLARED = "input Real x; input Real s[n]; output Real y; protected Integer k; Boolean b; algorithm "


@pytest.mark.parametrize(
    "body",
    ["y := b;", "x := 1.0;", "y := z;", "k := x;", "y := s;", "if x then y := 1.0; end if;", "y := 1.0 + b;",
     "y := f(x);", "y := s[x];", "y := x and b;", "k := 1 / 2;", "y := max(x);"],
)  # fmt: skip
def test_the_interpreter_refuses_what_a_compiler_refuses(body):
    with pytest.raises(RefusedError):
        Package(f"{BEGIN}{DECLARED}{body}{END}")


@pytest.mark.parametrize(
    "body",
    ["y := 1.0 / x;", "y := s[3];", "y := s[0];", "y := 1e300 * (x + 1e300);", "k := 2147483647; k := k + 1;",
     "y := 1.0; b := x <> 0.0 and 1.0 / x > 2.0;", "y := log(x);", "y := 1.0 + k;", 'assert(x > 1.0, "no"); y := x;'],
)  # fmt: skip
def test_the_interpreter_stops_where_a_simulator_stops(body):
    package = Package(f"{BEGIN}{DECLARED}{body}{END}")
    with pytest.raises((FaultError, ArithmeticError, ValueError, NameError, AssertionError)):
        package.call("F.f", 0.0, [1.0, 2.0])
