"""Exports to C do, compiled, what this library does: every model, and the whole compensator."""

import ctypes
import math
import os
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.compensator import INPUTS
from friction_hil.errors import UsageError
from friction_hil.export import c, kernels
from friction_hil.export.c_printer import Printer
from friction_hil.export.ir import Variable
from friction_hil.export.translator import Translator
from friction_hil.export.values import State, StateRecord, TranslationError
from friction_hil.models.model_file import ModelFile
from tests.c_exports import check, compensator_steps, compiled, model_steps, shared, subject, write
from tests.export_subjects import COMPENSATORS, EVERY_MODEL, compensations, cycles, model_torques, steps

GOLDEN = Path(__file__).parent / "golden"

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Everything as one library for each precision; compiled without a warning."""
    subjects = [subject(model, name) for name, model in EVERY_MODEL.items()]
    subjects += [subject(each.model, name, each) for name, each in COMPENSATORS.items()]
    folder = tmp_path_factory.mktemp("c")
    write(folder, subjects)
    return {single: compiled(folder, subjects, single=single) for single in (False, True)}


@pytest.mark.parametrize("name", fh.models.names())
def test_the_source_of_each_family_is_the_one_that_stands_here(name):
    """Whoever moves a kernel or the translation without meaning to change what users compile notices it here."""
    friction = {"model": name, "parameters": dict(fh.models.describe(name).example)}
    model = ModelFile.model_validate({"axis": "rotary", "friction": friction})
    assert fh.export.files(model, to="c", name=name)[f"{name}.c"] == (GOLDEN / f"{name}.c").read_text()


@pytest.mark.deep
@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-12), (True, 1e-5)])
def test_every_model_gives_the_torque_of_this_library(library, single, tolerance):
    for name, model in EVERY_MODEL.items():
        got = model_steps(library[single], name, steps(), single=single)
        wanted = model_torques(name)
        np.testing.assert_allclose(got, wanted, rtol=tolerance, atol=tolerance * model.level, err_msg=name)


@pytest.mark.parametrize("single", [False, True])
def test_the_friction_is_finite_for_all_finite_inputs(library, single):
    """Speeds, times, torques over the range of float, positions over that of double."""
    chosen, sizes = random.Random(0), (0.0, 1e-38, 1e-12, 1e-3, 1.0, 1e3, 1e8, 1e13, 1e15, 1e25)

    def any_size(largest=3e38):
        return chosen.choice((-1, 1)) * chosen.choice((*sizes, largest))

    def any_row():
        start = (any_size(), abs(any_size()) or 1e-3, any_size(1e308), any_size())
        return (*start, chosen.choice((math.nan, any_size())), any_size())

    rows = [any_row() for _ in range(1000)]
    for name in EVERY_MODEL:
        assert np.all(np.isfinite(model_steps(library[single], name, rows, single=single))), name


@pytest.mark.parametrize("single", [False, True])
def test_the_whole_compensator_gives_the_torque_of_this_library(library, single):
    """In single precision a decision may fall a cycle later: then one cycle in a hundred may differ by more."""
    for name, each in COMPENSATORS.items():
        wanted = compensations(name)
        error = np.abs(compensator_steps(library[single], name, cycles(), single=single) - wanted) / each.model.level
        assert np.abs(wanted).max() > 0.1 * each.model.level, name
        assert np.quantile(error, 0.99 if single else 1.0) < (1e-5 if single else 1e-12), name


@pytest.mark.parametrize("single", [False, True])
def test_after_a_gap_of_any_length_the_compensator_goes_on_as_this_library(library, single):
    """Gaps that whole numbers of the source do not hold, one after the other; in between cycles as ever."""
    rows = [list(row) for row in cycles()[200:420]]
    for k, row in enumerate(rows):
        row[INPUTS.index("cycle")] = float(k + (k // 70) * (2**32 - 2))
    for name, each in COMPENSATORS.items():
        state = each.state.copy()
        wanted = np.array([each.step(*row) for row in rows])
        each.state[:] = state
        error = np.abs(compensator_steps(library[single], name, rows, single=single) - wanted) / each.model.level
        assert np.quantile(error, 0.97 if single else 1.0) < (1e-5 if single else 1e-12), name


def test_no_input_does_what_the_language_leaves_undefined(tmp_path, capfd):
    """Numbers of any size, also those that are none, and gaps of any length; UBSan writes what it finds."""
    sanitized = ("-fsanitize=undefined,float-cast-overflow,bounds-strict", "-O0")
    chosen, values = random.Random(0), (0.0, 1e-300, -1e-12, 1.0, -1e3, 9e15, -1e30, math.nan, math.inf, -math.inf)
    tried = {name: COMPENSATORS[name] for name in ("geared", "kalman")}
    write(tmp_path, [subject(one.model, name, one) for name, one in tried.items()])
    made = ctypes.CDLL(str(shared(tmp_path, [tmp_path / f"{name}.c" for name in tried], *sanitized)))
    for name, one in tried.items():
        rows, cycle = [], 0
        for _ in range(300):
            cycle += chosen.choice((0, 1, 1, 2, 30, 2**31, 2**32 - 1))
            rows.append([float(cycle), *(chosen.choice(values) for _ in INPUTS[1:])])
            for flag in ("is_fresh", "is_enabled"):
                rows[-1][INPUTS.index(flag)] = float(chosen.random() > 0.1)
        assert np.abs(compensator_steps(made, name, rows)).max() <= one.settings.torque_limit
    assert "runtime error" not in capfd.readouterr().err


def test_the_header_states_the_sizes_that_the_compiler_finds(library):
    for name, kind in (("residual", "model"), ("kalman", "compensator"), ("geared", "compensator")):
        one = COMPENSATORS.get(name)
        header = c.files(subject(EVERY_MODEL[name] if one is None else one.model, name, one))[f"{name}.h"]
        (stated,) = re.findall(rf"{name}_{kind}: state (\d+) bytes, in single precision (\d+) bytes", header)
        for size, single in zip(map(int, stated), (False, True), strict=True):
            assert ctypes.c_ulong.in_dll(library[single], f"size_of_{name}_{kind}").value == size


@pytest.mark.skipif(shutil.which("clang") is None, reason="clang is not installed")
def test_clang_has_nothing_to_say_either(tmp_path):
    one = COMPENSATORS["kalman"]
    write(tmp_path, [subject(one.model, "axis", one)])
    for options in ([], ["-DAXIS_SINGLE"]):
        check([tmp_path / "axis.c"], *options, compiler="clang")


def test_the_example_of_the_readme_compiles(tmp_path):
    readme = Path(c.__file__).with_name("README.md").read_text()
    (example,) = re.findall(r"```c\n(.*?)```", readme, re.DOTALL)
    one = COMPENSATORS["tracking"]
    write(tmp_path, [subject(one.model, "axis_x", one)])
    (tmp_path / "example.c").write_text(example)
    for options in ([], ["-DAXIS_X_SINGLE"]):
        check([tmp_path / "example.c"], *options)


NAMES = ("int", "r", "p", "m", "model", "a" * 40)


def test_a_name_may_be_a_word_of_the_language(tmp_path):
    """Each name begins longer ones; C++ includes all headers at once."""
    write(tmp_path, [subject(EVERY_MODEL["lugre_modified"], name) for name in NAMES])
    check([tmp_path / f"{name}.c" for name in NAMES])
    (tmp_path / "all.cpp").write_text("".join(f'#include "{name}.h"\n' for name in NAMES))
    command = ["clang", "-std=c++11", "-Wall", "-Wextra", "-pedantic", "-fsyntax-only", tmp_path / "all.cpp"]
    if shutil.which("clang"):
        assert subprocess.run(command, capture_output=True, text=True).stderr == ""


@pytest.mark.parametrize(
    ("words", "begins", "acts"),
    [(["--delay", "1e-3"], "0.001", "0.0018"), (["--delay", "0"], "0", "0.0008"), ([], "0.0013", "0.0021")],
)
def test_the_command_says_when_the_torque_begins_to_act(tmp_path, capsys, words, begins, acts):
    """The delay that was given, or that of the model file; half a period and the lag of the torque come on top."""
    given = ["--to", "c", "--output", str(tmp_path / "x.c"), "--config", "config/single_axis_csp.yaml"]
    assert main(["export", "config/models/lugre_axis.yaml", *given, "--resolution", "4.8e-5", *words]) == 0
    printed = capsys.readouterr().out
    assert f"{begins} s (--delay)" in printed
    assert f"computed for {acts} s after" in printed


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"to": "d"}, r"'d'.*\bc\b"),
        ({"to": "modelica"}, "'modelica'.*--to fmu"),
        ({"to": "c", "name": "X-y"}, "such as x_y"),
        ({"to": "c", "compensator": COMPENSATORS["drive"]}, "another model"),
        ({"to": "c", "name": "math"}, "such as axis_math"),  # it would hide a file of the language
        ({"to": "fmu", "name": "stdint"}, "such as axis_stdint"),
        ({"to": "fmu", "name": "fmu"}, "such as axis_fmu"),
        ({"to": "fmu", "name": "fmi2"}, "such as axis_fmi2"),
        ({"to": "st", "name": "a__b"}, "such as a_b$"),
        ({"to": "st", "name": "a_"}, "such as a$"),
        ({"to": "st", "name": "AxisX"}, "such as axis_x$"),
        ({"to": "st", "name": "9"}, "such as axis_9$"),
        ({"to": "st", "name": "b" * 41}, f"such as {'b' * 40}$"),
    ],
)
def test_wrong_use_and_names_are_refused_with_what_would_be_right(given, message):
    with pytest.raises(UsageError, match=message):
        fh.export.files("coulomb:coulomb=1", **given)


def test_the_same_export_gives_the_same_bytes_in_every_process():
    """Python gives texts another hash in each process, and so sets another order."""
    script = "import friction_hil as fh; print(fh.export.files('table:points=[[0, 1], [1, 2]]', to='c')['table.c'])"
    made = [
        subprocess.check_output([sys.executable, "-c", script], env=os.environ | {"PYTHONHASHSEED": seed}, text=True)
        for seed in ("1", "2")
    ]
    assert made[0] == made[1]
    assert "&& false" not in made[0]


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
