"""Exports to C do, compiled, what this library does: every model, and the whole compensator."""

import ctypes
import math
import shutil

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.compensator import ThermalObserver
from friction_hil.errors import UsageError
from friction_hil.export import kernels
from friction_hil.export.c_printer import Printer
from friction_hil.export.ir import Variable
from friction_hil.export.translator import Translator
from friction_hil.export.values import State, StateRecord, TranslationError
from tests.c_exports import compensator_steps, compiled, model_steps, shared, subject, write
from tests.compensators import MODELS, compensator
from tests.networks import alone, beside, random_network

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

MODIFIERS = {
    "load": {"motoring": 0.1, "driven": 0.05},
    "temperature": {"reference": 40.0, "coefficient": -0.004},
    "viscous": {"quadratic": 1e-3, "cubic": 1e-4},
    "ripple": [{"order": 7, "cosine": 0.001, "sine": 0.002}],
}


def modified(name):
    example = fh.models.describe(name).example
    sides = {"positive": {"coulomb": 0.09}, "negative": {"coulomb": 0.07}}
    chosen = MODIFIERS | ({"direction": sides} if "coulomb" in example else {})
    return fh.models.create(name, modifiers=chosen, **example)


EVERY_MODEL = {
    **MODELS,
    **{f"{name}_modified": modified(name) for name in ("armstrong", "gms", "lugre", "table")},
    **{f"net_{name}": alone(random_network(name)) for name in ("narx", "every_input")},
    "dahl_2": fh.models.create("dahl", **dict(fh.models.describe("dahl").example) | {"exponent": 2.0}),
    "bouc_wen_2": fh.models.create("bouc_wen", **dict(fh.models.describe("bouc_wen").example) | {"exponent": 1.7}),
    "residual": beside(random_network("gated_2", is_residual=True), modifiers=MODIFIERS),
}
_GIVEN = {"position_resolution": 1e-4, "lead_s": 1.5e-3}
COMPENSATORS = {
    "tracking": compensator(MODELS["gms"], velocity="tracking", source="demand", max_acceleration=1e3, **_GIVEN),
    "kalman": compensator(
        modified("lugre"),
        velocity="kalman",
        gravity=(0.01, 0.02, 0.03),
        thermal=ThermalObserver(50.0, 2.0, 20.0, 25.0, 1.0),
        **_GIVEN,
    ),
    "drive": compensator(MODELS["stribeck"], velocity="drive", smoothing=0.3, dead_band=0.01, **_GIVEN),
    "adapting": compensator(
        MODELS["lugre"], adaptation_s=1.0, gain_negative=0.7, torque_slew=5.0, torque_limit=0.1, **_GIVEN
    ),
    "geared": compensator(
        modified("lugre"),
        load_inertia=1e-4,
        load_friction=0.03,
        backlash=1e-3,
        stiffness=200.0,
        offset_acceleration=100.0,
        offset_velocity=5.0,
        offset_limit=0.01,
        velocity_limit=20.0,
        setpoint_delay_s=1.5e-3,
        **_GIVEN,
    ),
}


