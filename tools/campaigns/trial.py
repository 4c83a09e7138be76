"""One try: drives and daemon as processes, a fault between them, and what is seen until everything has ended."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tools.campaigns import processes
from tools.campaigns.attempt import PHASES, Attempt, Running
from tools.campaigns.can_wire import CanWire
from tools.campaigns.faults import Fault
from tools.campaigns.machine import (
    CAN,
    COUNTS,
    MAPPED,
    MODES,
    NODE,
    SERIAL,
    SIDECAR,
    make_machine,
)
from tools.campaigns.serial_wire import SerialWire
from tools.campaigns.witness import Witness, is_powered

Start = Callable[..., Running]
_LOOK_S = 1e-3
_READY_S, _BEGIN_S, _END_S = 120.0, 60.0, 30.0  # patience: with drives, with the first SYNC, with the end of a run
_READ_BACK_S, _CHILDREN_S = 3.0, 15.0
_ASK_S = 4e-3
_WIRE_PRIORITY = 75  # below the daemon's
_ENABLING_S, _RUNNING_S = (0.0, 0.13), (0.4, 1.3)
_FIRST_MOTION_S = (0.3, 3.5)  # in csv
_AFTER_S = 1.0  # from the end of a fault to the request to stop
_STOPPING_S = 0.25
_EDGE = 1 << 31


@dataclass
class Seen:
    """What a try has shown.

    Attributes
    ----------
    struck_s : float or None
        Time of the fault; None if the run did not begin.
    status : int or None
        Exit status of the daemon; None if it had to be killed.
    result : dict
        What `run --json` printed.
    errors : str
        Standard error of the daemon.
    left : list of str
        Processes that did not end.
    """

    arena: str
    mode: str
    phase: str
    told: list[str]
    witness: Witness
    struck_s: float | None = None
    ended_s: float | None = None
    status: int | None = None
    drives_status: int | None = None
    result: dict[str, Any] = field(default_factory=dict)
    errors: str = ""
    cycles: int = 0
    frames: int = 0
    rows: int | None = None
    row_problem: str = ""
    left: list[str] = field(default_factory=list)
    has_hung: bool = False
    end_statusword: int | None = None


def start_command(*words: object, **options: Any) -> Running:
    """Start ``friction-hil`` with these words."""
    command = [sys.executable, "-m", "friction_hil", *map(str, words)]
    return subprocess.Popen(command, text=True, **options)


def run_trial(fault: Fault, seed: int, number: int, start: Start = start_command) -> Seen:
    """Run one try, which depends on name, seed and number, and on how fast this computer is.

    Raises
    ------
    RuntimeError
        The simulated drives do not start.
    """
    rng = random.Random(f"{fault.name} {seed} {number}")
    arena = fault.arenas[(number + len(fault.name)) % len(fault.arenas)]  # one try of each fault meets all of them
    mode = "csp" if arena == SIDECAR else rng.choice(MODES)
    with tempfile.TemporaryDirectory(prefix="campaign-") as name:
        attempt = _plan(Path(name), fault, arena, mode, rng, number)
        events = fault.events(attempt) if fault.events and arena != SERIAL else []
        attempt.machine = make_machine(Path(name), arena, mode, events, rng)
        attempt.machine.recording.parent.mkdir()
        witness = Witness(attempt.machine.limits)
        seen = Seen(arena, mode, attempt.phase, attempt.told, witness)
        with contextlib.ExitStack() as stack:
            fault.prepare(attempt)
            stack.callback(fault.release, attempt)
            stack.callback(_remove_journals, attempt)
            stack.enter_context(_drives(attempt, start, seen))
            attempt.wire = _wire(attempt, fault, witness)
            stack.callback(attempt.wire.close)
            stack.enter_context(_daemon(attempt, start, Path(name), seen))
            with _prompt():
                _run(attempt, fault, seen)
        return seen


def _plan(folder: Path, fault: Fault, arena: str, mode: str, rng: random.Random, number: int) -> Attempt:
    """Choose the moments of a try."""
    phase = rng.choices(PHASES, (1, 3, 1))[0]
    running_s = _FIRST_MOTION_S if mode == "csv" and arena == CAN else _RUNNING_S
    at_s = {"enabling": rng.uniform(*_ENABLING_S), "running": rng.uniform(*running_s)}.get(phase)
    lasts_s = fault.last_s[1] if fault.last_s else 0.5
    if at_s is None:
        stop_s = rng.uniform(*running_s)
        at_s = stop_s + rng.uniform(0.0, _STOPPING_S)
    else:
        stop_s = at_s + lasts_s + _AFTER_S
    return Attempt(folder, rng, number, phase, round(at_s, 4), round(stop_s, 4))


def _wire(attempt: Attempt, fault: Fault, witness: Witness) -> CanWire | SerialWire:
    machine = attempt.machine
    # positions begin at zero: the edge of the counter is a little further, where the axis passes it to and fro
    turns = _EDGE - attempt.random.randrange(COUNTS // 50) if fault.is_from_start else 0
    if machine.arena == SERIAL:
        return SerialWire(machine.daemon_line, machine.drive_line, witness, turns)
    mapped = MAPPED if machine.arena == SIDECAR else None
    return CanWire(machine.daemon_bus, machine.drive_bus, {NODE: witness}, mapped, turns)


@contextlib.contextmanager
def _drives(attempt: Attempt, start: Start, seen: Seen) -> Iterator[None]:
    """Run the simulated drives."""
    words = ["simulate", attempt.machine.drives, "--exit-with-stdin"]
    if attempt.machine.arena == SIDECAR:
        words.append("--master")
    with (attempt.folder / "drives").open("w") as errors:
        process = start(*words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors)
    attempt.drives = process
    own: list[processes.Process] = []
    try:
        if not process.stdout.readline().startswith("ready:"):
            said = (attempt.folder / "drives").read_text()
            raise RuntimeError(f"the simulated drives did not start: {said}")
        own = processes.descendants(process.pid)
        yield
    finally:
        process.send_signal(signal.SIGCONT)
        process.stdin.close()
        try:
            seen.drives_status = process.wait(timeout=_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
        left = processes.wait_for_end(own, _CHILDREN_S)
        seen.left += [f"process {each.pid}: {each.words}" for each in left]
        processes.end(left)
        if seen.drives_status not in (0, -signal.SIGKILL):
            seen.left.append(f"simulated drives: {(attempt.folder / 'drives').read_text()[-600:]}")


@contextlib.contextmanager
def _daemon(attempt: Attempt, start: Start, folder: Path, seen: Seen) -> Iterator[None]:
    """Run the daemon; at the end, take what it said, and end what it has left behind."""
    words = ("run", attempt.machine.daemon, "--json", "--record", attempt.machine.recording)
    options: dict[str, Any] = {"env": _with(attempt.environment)} if attempt.environment else {}
    with (folder / "output").open("w") as output, (folder / "errors").open("w") as errors:
        attempt.daemon = start(*words, stdin=subprocess.DEVNULL, stdout=output, stderr=errors, **options)
    try:
        yield
    finally:
        attempt.look_for_children()
        if attempt.daemon.poll() is None:
            attempt.daemon.kill()
            attempt.daemon.wait()
        left = processes.wait_for_end(attempt.known.values(), _CHILDREN_S)
        seen.left += [f"process {each.pid}: {each.words}" for each in left]
        processes.end(left)
        seen.errors = (folder / "errors").read_text(errors="replace")
        with contextlib.suppress(json.JSONDecodeError):
            seen.result = json.loads((folder / "output").read_text() or "{}")
        _count_rows(attempt, seen)


def _with(environment: dict[str, str]) -> dict[str, str]:
    return dict(os.environ) | environment


@contextlib.contextmanager
def _prompt() -> Iterator[None]:
    """Let the wire run before ordinary processes, as daemon and drives do, where that is allowed."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_WIRE_PRIORITY))
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, policy, parameters)


