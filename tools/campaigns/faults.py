"""The faults of a campaign: what each does, for how long, and by which codes its cause is named."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tools.campaigns import attacks, on_wire
from tools.campaigns.attempt import Attempt
from tools.campaigns.machine import CAN, SERIAL, SIDECAR

ALL, ON_CAN, ON_BUS = (CAN, SIDECAR, SERIAL), (CAN,), (CAN, SIDECAR)
# Events of the simulated drive count from the first SYNC. Beside a master that comes before the daemon starts, so that
# they would strike too early.
TIMED = (CAN, SERIAL)

# What a bad or silent wire may be called: no feedback, the drive's fault or lost enable by its watchdog, a late
# loop, not enabled, still powered or unknown after the stop, heartbeat lost, late feedback, SYNC lost, line lost
_FEEDBACK = ("FH-103",)
_WATCHDOG = ("FH-105", "FH-106")
_SILENCE = (*_FEEDBACK, *_WATCHDOG, "FH-101", "FH-114", "FH-116", "FH-120", "FH-230", "FH-235", "FH-248", "FH-252")
# A drive that misses the daemon's heartbeat leaves Operational (1029h); the emergency that says so may be lost too.
_LOST = (*_SILENCE, "FH-232")
_LATE = ("FH-113", *_FEEDBACK, *_WATCHDOG, "FH-235", "FH-248")
_JUMPS = ("FH-104", "FH-107", "FH-108", "FH-109", "FH-119")


def _nothing(_: Attempt) -> None:
    pass


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes
    ----------
    name, text : str
    arenas : tuple of str
        Where it is possible.
    begin, step, end : callable
        Called when it strikes, then at each look at the wire as long as it lasts, and when it is over.
    last_s : tuple of float or None
        Shortest and longest duration; None: it happens once.
    codes : tuple of str
        Codes that name its cause, of the first fault of the run.
    words : str
        Expression that names it in warnings and notices where it is no fault; empty: nothing has to be said.
    must_end : bool
        True if a run that it strikes in motion has to end with a fault.
    killed : str
        Who does not survive it: ``daemon``, ``drives`` or nobody.
    events : callable or None
        Returns the events of the simulated drive that make it, for the moment in s from the first SYNC.
    prepare, release : callable
        Called before the daemon starts, and when all is over.
    is_from_start : bool
        True if it is there from the beginning.
    loses_frames : bool
        True if commands and feedback are lost, so that an axis may become too fast before anything else is noticed.
    """

    name: str
    text: str
    arenas: tuple[str, ...]
    begin: Callable[[Attempt], None] = _nothing
    step: Callable[[Attempt], None] = _nothing
    end: Callable[[Attempt], None] = _nothing
    last_s: tuple[float, float] | None = None
    codes: tuple[str, ...] = ()
    words: str = ""
    must_end: bool = False
    killed: str = ""
    events: Callable[[Attempt], list[dict[str, Any]]] | None = field(default=None)
    prepare: Callable[[Attempt], None] = _nothing
    release: Callable[[Attempt], None] = _nothing
    is_from_start: bool = False
    loses_frames: bool = False


def _wire(name: str, text: str, kind: str, share: float | None, codes: tuple[str, ...], **more: Any) -> Fault:
    return Fault(
        name,
        text,
        more.pop("arenas", ALL),
        on_wire.disturb(kind, share),
        end=on_wire.undisturb,
        last_s=(0.3, 1.0),
        codes=codes,
        **more,
    )


