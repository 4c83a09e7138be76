"""How long ``friction-hil --help`` takes, against a Python that starts and imports click, in turns with it."""

import subprocess
import sys
import time
from pathlib import Path

from tools.benchmarks.report import Row, compare, rounds

ROUNDS = 21


def run() -> list[Row]:
    """Measure all three in turns; the first, cold round does not count."""
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
    # bare Python plus click's import is what Python takes to import click
    return [
        compare("friction-hil --help (python -c 'import click')", "ms", times["help"], times["click"]),
        compare("python -c 'import click' (python -c pass)", "ms", times["click"], times["bare"]),
    ]


def wall_ms(command: list[str]) -> float:
    """Wall time of a command that must succeed, ms."""
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return (time.perf_counter() - began) * 1e3