def _run(attempt: Attempt, fault: Fault, seen: Seen) -> None:
    """Watch the wire from the start of the daemon to the end of everything."""
    wire, daemon = attempt.wire, attempt.daemon
    limit_s = time.monotonic() + _BEGIN_S
    ends_s, is_active, is_stopping = float("inf"), False, False
    lasts_s = attempt.random.uniform(*fault.last_s) if fault.last_s else None
    try:
        while daemon.poll() is None:
            wire.poll(max(0.0, min(_LOOK_S, attempt.act())))
            now_s = time.monotonic()
            if now_s > limit_s:
                seen.has_hung = True
                break
            if wire.began_s is None:
                continue
            if seen.struck_s is None and now_s >= wire.began_s + attempt.at_s:
                attempt.look_for_children()
                seen.struck_s = time.monotonic()
                fault.begin(attempt)
                is_active = lasts_s is not None
                ends_s = seen.struck_s + (lasts_s or 0.0)
            if is_active:
                fault.step(attempt)
                if now_s >= ends_s:
                    is_active = False
                    fault.end(attempt)
            if not is_stopping and now_s >= wire.began_s + attempt.stop_s:
                is_stopping = True
                limit_s = now_s + _END_S
                daemon.send_signal(signal.SIGINT)
    finally:
        seen.ended_s = time.monotonic()
        seen.status = daemon.poll()
        seen.cycles, seen.frames = wire.cycles, wire.frames
        # what was stopped goes on, and what lasts ends, whatever has happened
        if is_active:
            fault.end(attempt)
        while attempt.act() < 1.0:
            wire.poll(_LOOK_S)
    _read_back(attempt, seen)


def _read_back(attempt: Attempt, seen: Seen) -> None:
    """Read the state of the drive until it has no power; the campaign asks by itself once the daemon has gone."""
    wire, witness = attempt.wire, seen.witness
    asked_s, until_s = 0.0, time.monotonic() + _READ_BACK_S
    witness.forget_status()
    while attempt.drives.poll() is None and time.monotonic() < until_s:
        if (now_s := time.monotonic()) - asked_s >= _ASK_S:
            asked_s = now_s
            if isinstance(wire, SerialWire):
                wire.ask()
            else:
                wire.ask(NODE, 0x60B2 if seen.arena == SIDECAR and witness.statusword is not None else 0x6041)
        wire.poll(_LOOK_S)
        if witness.statusword is None:
            continue
        if seen.end_statusword is None:
            seen.end_statusword = witness.statusword
        if seen.arena == SIDECAR:
            if witness.zero_since_s is not None:
                break
        elif not is_powered(witness.statusword):
            break


def _count_rows(attempt: Attempt, seen: Seen) -> None:
    """Count the rows of the recording, in all its files."""
    from friction_hil.errors import FrictionHilError
    from friction_hil.recordings import read_all

    path = attempt.machine.recording
    if not path.exists():
        seen.row_problem = "no recording"
        return
    try:
        recording = read_all(path)["x"]
    except (FrictionHilError, OSError) as error:
        seen.row_problem = str(error)
        return
    seen.rows = len(recording)


def _remove_journals(attempt: Attempt) -> None:
    """Remove what a killed daemon has kept for its next start."""
    port = attempt.machine.daemon_bus.port
    for path in Path(tempfile.gettempdir()).glob(f"friction_hil-*{port}*-{NODE}-*.json"):
        path.unlink(missing_ok=True)