FAULTS = (
    _wire("lost-1", "1 % of the frames lost", "lost", 0.01, _LOST, loses_frames=True),
    _wire("lost-10", "10 % of the frames lost", "lost", 0.1, _LOST, loses_frames=True),
    _wire("lost-50", "half of the frames lost", "lost", 0.5, _LOST, loses_frames=True),
    _wire("late", "frames late by 0.3 to 3 periods", "late", None, (*_SILENCE, *_JUMPS)),
    _wire("duplicated", "frames twice, the other at once or later", "duplicated", None, (*_SILENCE, *_JUMPS, "FH-264")),
    _wire("reordered", "frames overtaken by later ones", "reordered", None, (*_SILENCE, *_JUMPS)),
    _wire("short", "frames cut short", "short", None, (*_SILENCE, "FH-236")),
    _wire("long", "frames with more bytes than they should have", "long", None, (*_SILENCE, "FH-236")),
    Fault(
        "foreign",
        "frames and bytes that belong to nobody",
        ALL,
        step=on_wire.foreign,
        last_s=(0.3, 1.0),
        codes=_SILENCE,
    ),
    Fault(
        "second-master",
        "another master sends commands to the drive",
        ALL,
        step=on_wire.second_master,
        last_s=(0.1, 0.5),
        codes=("FH-220", *_SILENCE, "FH-231", "FH-232", "FH-233", "FH-249"),
    ),
    Fault(
        "second-sync",
        "a second SYNC on the bus",
        ON_BUS,
        step=on_wire.second_sync,
        last_s=(0.3, 0.6),
        codes=("FH-220", "FH-248"),
        must_end=True,
    ),
    Fault(
        "reboot",
        "the drive loses its supply and boots",
        ON_CAN,
        codes=("FH-231", "FH-230", "FH-232", *_SILENCE),
        must_end=True,
        events=on_wire.event("reboot", for_s=(0.0, 0.3)),
    ),
    Fault(
        "emergency",
        "EMCY of each class, without a fault",
        ON_CAN,
        words="emergency|EMCY|error",
        events=on_wire.emergency,
    ),
    Fault(
        "drive-fault",
        "a fault of each class of EMCY in the drive",
        ON_CAN,
        codes=("FH-105", "FH-106"),
        must_end=True,
        events=on_wire.drive_fault,
    ),
    Fault(
        "silence",
        "drive mute, deaf or unplugged",
        ON_CAN,
        codes=_SILENCE,
        must_end=True,
        events=on_wire.silence,
    ),
    Fault(
        "cut",
        "line cut in both directions",
        (SERIAL,),
        on_wire.cut,
        end=on_wire.undisturb,
        last_s=(0.5, 1.0),
        codes=_SILENCE,
    ),
    Fault(
        "babbling",
        "a node or line that never stops sending",
        ALL,
        step=on_wire.babble,
        last_s=(0.3, 0.6),
        codes=(*_SILENCE, "FH-220"),
        loses_frames=True,
    ),
    Fault(
        "frozen-encoder",
        "the position stays, the axis moves",
        TIMED,
        on_wire.freeze,
        end=on_wire.thaw,
        last_s=(0.5, 1.0),
        codes=(*_JUMPS, "FH-124", "FH-125"),
        events=on_wire.event("freeze_encoder", for_s=(0.5, 1.0)),
    ),
    Fault(
        "jumping-encoder",
        "the position jumps",
        TIMED,
        on_wire.jump,
        codes=(*_JUMPS, *_FEEDBACK, "FH-123", "FH-124", "FH-125"),
        must_end=True,
        events=on_wire.jump_event,
    ),
    Fault("wrap", "the position passes 2^31 counts", (CAN, SERIAL), is_from_start=True),
    Fault(
        "mode-changed",
        "somebody changes the mode of the drive",
        (CAN, SIDECAR),
        on_wire.change_mode,
        codes=("FH-233", *_JUMPS, *_WATCHDOG),
    ),
    Fault("state-changed", "somebody takes the power of the drive", ALL, on_wire.change_state, codes=_WATCHDOG),
    Fault("stop-2", "daemon stopped for 2 ms", ALL, attacks.pause("daemon", 0.002), codes=_LATE),
    Fault("stop-5", "daemon stopped for 5 ms", ALL, attacks.pause("daemon", 0.005), codes=_LATE),
    Fault("stop-50", "daemon stopped for 50 ms", ALL, attacks.pause("daemon", 0.05), codes=_LATE),
    Fault("stop-500", "daemon stopped for 500 ms", ALL, attacks.pause("daemon", 0.5), codes=_LATE, must_end=True),
    Fault(
        "drive-stop-5",
        "drive process stopped for 5 ms",
        ALL,
        attacks.pause("drives", 0.005),
        codes=(*_SILENCE, *_JUMPS),
    ),
    Fault(
        "drive-stop-50",
        "drive process stopped for 50 ms",
        ALL,
        attacks.pause("drives", 0.05),
        codes=(*_SILENCE, *_JUMPS),
    ),
    Fault(
        "drive-stop-500",
        "drive process stopped for 500 ms",
        ALL,
        attacks.pause("drives", 0.5),
        codes=(*_SILENCE, *_JUMPS),
        must_end=True,
    ),
    Fault("kill-daemon", "SIGKILL of the daemon", ALL, attacks.kill("daemon"), killed="daemon"),
    Fault("kill-worker", "SIGKILL of the process that records", ALL, attacks.kill("worker"), words="recording:"),
    Fault("kill-supervisor", "SIGKILL of its supervisor", ALL, attacks.kill("supervisor"), words="supervisor died"),
    Fault("kill-companion", "SIGKILL of both", ALL, attacks.kill("supervisor", "worker"), words="recording:"),
    Fault("kill-server", "SIGKILL of the control socket's process", ALL, attacks.kill("server"), words="control"),
    Fault("kill-spawner", "SIGKILL of all of them", ALL, attacks.kill("supervisor", "worker", "server"), words="died"),
    Fault(
        "kill-drive",
        "SIGKILL of the simulated drive",
        ALL,
        attacks.kill("drives"),
        codes=_SILENCE,
        must_end=True,
        killed="drives",
    ),
    Fault(
        "disk-full",
        "no room for the recording",
        ALL,
        attacks.fill_disk,
        end=attacks.empty_disk,
        last_s=(0.3, 2.0),
        words="recording:",
        prepare=attacks.prepare_disk,
        release=attacks.release_disk,
    ),
    Fault("clock-step", "wall clock stepped by up to a year", ALL, attacks.step_clock, prepare=attacks.prepare_clock),
    Fault(
        "memory-pressure",
        "a process dirties memory",
        ALL,
        attacks.press_memory,
        end=attacks.release_memory,
        last_s=(0.5, 1.0),
    ),
    Fault(
        "no-memory",
        "no more memory granted to the daemon or to the process that records",
        ALL,
        attacks.refuse_memory,
        codes=("FH-127",),
        words="memory",
    ),
    Fault(
        "garbage-journal",
        "random bytes in what the loop reads of the journal",
        ALL,
        step=attacks.scribble,
        last_s=(0.2, 0.5),
        words="journal|message|change",
    ),
    Fault(
        "garbage-socket", "random bytes in the control socket", ALL, attacks.shout, end=attacks.hush, last_s=(0.2, 0.5)
    ),
)
BY_NAME = {fault.name: fault for fault in FAULTS}
