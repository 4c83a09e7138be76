"""A command of friction-hil as a child process, which ends with this process in any case."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from friction_hil.errors import FrictionHilError

_END_TIMEOUT_S = 20.0  # after SIGTERM


class Child:
    """A child process.

    It has a session of its own, so that Ctrl-C reaches only this process, which ends its children in order. Its
    standard input is closed when this process ends, even if it is killed; ``simulate --exit-with-stdin`` then ends too.

    ``arguments``: command and its arguments, without the program's name. ``folder``: for its output. ``environment``:
    variables that it gets besides those of this process.
    """

    def __init__(
        self, arguments: Sequence[str], folder: Path, environment: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._name = arguments[0]
        self._out, self._err = folder / f"{self._name}.out", folder / f"{self._name}.err"
        with open(self._out, "wb") as out, open(self._err, "wb") as err:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "friction_hil", *arguments],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                env={**os.environ, **environment},
                start_new_session=True,
            )

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        process = self._process
        try:
            if process.poll() is None:
                process.terminate()  # a daemon brings its axes to rest, drives leave the bus
                process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            pass
        finally:
            process.kill()
            process.wait()
            assert process.stdin is not None
            process.stdin.close()

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; return True if it has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        return self._process.returncode is not None

    def refuse_failure(self, error: type[FrictionHilError]) -> None:
        """Raise ``error`` with its messages if it has failed."""
        if status := self._process.poll():
            said = self.said.strip() or f"exit status {status}"
            raise error(f"'friction-hil {self._name}' failed:\n{said}")

    @property
    def printed(self) -> str:
        """Its standard output so far."""
        return self._out.read_text(encoding="utf-8")

    @property
    def said(self) -> str:
        """Its standard error so far."""
        return self._err.read_text(encoding="utf-8", errors="replace")
