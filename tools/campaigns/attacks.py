"""Faults of the computer: processes stopped or killed, disk, clock, memory, and garbage from other processes."""

import contextlib
import json
import mmap
import os
import resource
import shutil
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from friction_hil.daemon.control.journal import loop_pages
from friction_hil.daemon.control.names import socket_path
from tools.campaigns.attempt import Attempt

_DISK_MB = 48
_JOURNAL = "memfd:friction_hil-journal"
_HEADER_BYTES = 512
_MOST_BYTES = 1 << 30
_SHARE = 0.25  # of the memory that is available
_PRESS = "import sys\nm=bytearray(int(sys.argv[1]))\nwhile 1:\n  for i in range(0,len(m),4096): m[i]=i&255"
_STEPS_S = (-365 * 86400, -3600, -1, 1, 3600, 365 * 86400)


# Processes


def _signal(attempt: Attempt, who: str, number: int) -> None:
    if who in ("daemon", "drives"):
        process = attempt.daemon if who == "daemon" else attempt.drives
        if process.poll() is None:
            process.send_signal(number)
        return
    for child in attempt.children(who):
        child.signal(number)


def pause(who: str, for_s: float) -> Callable[[Attempt], None]:
    """Return what stops a process for a while."""

    def begin(attempt: Attempt) -> None:
        _signal(attempt, who, signal.SIGSTOP)
        attempt.later(for_s, partial(_signal, attempt, who, signal.SIGCONT))

    return begin


def kill(*who: str) -> Callable[[Attempt], None]:
    """Return what kills some processes."""

    def begin(attempt: Attempt) -> None:
        attempt.look_for_children()
        for one in who:
            _signal(attempt, one, signal.SIGKILL)

    return begin


# Disk


def prepare_disk(attempt: Attempt) -> None:
    """Mount a small file system for the recording, where that is allowed."""
    disk = attempt.folder / "disk"
    disk.mkdir(exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", f"size={_DISK_MB}m", "none", str(disk)]
    if os.geteuid() == 0 and shutil.which("mount") and subprocess.run(words, capture_output=True).returncode == 0:
        attempt.kept["mounted"] = disk


def release_disk(attempt: Attempt) -> None:
    """Unmount it again."""
    if disk := attempt.kept.pop("mounted", None):
        subprocess.run(["umount", "-l", str(disk)], capture_output=True)


def fill_disk(attempt: Attempt) -> None:
    """Fill the file system, or forbid the recording process to write further."""
    if "mounted" in attempt.kept:
        attempt.tell("tmpfs full")
        with (attempt.folder / "disk/filler").open("wb") as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(1 << 16))
                file.flush()
        return
    attempt.tell("RLIMIT_FSIZE")
    for child in attempt.children("worker"):
        attempt.kept["limited"] = child.pid
        resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (1, resource.RLIM_INFINITY))


def empty_disk(attempt: Attempt) -> None:
    """Make room again."""
    (attempt.folder / "disk/filler").unlink(missing_ok=True)
    if pid := attempt.kept.get("limited"):
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)


# Clock


def prepare_clock(attempt: Attempt) -> None:
    """Let the daemon run with a wall clock that can be stepped, where there is a C compiler."""
    source, library, step = (
        Path(__file__).with_name("clockshim.c"),
        attempt.folder / "clock.so",
        attempt.folder / "step",
    )
    compiler = shutil.which("gcc") or shutil.which("cc")
    words = [compiler, "-shared", "-fPIC", "-O2", "-o", library, source, "-ldl"]
    if compiler is None or subprocess.run([str(word) for word in words], capture_output=True).returncode != 0:
        attempt.tell("not tried: no C compiler")
        return
    step.write_bytes(bytes(8))
    attempt.environment |= {"LD_PRELOAD": str(library), "CAMPAIGN_CLOCK": str(step)}


def step_clock(attempt: Attempt) -> None:
    """Step the wall clock of the daemon and its companion."""
    seconds = attempt.random.choice(_STEPS_S)
    if attempt.environment:
        attempt.tell(f"{seconds} s")
        with (attempt.folder / "step").open("r+b") as file:
            file.write(struct.pack("=q", seconds))


# Memory


def press_memory(attempt: Attempt) -> None:
    """Start a process that dirties a part of the memory."""
    available = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    size = min(_MOST_BYTES, int(_SHARE * available))
    attempt.tell(f"{size >> 20} MB")
    attempt.kept["pressing"] = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _PRESS, str(size)], stdin=subprocess.DEVNULL
    )


def release_memory(attempt: Attempt) -> None:
    """End it."""
    if process := attempt.kept.pop("pressing", None):
        process.kill()
        process.wait()


def refuse_memory(attempt: Attempt) -> None:
    """Grant the daemon, or the process that records, no more memory than it has."""
    who = attempt.chosen(("daemon", "worker"))
    attempt.tell(who)
    pids = [attempt.daemon.pid] if who == "daemon" else [child.pid for child in attempt.children(who)]
    for pid in pids:
        with contextlib.suppress(OSError, ProcessLookupError):
            size = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * mmap.PAGESIZE
            resource.prlimit(pid, resource.RLIMIT_AS, (size, resource.RLIM_INFINITY))


# Garbage


def scribble(attempt: Attempt) -> None:
    """Write random bytes into those pages of the journal at which the loop looks each cycle."""
    rng = attempt.random
    if "journal" not in attempt.kept:
        folder = Path(f"/proc/{attempt.daemon.pid}/fd")
        found = (path for path in folder.iterdir() if os.readlink(path).lstrip("/").startswith(_JOURNAL))
        attempt.kept["journal"] = path = next(found, None)
        if path is not None:
            path.chmod(0o600)
    path = attempt.kept["journal"]
    if path is None or not attempt.is_time(0.003):
        return
    with contextlib.suppress(OSError), path.open("r+b", buffering=0) as file:
        first, size = loop_pages(file.fileno())
        at = rng.randrange(0, rng.choice((64, _HEADER_BYTES, size)))
        file.seek(first + at)
        file.write(rng.randbytes(min(rng.choice((1, 8, 64, 4096)), size - at)))
        if rng.random() < 0.5:  # an even number in place of the sequence, as after a whole message
            file.seek(first)
            file.write(struct.pack("<q", 2 * rng.randrange(1 << 40)))


def shout(attempt: Attempt) -> None:
    """Open the control socket many times, and send what is no request."""
    rng, sockets = attempt.random, attempt.kept.setdefault("sockets", [])
    path = os.fspath(socket_path(attempt.machine.daemon.stem))
    deep = b"[" * 50_000 + b"\n"
    wrong = json.dumps({"do": "set", "values": {"x.gain": rng.choice(("NaN", -1e308, [], {}, None, 1e400))}}).encode()
    for _ in range(rng.randint(1, 40)):
        one = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sockets.append(one)
        one.setblocking(False)
        with contextlib.suppress(OSError):
            one.connect(path)
            said = (
                rng.randbytes(rng.randrange(1, 70_000)),
                deep,
                wrong + b"\n",
                b"{" * 100,
                b"\n" * 1000,
                b'{"do": 7}\n',
            )
            one.send(rng.choice(said))


def hush(attempt: Attempt) -> None:
    """Close all these connections."""
    for one in attempt.kept.pop("sockets", ()):
        one.close()
