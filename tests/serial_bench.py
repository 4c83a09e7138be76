"""Drives on a serial line for tests: two made-up drives, a made-up protocol to reach them, and a master."""

import math
import os
import select
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from friction_hil_drivers.serial_line.description import Description, Signal
from friction_hil_drivers.serial_line.simulated import SimulatedDrive
from friction_hil_drivers.serial_line.units import AxisUnits

from friction_hil.drive import Mode
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo

FRICTION, RATED = 0.01, 0.64
COUNTS = 4096.0 / (2.0 * math.pi)  # per rad
STEPS_PER_MS = 80
PLAIN: dict[str, Any] = {
    "friction": {"model": "coulomb", "parameters": {"coulomb": FRICTION}},
    "encoder": {"counts": 4096},
}
LONG_S = 10.0  # for what is certain to happen, on however slow a machine


class TinyDescription(Description):
    signals: dict[str, Signal]

    def units(self) -> dict[str, Signal]:
        return self.signals


CIA402: dict[str, Any] = {
    "version": 1,
    "name": "tiny 402",
    "sources": ["made up"],
    "state_machine": "cia402",
    "signals": {
        "position": {"unit": "count"},
        "velocity": {"unit": "count/s"},
        "torque": {"unit": "per_mille"},
        "status": {},
        "control": {},
        "error": {},
        "mode": {},
        "lifetime": {"unit": "s", "scale": 1e-3},
        "lifetime_on": {},
        "position_command": {"unit": "count"},
        "velocity_command": {"unit": "count/s"},
        "torque_command": {"unit": "per_mille"},
    },
    "modes": {
        "csp": {"commands": ["position_command", "torque_command"], "prepare": [{"write": {"mode": 8}}]},
        "csv": {"commands": ["velocity_command", "torque_command"], "prepare": [{"write": {"mode": 9}}]},
        "cst": {"commands": ["torque_command"], "prepare": [{"write": {"mode": 10}}]},
    },
    "watchdog": {"signal": "lifetime", "enable": [{"write": {"lifetime_on": 1}}]},
    "errors": {7: "overheated", 42: "communication lost"},
}
OWN: dict[str, Any] = {
    "version": 1,
    "name": "tiny own",
    "sources": ["made up"],
    "signals": {
        "position": {"unit": "turn"},
        "velocity": {"unit": "turn/s"},
        "status": {},
        "error": {},
        "request": {},
        "key": {},
        "lifetime": {"unit": "s"},
        "torque_command": {"unit": "N m"},
    },
    "states": [
        {"state": "fault", "signal": "error", "value_not": 0},
        {"state": "operation_enabled", "mask": 0x0C, "value": 0x0C},
        {"state": "switched_on", "mask": 0x0C, "value": 0x08},
        {"state": "quick_stop_active", "mask": 0x03, "value": 0x02},
        {"state": "switch_on_disabled", "mask": 0x01, "value": 0x01},
    ],
    "modes": {"cst": {"commands": ["torque_command"]}},
    "enable": [{"write": {"request": 2}, "until": "switched_on"}, {"write": {"request": 3, "key": 1}}],
    "disable": [{"write": {"request": 1}, "until": "switch_on_disabled"}],
    "quick_stop": [{"write": {"request": 5}}],
    "reset_fault": [{"write": {"request": 9}}, {"write": {"request": 0}, "until": "switch_on_disabled"}],
    "watchdog": {"signal": "lifetime"},
    "errors": {4: "watchdog expired"},
}


def make_drive(
    description: Mapping[str, Any] = CIA402, mode: Mode = Mode.CST, *, is_synchronous: bool = True, **units: float
) -> SimulatedDrive:
    """One drive on its own; with ``is_synchronous`` a sample is one millisecond."""
    return SimulatedDrive(
        "x",
        TinyDescription.model_validate(description),
        Servo(ServoConfig.model_validate(PLAIN)),
        mode,
        AxisUnits(**units),
        STEPS_PER_MS if is_synchronous else None,
    )


class TinyResponder:
    """The drive's end of a made-up protocol: ``?NAME`` is answered by its number, ``NAME=NUMBER`` by nothing."""

    request_end = b""

    def __init__(self, drive: SimulatedDrive) -> None:
        self._drive = drive
        self.silences = 0

    def take(self, received: bytearray) -> bytes | None:
        end = received.find(b"\n")
        if end < 0:
            return None
        line = received[:end].decode()
        del received[: end + 1]
        if line.startswith("?"):
            if line == "?position":
                self._drive.sample()
            return f"{self._drive.read(line[1:]):.17g}\n".encode()
        name, _, number = line.partition("=")
        self._drive.write(name, float(number))
        return b""

    def forget(self) -> None:
        self.silences += 1


class Master:
    """Master on a pseudo-terminal."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)

    def send(self, data: bytes) -> None:
        os.write(self._descriptor, data)

    def receive(self, count: int, timeout_s: float = LONG_S) -> bytes:
        """Read so many bytes, fewer when they do not come."""
        found = b""
        while len(found) < count and select.select([self._descriptor], [], [], timeout_s)[0]:
            found += os.read(self._descriptor, count - len(found))
        return found

    def line(self) -> bytes:
        """Read one line."""
        found = b""
        while not found.endswith(b"\n") and (byte := self.receive(1)):
            found += byte
        return found

    def close(self) -> None:
        os.close(self._descriptor)
