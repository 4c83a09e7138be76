"""Time of ``friction-hil --help``, compared with a Python that only starts and imports click."""

import subprocess
import sys
import time
from pathlib import Path

from tools.benchmarks.report import Row, compare, rounds

ROUNDS = 21


def run() -> list[Row]:
    """Measure all three alternately; the first round, with cold caches, is not counted."""
    program = str(Path(sys.executable).with_name("friction-hil"))
    commands = {
        "help": [program, "--help"],
        "click": [sys.executable, "-c", "import click"],
        "bare": [sys.executable, "-c", "pass"],
    }
    times: dict[str, list[float]] = {name: [] for name in commands}
    for number in rounds(ROUNDS + 1, "friction-hil --help"):
        for name, command in commands.items():
            taken = wall_ms(command)
            if number:
                times[name].append(taken)
    # the second row separates the import of click from the start of Python
    return [
        compare("friction-hil --help (python -c 'import click')", "ms", times["help"], times["click"]),
        compare("python -c 'import click' (python -c pass)", "ms", times["click"], times["bare"]),
    ]


def wall_ms(command: list[str]) -> float:
    """Return the wall time of a command that must succeed, ms."""
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return (time.perf_counter() - began) * 1e3
