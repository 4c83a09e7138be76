"""The command line ``tools/mutants``."""

import json
import math
import os
import queue
import random
import subprocess
import sys
import threading
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import click

from friction_hil.errors import FrictionHilError, UsageError, choices
from tools.mutation.changes import Change, changes_of
from tools.mutation.modules import MODULES, name_of, related_tests

_REVIEWED = Path(__file__).with_name("reviewed.toml")
_MOST = 400
_MOST_S = 3600.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant: ``failed`` or ``timeout`` (its tests noticed it), ``passed`` or ``not called``."""

    path: str
    change: Change
    status: str

    @property
    def survives(self) -> bool:
        """True if no test has noticed it."""
        return self.status in ("passed", "not called")

    @property
    def identity(self) -> str:
        """Module and change."""
        return f"{name_of(self.path)} {self.change.identity}"


@click.command()
@click.option("--only", multiple=True, metavar="MODULE", help="Only this module, e.g. daemon.safety; may be repeated.")
@click.option("--sample", type=click.FloatRange(1.0), metavar="SECONDS", help="End after SECONDS, with what was tried.")
@click.option("--seed", help="Seed of the choice.  [default: the date of the commit]")
@click.option("--jobs", type=click.IntRange(1), default=os.cpu_count(), show_default=True, help="Modules at a time.")
@click.option("--list", "is_listing", is_flag=True, help="List the modules with the number of their mutants.")
def command(only: tuple[str, ...], sample: float | None, seed: str | None, jobs: int, is_listing: bool) -> int:
    """Change one expression of a safety-critical module at a time; a test has to fail.

    Comparisons, conditions, constants and returns are changed, in memory, with the related tests of each module
    (tools/mutation/modules.py); compiled kernels are left out. At most 400 mutants are tried, for an hour at most. What
    no test notices is printed, and is exit status 1 unless tools/mutation/reviewed.toml says why it changes no frame,
    state or time of a stop.
    """
    paths = [_path(name) for name in only] or list(MODULES)
    changes = {path: changes_of(Path(path).read_text()) for path in paths}
    if is_listing:
        for path in paths:
            click.echo(f"{len(changes[path]):4}  {path}")
        return 0
    seed = seed or _date_of_commit()
    chosen = choice(changes, random.Random(seed))
    total = sum(len(numbers) for _, numbers in chosen)
    click.echo(f"{total} of {sum(map(len, changes.values()))} mutants, seed {seed!r}", err=True)
    began_s = time.monotonic()
    outcomes = _try_all(chosen, changes, began_s + (sample or _MOST_S), jobs)
    return _report(outcomes, time.monotonic() - began_s)


def choice(changes: dict[str, list[Change]], rng: random.Random) -> list[tuple[str, list[int]]]:
    """Return the mutants to try, by module."""
    every = [(path, number) for path, found in changes.items() for number in range(len(found))]
    rng.shuffle(every)
    numbers: dict[str, list[int]] = {}
    for path, number in every[:_MOST]:
        numbers.setdefault(path, []).append(number)
    return list(numbers.items())


def _try_all(
    chosen: list[tuple[str, list[int]]], changes: dict[str, list[Change]], end_s: float, jobs: int
) -> list[Outcome]:
    """Try the mutants, each module for its part of the time."""
    waiting: queue.SimpleQueue[tuple[str, list[int]]] = queue.SimpleQueue()
    for each in chosen:
        waiting.put(each)
    outcomes: list[Outcome] = []
    failures: list[str] = []

    def work() -> None:
        while (now_s := time.monotonic()) < end_s and not failures:
            turns = max(1, math.ceil(waiting.qsize() / jobs))
            try:
                path, numbers = waiting.get_nowait()
            except queue.Empty:
                return
            turn_end_s = now_s + (end_s - now_s) / turns
            if failure := _try_module(path, numbers, changes[path], turn_end_s, outcomes):
                failures.append(failure)

    threads = [threading.Thread(target=work) for _ in range(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        raise FrictionHilError("\n".join(failures))
    return outcomes


def _try_module(path: str, numbers: list[int], changes: list[Change], end_s: float, outcomes: list[Outcome]) -> str:
    """Try mutants of a module until the time is over; return why that is not possible, empty if it was."""
    root = os.fspath(Path.cwd())
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join((root, f"{root}/drivers", *sys.path)),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HYPOTHESIS_STORAGE_DIRECTORY": os.devnull,  # examples of one mutant are not tried on the next
    }
    words = [sys.executable, "-P", "-m", "tools.mutation.worker", path, *related_tests(path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as worker:
        assert worker.stdin is not None
        assert worker.stdout is not None
        first = json.loads(worker.stdout.readline() or "{}")
        if first.get("status") != "passed":
            return f"{path}: its tests do not pass without a change ({first.get('status', 'no answer')})"
        click.echo(f"{path}: {first['tests']} tests pass in {first['seconds']:.0f} s", err=True)
        for k, number in enumerate(numbers):
            if k and time.monotonic() > end_s:  # one at least, after what its first run has taken
                break
            worker.stdin.write(f"{number}\n")
            worker.stdin.flush()
            answer = json.loads(worker.stdout.readline() or '{"status": "lost"}')
            if answer["status"] == "lost":
                return f"{path}: the process of its tests has ended in change {number}"
            found = Outcome(path, changes[number], answer["status"])
            outcomes.append(found)
            if found.survives:
                click.echo(_line(found), err=True)
        worker.stdin.close()
    return ""


def _report(outcomes: list[Outcome], seconds: float) -> int:
    reviewed = _reviewed()
    alive = sorted(
        (each for each in outcomes if each.survives), key=lambda each: (each.path, each.change.line, each.identity)
    )
    serious = [each for each in alive if each.identity not in reviewed]
    for each in serious:
        click.echo(_line(each))
    late = sum(each.status == "timeout" for each in outcomes)
    click.echo(
        f"{len(outcomes)} mutants in {seconds:.0f} s: {len(outcomes) - len(alive)} noticed ({late} by their time), "
        f"{len(alive) - len(serious)} reviewed and harmless, {len(serious)} not noticed"
    )
    return 1 if serious else 0


def _line(outcome: Outcome) -> str:
    note = " (no test calls it)" if outcome.status == "not called" else ""
    return f"{outcome.path}:{outcome.change.line}: {outcome.change.identity}{note}"


def _reviewed() -> dict[str, str]:
    """Return the mutants that change nothing that matters, by identity, each with the reason."""
    table = tomllib.loads(_REVIEWED.read_text())
    return {f"{each['module']} {change}": each["reason"] for each in table["harmless"] for change in each["changes"]}


def _path(name: str) -> str:
    found = [path for path in MODULES if name in (path, name_of(path), name_of(path).partition(".")[2])]
    if not found:
        known = [name_of(path).partition(".")[2] for path in MODULES]
        raise UsageError(f"--only {name}: no such module; {choices(name, known)}")
    return found[0]


def _date_of_commit() -> str:
    asked = subprocess.run(["git", "log", "-1", "--format=%cd"], capture_output=True, text=True, check=False)
    return asked.stdout.strip() or "no commit"