def steps(count=1500):
    """Rows of a rough motion with rests for a model."""
    random = np.random.default_rng(0)
    v = 0.02 * np.cumsum(random.normal(size=count))
    v[random.integers(0, count, count // 10)] = 0.0
    v[count // 3 : count // 2] *= 1e-3
    load, applied = 0.1 * random.normal(size=(2, count))
    celsius = np.where(random.random(count) < 0.1, math.nan, 40.0 + 10.0 * random.normal(size=count))
    dt = np.where(np.arange(count) % 7, 1e-3, 2.6e-3)
    return np.column_stack((v, dt, 30.0 + np.cumsum(v) * 1e-3, load, celsius, applied)).tolist()


def cycles(count=3000):
    """Rows of a motion with following errors for a compensator: gaps, stale feedback, glitches, demands that go."""
    random, nan = np.random.default_rng(1), math.nan
    t = np.arange(count) * 1e-3
    demand = 0.3 * np.sin(4.4 * t) + 0.05 * np.sin(19.5 * t)
    speed = np.gradient(demand, 1e-3)
    acceleration = np.gradient(speed, 1e-3)
    error = 1e-3 * np.sin(70.0 * t) * np.exp(-(t % 0.7) / 0.2) + 7e-6 * np.cumsum(random.normal(size=count))
    position = np.round((demand + error) / 1e-4) * 1e-4
    measured = np.gradient(position, 1e-3)
    rows, cycle = [], 0
    for k in range(count):
        has_demand, is_fresh = not 1000 < k < 1700, random.random() > 0.02 and not 700 < k < 730
        torque = 0.05 * np.sign(measured[k]) + 0.01 * random.normal()
        known = demand[k] if k < 2500 else nan
        now = (known, speed[k], speed[min(k + 2, count - 1)]) if has_demand else (nan, nan, nan)
        glitch = 0.1 if random.random() < 0.002 else 0.0
        flags = float(is_fresh), float(k > 100 and not 2000 < k < 2100)
        last = acceleration[k] if has_demand else nan, 30.0 + 5.0 * math.sin(t[k]) if k % 3 else nan
        rows.append((float(cycle), position[k] + glitch, measured[k], torque, *now, *flags, *last))
        cycle += 1 if random.random() > 0.01 else int(random.integers(1, 25))
    return rows


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Everything as one library for each precision; compiled without a warning."""
    subjects = [subject(model, name) for name, model in EVERY_MODEL.items()]
    subjects += [subject(each.model, name, each) for name, each in COMPENSATORS.items()]
    folder = tmp_path_factory.mktemp("c")
    write(folder, subjects)
    return {single: compiled(folder, subjects, single=single) for single in (False, True)}


@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-12), (True, 1e-5)])
def test_every_model_gives_the_torque_of_this_library(library, single, tolerance):
    rows = steps()
    names = ("position", "load_torque", "temperature", "applied_torque")
    for name, model in EVERY_MODEL.items():
        runner = model.start("simulation")
        wanted = [runner.step(v, dt, **dict(zip(names, rest, strict=True))) for v, dt, *rest in rows]
        got = model_steps(library[single], name, rows, single=single)
        np.testing.assert_allclose(got, wanted, rtol=tolerance, atol=tolerance * model.level, err_msg=name)


@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-12), (True, 1e-5)])
def test_the_whole_compensator_gives_the_torque_of_this_library(library, single, tolerance):
    """In single precision a decision may fall a cycle later: then one cycle in a hundred may differ by more."""
    rows = cycles()
    for name, each in COMPENSATORS.items():
        state = each.state.copy()
        wanted = np.array([each.step(*row) for row in rows])
        each.state[:] = state
        error = np.abs(compensator_steps(library[single], name, rows, single=single) - wanted) / each.model.level
        assert np.abs(wanted).max() > 0.1 * each.model.level, name
        if single:
            assert np.quantile(error, 0.99) < tolerance, name
        else:
            assert error.max() < tolerance, name


@pytest.mark.skipif(shutil.which("clang") is None, reason="clang is not installed")
def test_clang_has_nothing_to_say_either(tmp_path):
    one = COMPENSATORS["kalman"]
    write(tmp_path, [subject(one.model, "axis", one)])
    for options in (["-O1"], ["-O1", "-DAXIS_SINGLE"]):
        assert shared(tmp_path, [tmp_path / "axis.c"], *options, compiler="clang").exists()


def test_wrong_use_is_refused_with_what_would_be_right():
    with pytest.raises(UsageError, match=r"no format 'd'.*\bc\b"):
        fh.export.files("coulomb:coulomb=1", to="d")
    with pytest.raises(UsageError, match="such as x_y"):
        fh.export.files("coulomb:coulomb=1", to="c", name="X-y")
    with pytest.raises(UsageError, match="another model"):
        fh.export.files("coulomb:coulomb=1", to="c", compensator=COMPENSATORS["drive"])


def _endless(s, velocity):
    while velocity > 0.0:
        velocity = velocity - 1.0
    return velocity


def _of_a_set(s, velocity):
    return len({velocity})


def _doubled(s, v):
    s.x = s.x * v
    return s.x


def _sum(s, v):
    return s.x + _doubled(s, v) + s.x


def translated(kernel):
    """Translate a kernel of the tests until it is known what changes."""
    state = State(np.zeros(1, [("x", "f8")]))
    for _ in range(2):
        translator = Translator(state, kernels.INTRINSICS, kernels.DEFINITIONS, kernels.PASSES)
        translator.function(kernel, [StateRecord(), Variable("real", "v")], kernel.__name__)
    return [one for one, _ in translator.functions.values()]


@pytest.mark.parametrize(("kernel", "why"), [(_endless, "number of passes"), (_of_a_set, "Set has no translation")])
def test_what_has_no_translation_is_refused_by_file_and_line(kernel, why):
    with pytest.raises(TranslationError, match=rf"test_export_c\.py:\d+: in {kernel.__name__}: .*{why}"):
        translated(kernel)


def test_operands_keep_their_order_where_one_changes_what_another_reads(tmp_path):
    """C may evaluate the operands of + in any order."""
    text = "".join(map(Printer("any", "state", []).function, translated(_sum)))
    source = tmp_path / "order.c"
    begin = "#include <stdint.h>\ntypedef double real;\n#define R(x) ((real)(x))\ntypedef struct { real x; } state;\n"
    end = "\nreal run(void);\nreal run(void)\n{\n    state s = {R(3.0)};\n    return any__sum(&s, R(2.0));\n}\n"
    source.write_text(begin + text + end)
    run = ctypes.CDLL(str(shared(tmp_path, [source]))).run
    run.restype = ctypes.c_double
    assert run() == 3.0 + 6.0 + 6.0
