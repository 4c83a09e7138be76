"""Serial drives as real processes: configurations, lines that can be cut, and programs from other hands."""

import contextlib
import shutil
import socket
import subprocess
import time
from pathlib import Path

import pytest
import yaml

from tests.servo_drives import axis_dict

COUNTS_PER_REVOLUTION = 1 << 20
COUNTS = COUNTS_PER_REVOLUTION / 6.283185307179586  # per rad
RATED_TORQUE = 0.64  # N m
TORQUE_CONSTANT = 0.1  # N m/A
LONG_S = 20.0  # for what is certain to happen, on however slow a machine
BY_REGISTERS = {
    "driver": "modbus",
    "unit": 3,
    "description": "generic_cia402",
    "counts_per_unit": COUNTS,
    "rated_torque": RATED_TORQUE,
}
DRIVES = {
    "modbus rtu": BY_REGISTERS,
    "modbus tcp": BY_REGISTERS,
    "odrive": {"driver": "ascii", "description": "odrive", "torque_constant": TORQUE_CONSTANT},
}


def program(name: str) -> str:
    """Path of a program from another package; the test is skipped where there is none."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def free_tcp_port() -> int:
    """Port number on the loopback that nobody has just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def line_of(kind: str, folder: Path) -> dict[str, object]:
    """Line of a configuration: a pseudo-terminal in ``folder``, or a TCP connection."""
    if kind.endswith("tcp"):
        return {"port": f"tcp://127.0.0.1:{free_tcp_port()}"}
    return {"port": str(folder / "line"), "baud": 921600}


def write_serial_configuration(
    folder: Path, kind: str, *, period_s: float = 4e-3, name: str = "axes", line=None, realtime=None, **changes
) -> Path:
    """Configuration of one axis on a serial line; ``changes`` are keys of the axis, None for one that it has not."""
    axis = axis_dict(**{**DRIVES[kind], "node": None, "simulation": {}, **changes})
    axis = {key: value for key, value in axis.items() if value is not None}
    axis["line"] = {**line_of(kind, folder), **(line or {})}
    data = {
        "version": 1,
        "period_s": period_s,
        "axes": {"x": axis},
        "realtime": {"priority": 0, **(realtime or {})},
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@contextlib.contextmanager
def process(*words, **options):
    """Run a program beside the test; it is ended with the test, by its own number."""
    running = subprocess.Popen([str(word) for word in words], stdin=subprocess.DEVNULL, **options)
    try:
        yield running
    finally:
        running.kill()
        running.wait(LONG_S)


@contextlib.contextmanager
def socat_pair(folder: Path, here: str, there: str):
    """Two pseudo-terminals joined by socat, at these names in ``folder``."""
    ends = folder / here, folder / there
    with process(program("socat"), *(f"pty,raw,echo=0,link={end}" for end in ends)):
        wait_until(lambda: all(end.exists() for end in ends), "socat's pseudo-terminals")
        yield tuple(map(str, ends))


def wait_until(is_true, what: str, timeout_s: float = LONG_S) -> None:
    """Wait for something that other processes do."""
    end = time.monotonic() + timeout_s
    while not is_true():
        assert time.monotonic() < end, f"waited {timeout_s:g} s for {what}"
        time.sleep(0.01)
