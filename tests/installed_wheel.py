"""The wheel of this project, built and installed beside the packages that the tests run with."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

from numba.core import caching

from friction_hil.numerics import jit
from tests.readme_commands import ROOT


def build(project: Path, folder: Path, *targets: str) -> list[Path]:
    """Build ``wheel`` or ``sdist`` of the project without a network; return the files."""
    words = [sys.executable, "-m", "hatchling", "build", "-d", folder]
    for target in targets:
        words += ["-t", target]
    done = subprocess.run(words, cwd=project, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    return sorted(folder.iterdir())


def install(wheel: Path, folder: Path) -> Path:
    """Install a wheel in an environment of its own, with the packages of this one behind it; return its interpreter.

    The path file leads to the packages, but not to the clone: Python does not process the path files of a folder that
    a path file names.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    pip = [sys.executable, "-m", "pip", "--python", folder, "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--no-compile", wheel], check=True)
    (site_packages(folder) / "packages_of_the_tests.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return folder / "bin/python"


def site_packages(environment: Path) -> Path:
    """Return the folder for packages of an environment."""
    (folder,) = environment.glob("lib/python*/site-packages")
    return folder


def share_compiled_code(python: Path, cache: Path) -> None:
    """Let numba find for the wheel what it has compiled for the clone, by a folder of links, ``cache``.

    numba keeps compiled code under the path of its source, and trusts it if time and size of the source are the same.
    Without the links the commands would give the same results a minute later.
    """
    kept = jit.cache_folder()
    if kept is None:
        return
    installed = site_packages(python.parents[1])
    here = cache / "friction_hil" / Path(kept).name
    here.mkdir(parents=True)
    for source in jit.kernel_sources():
        copy = installed / source.relative_to(ROOT)
        times = source.stat()
        os.utime(copy, ns=(times.st_atime_ns, times.st_mtime_ns))
        ours, theirs = (caching._CacheLocator.get_suitable_cache_subpath(str(path)) for path in (source, copy))
        (Path(kept) / ours).mkdir(exist_ok=True)
        if not (here / theirs).exists():
            (here / theirs).symlink_to(Path(kept) / ours)
