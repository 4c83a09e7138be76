"""Functional mock-up units, run by FMPy, do what this library does; FMPy's checks of the standard find nothing."""

import io
import math
import shutil
import subprocess
import zipfile

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import friction_hil as fh
from friction_hil.compensator import INPUTS
from friction_hil.errors import UsageError
from friction_hil.export import fmu
from tests.c_exports import subject
from tests.export_subjects import COMPENSATORS, EVERY_MODEL, compensations, cycles, model_torques, steps

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")

COMPENSATOR, MODEL = "kalman", "lugre_modified"
STANDARDS = (2, 3)
UNKNOWN = 1e30


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The archives of one model and of its compensator."""
    folder = tmp_path_factory.mktemp("fmu")
    one = COMPENSATORS[COMPENSATOR]
    for name, content in fmu.files(subject(one.model, "axis", one)).items():
        (folder / name).write_bytes(content)
    return folder


class Unit:
    """An instance of an archive in FMPy, with variables by their names."""

    def __init__(self, path, standard):
        description = fmpy.read_model_description(str(path))
        self.of = {each.name: each for each in description.modelVariables}
        self.is_3 = standard == 3
        self.messages = []
        given = {"fmi_type": "CoSimulation", "debug_logging": True, "logger": self._log}
        self.one = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, **given)
        self.real = (self.one.getFloat64, self.one.setFloat64) if self.is_3 else (self.one.getReal, self.one.setReal)
        if not self.is_3:
            self.one.setupExperiment(startTime=0.0)
        self.one.enterInitializationMode()
        self.one.exitInitializationMode()

    def _log(self, *given):
        self.messages.append(given[-1] if self.is_3 else given[4])

    def step(self, at, length, output, **inputs):
        for name, value in inputs.items():
            self.set(name, value)
        self.one.doStep(currentCommunicationPoint=at, communicationStepSize=length)
        return self.real[0]([self.of[output].valueReference])[0]

    def set(self, name, value):
        set_value = self.one.setBoolean if self.of[name].type == "Boolean" else self.real[1]
        set_value([self.of[name].valueReference], [value])


def of_model(row):
    velocity, dt, *rest = row
    names = ("position", "load_torque", "temperature", "applied_torque")
    return dt, {"velocity": velocity, **dict(zip(names, rest, strict=True))}


def of_compensator(row):
    given = dict(zip(INPUTS, row, strict=True))
    cycle = given.pop("cycle")
    return cycle, {name: bool(value) if name.startswith("is_") else value for name, value in given.items()}


@pytest.mark.parametrize("standard", STANDARDS)
def test_the_model_gives_the_torque_of_this_library(folder, standard):
    unit, t, got = Unit(folder / f"axis_model_fmi{standard}.fmu", standard), 0.0, []
    for row in steps():
        dt, inputs = of_model(row)
        got.append(unit.step(t, dt, "friction", **inputs))
        t += dt
    np.testing.assert_allclose(got, model_torques(MODEL), rtol=1e-12, atol=1e-12 * EVERY_MODEL[MODEL].level)


@pytest.mark.parametrize("standard", STANDARDS)
def test_the_compensator_gives_the_torque_of_this_library(folder, standard):
    """Unknown inputs are NaN in one version and the number of the start values in the other."""
    unit, at, got = Unit(folder / f"axis_compensator_fmi{standard}.fmu", standard), 0.0, []
    one = COMPENSATORS[COMPENSATOR]
    rows = cycles()[:2600]
    for row in rows:
        cycle, inputs = of_compensator(row)
        if standard == 2:
            inputs = {name: UNKNOWN if math.isnan(value) else value for name, value in inputs.items()}
        end = (cycle + 1.0) * one.settings.period_s
        got.append(unit.step(at, end - at, "compensation", **inputs))
        at = end
    assert np.abs(np.array(got) - compensations(COMPENSATOR)[: len(rows)]).max() < 1e-12 * one.model.level


@pytest.mark.parametrize("standard", STANDARDS)
def test_steps_shorter_than_the_period_hold_the_output(folder, standard):
    whole, parts = (Unit(folder / f"axis_compensator_fmi{standard}.fmu", standard) for _ in range(2))
    period = COMPENSATORS[COMPENSATOR].settings.period_s
    for k, row in enumerate(cycles()[:150]):
        _, inputs = of_compensator(row)
        wanted = whole.step(k * period, period, "compensation", **inputs)
        for part in range(4):
            assert parts.step((k + part / 4) * period, period / 4, "compensation", **inputs) == wanted


@pytest.mark.parametrize("standard", STANDARDS)
def test_a_state_is_taken_stored_and_set_again(folder, standard):
    unit = Unit(folder / f"axis_model_fmi{standard}.fmu", standard)
    names = ("getFMUState", "setFMUState", "serializeFMUState", "deserializeFMUState")
    if standard == 2:
        names = ("getFMUstate", "setFMUstate", "serializeFMUstate", "deSerializeFMUstate")
    take, give, store, load = (getattr(unit.one, name) for name in names)
    rows = [of_model(row) for row in steps()[:60]]

    def run(part):
        return [unit.step(0.0, dt, "friction", **inputs) for dt, inputs in part]

    run(rows[:30])
    stored = store(take())
    after = run(rows[30:])
    give(load(stored))
    assert run(rows[30:]) == after
    unit.one.reset()
    assert run(rows[30:]) != after


@pytest.mark.parametrize("standard", STANDARDS)
def test_what_is_wrong_is_refused_with_a_message(folder, standard):
    unit = Unit(folder / f"axis_model_fmi{standard}.fmu", standard)
    for wrong in (
        lambda: unit.step(0.0, 0.0, "friction"),
        lambda: unit.step(0.0, -1e-3, "friction"),
        lambda: unit.step(0.0, math.inf, "friction"),
        lambda: unit.set("velocity", math.nan),
        lambda: unit.set("friction", 1.0),
        lambda: unit.set("parameter.sigma0", 1.0),
    ):
        before = len(unit.messages)
        with pytest.raises(Exception, match="fmi"):
            wrong()
        assert len(unit.messages) == before + 1


@pytest.mark.parametrize("name", [f"axis_{kind}_fmi{each}" for kind in ("model", "compensator") for each in STANDARDS])
def test_the_standard_is_kept_and_the_sources_compile_without_a_warning_alone(folder, tmp_path, name):
    assert validate_fmu(str(folder / f"{name}.fmu")) == []
    with zipfile.ZipFile(folder / f"{name}.fmu") as archive:
        archive.extractall(tmp_path)
    flags = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused-parameter", "-fsyntax-only")
    done = subprocess.run(["cc", *flags, *(tmp_path / "sources").glob("*.c")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_same_export_gives_the_same_bytes_and_says_where_it_comes_from(tmp_path):
    first = fh.export.files("coulomb:coulomb=0.25", to="fmu", name="axis")
    assert sorted(first) == ["axis_model_fmi2.fmu", "axis_model_fmi3.fmu"]
    page = zipfile.ZipFile(io.BytesIO(first["axis_model_fmi3.fmu"])).read("documentation/index.html").decode()
    assert "coulomb: 0.25" in page
    paths = fh.export.write("coulomb:coulomb=0.25", "fmu", tmp_path, name="axis")
    assert {path.name: path.read_bytes() for path in paths} == first


@pytest.mark.parametrize(
    ("compiler", "message"),
    [("no-such-compiler", "'no-such-compiler'.*apt install gcc"), ("false", "^false .* failed: status 1$")],
)
def test_without_a_compiler_the_message_says_what_to_install(monkeypatch, compiler, message):
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(UsageError, match=message):
        fh.export.files("coulomb:coulomb=0.25", to="fmu")
