"""What a new machine must wait for: what computes nothing does not import numba, and compilation is said."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.friction.dispatch import FAMILIES
from friction_hil.numerics.jit import cache_folder

EXAMPLE = Path(__file__).parents[3] / "config/demo.yaml"
PROGRAM = "import sys; from friction_hil.cli import main; assert main(sys.argv[1:]) == 0; "


def run(folder, *words, then=""):
    words = (sys.executable, "-c", PROGRAM + then, *map(str, words))
    environment = {"XDG_CACHE_HOME": str(folder / "cache"), "HOME": str(folder), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr


COMPILER = {"numba", "llvmlite"}
HEAVY = {"numpy", "scipy", "can", "canopen", "pydantic", "matplotlib", "rich", "yaml", "mcap", "serial", *COMPILER}


@pytest.mark.parametrize(
    ("words", "modules"),
    [
        (("--help",), HEAVY),
        (("config", "check", EXAMPLE), COMPILER),
        (("config", "new", "new.yaml", "--simulated"), COMPILER),
        (("models", "lugre"), {*COMPILER, "matplotlib"}),
        (("convert", "--info", "a.csv"), COMPILER),
    ],
    ids=lambda given: " ".join(given[:2]) if isinstance(given, tuple) else "",
)
def test_a_command_imports_nothing_that_it_does_not_need(words, modules, tmp_path):
    table = tmp_path / "a.csv"
    table.write_text("time_s,position,torque\n0,0,0\n0.001,0.1,0.1\n0.002,0.2,0.1\n0.003,0.3,0.1\n")
    own = {"new.yaml": tmp_path / "new.yaml", "a.csv": table}
    then = f"assert 'click' in sys.modules and not {modules} & set(sys.modules)"
    run(tmp_path, *(own.get(each, each) for each in words), then=then)


@pytest.mark.parametrize("name", [name for name, family in FAMILIES.items() if not family.is_static])
def test_the_stiffness_is_the_slope_of_a_creeping_motion(name):
    """It is a formula of each family: to compute it from the motion would compile all of them."""
    model = fh.models.create(name, **fh.models.describe(name).example)
    position = 1e-6 * model.level / model.presliding_stiffness
    slope = model.simulate(np.full(1, position / 1e6), 1e6)[0] / position  # slow enough that damping is negligible
    assert model.presliding_stiffness == pytest.approx(slope, rel=1e-5)


@pytest.mark.deep
def test_compilation_is_said_on_a_terminal(tmp_path):
    main, terminal = os.openpty()
    environment = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    code = PROGRAM + "import friction_hil as fh; "
    code += "fh.models.create('coulomb', coulomb=1.0).simulate([1.0], 1e-3)"
    done = subprocess.run([sys.executable, "-c", code, "models"], env=environment, stderr=terminal, timeout=240)
    os.close(terminal)
    said = os.read(main, 4096).decode()
    os.close(main)
    assert done.returncode == 0
    assert said.count("compiling, once on this machine") == 1


@pytest.mark.deep
def test_doctor_compiles_what_a_run_needs(tmp_path):
    """It compiles what this machine's cache lacks; a second time nothing is left to compile."""
    folder = Path(cache_folder())
    shutil.copytree(folder, tmp_path / "friction_hil" / folder.name, ignore=shutil.ignore_patterns("*.tmp.*"))
    environment = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    words = [sys.executable, "-m", "friction_hil", "doctor", "--warm", "--json"]
    made = []
    for _ in range(2):
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=400)
        assert done.stdout.startswith("["), done.stderr
        made.append({(each.name, each.stat().st_mtime_ns) for each in tmp_path.rglob("*.nbc")})
    assert len(made[0]) > 20
    assert made[1] == made[0]
