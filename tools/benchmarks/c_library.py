"""C loops that benchmarks compare with, compiled when they are needed."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

from friction_hil.errors import FrictionHilError

COMMAND = ("gcc", "-O3", "-march=native", "-shared", "-fPIC")


def load(source: Path) -> ctypes.CDLL:
    """Compile a C file and load it; it stays loaded when its file is removed.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """
    if shutil.which("gcc") is None:
        raise FrictionHilError(f"there is no gcc here to compile {source.name} with: sudo apt install gcc")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / source.with_suffix(".so").name
        done = subprocess.run([*COMMAND, "-o", library, source, "-lm"], capture_output=True, text=True)
        if done.returncode:
            raise FrictionHilError(f"gcc could not compile {source.name}: {done.stderr.strip()}")
        return ctypes.CDLL(str(library))
