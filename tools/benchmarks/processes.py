"""Processes that benchmarks measure or need: simulated drives."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from friction_hil.errors import FrictionHilError

PROGRAM = [sys.executable, "-m", "friction_hil"]


@contextlib.contextmanager
def simulated(path: Path, pace: str = "real") -> Iterator[None]:
    """Run the simulated drives of a configuration in another process.

    Raises
    ------
    FrictionHilError
        They did not start.
    """
    words = [*PROGRAM, "simulate", str(path), "--exit-with-stdin", "--pace", pace]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            if not process.stdout.readline().startswith("ready:"):
                raise FrictionHilError("the simulated drive did not start")
            yield
        finally:
            process.stdin.close()
            process.wait()
