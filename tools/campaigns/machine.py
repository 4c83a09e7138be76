"""Configurations of a try: one axis on CAN, beside a master or on a serial line; for the daemon and for the drive."""

import math
import random
import secrets
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil.checked_yaml.text import dump
from tools.campaigns.can_wire import Bus
from tools.campaigns.witness import Limits

CAN, SIDECAR, SERIAL = "CAN", "sidecar", "serial"
MODES = ("csp", "csv", "cst")
NODE = 1
RATED_TORQUE = 0.64  # N m
COUNTS = 1 << 20  # per revolution
MAX_MISSED = 20
TORQUE, TORQUE_SLEW = 0.2, 10.0  # N m, N m/s: both are reached at a reversal
GAIN = 0.9
SPEED = 12.0  # rad/s
# rad/s^2, of the set-points: (2 pi 1.6 Hz)^2 times 0.4 rad by the sine, as much by its ramp, and twice for what the
# position controller of csv adds to it
ACCELERATION = 160.0
PERIODS_S = {CAN: 5e-3, SIDECAR: 5e-3, SERIAL: 1e-2}
WATCHDOG_S = 0.2  # of the serial drive
OFFSET_ID, FEEDBACK_ID, MODE_ID, TARGET_ID = 0x501, 0x181, 0x281, 0x201
MAPPED = {
    FEEDBACK_ID: [0x60410010, 0x60640020, 0x60770010],
    MODE_ID: [0x60610008],
    TARGET_ID: [0x60400010, 0x607A0020],
    OFFSET_ID: [0x60B20010],
}
_CONTROLLER = {"position_gain": 6.0, "velocity_gain": 6e-3, "integral_hz": 0.5}  # what a period of 5 to 10 ms permits
_FRICTION = {
    "sigma0": 2300.0,
    "sigma1": 0.85,
    "sigma2": 2.3e-3,
    "coulomb": 0.068,
    "static": 0.138,
    "stribeck_velocity": 0.17,
    "damping_velocity": 0.23,
}


@dataclass(frozen=True, slots=True)
class Machine:
    """Files and addresses of a try."""

    arena: str
    mode: str
    period_s: float
    limits: Limits
    daemon: Path
    drives: Path
    daemon_bus: Bus
    drive_bus: Bus
    daemon_line: Path
    drive_line: Path
    recording: Path


def make_machine(folder: Path, arena: str, mode: str, events: list[dict[str, Any]], phase: random.Random) -> Machine:
    """Write the two configurations of a try; the motion begins at a random phase of the reversal."""
    period_s = PERIODS_S[arena]
    name = f"campaign-{secrets.token_hex(4)}"
    daemon_bus, drive_bus = (Bus(f"239.74.163.{2 + secrets.randbelow(253)}", _free_port()) for _ in range(2))
    daemon_line, drive_line = folder / "line", folder / "drive-line"
    paths = []
    for part, bus, line in (("", daemon_bus, daemon_line), ("-drives", drive_bus, drive_line)):
        data: dict[str, Any] = {
            "version": 1,
            "period_s": period_s,
            "axes": {"x": _axis(arena, mode, events, line, phase)},
            "realtime": {"max_missed": MAX_MISSED},
        }
        if arena != SERIAL:
            data["bus"] = bus.keys | ({"role": "sidecar"} if arena == SIDECAR else {})
        path = folder / f"{name}{part}.yaml"
        path.write_text(dump(data))
        paths.append(path)
    return Machine(
        arena,
        mode,
        period_s,
        _limits(arena, mode, period_s),
        paths[0],
        paths[1],
        daemon_bus,
        drive_bus,
        daemon_line,
        drive_line,
        folder / "disk" / "run.mcap",
    )


def _limits(arena: str, mode: str, period_s: float) -> Limits:
    counts = COUNTS / math.tau
    # Beside another master, demand and position come over a bus whose frames bunch: where they contradict each other,
    # the compensation falls back to the static level for a period. In cst the torque moves the axis as well.
    is_known = arena != SIDECAR and mode != "cst"
    return Limits(
        1e3 * TORQUE / RATED_TORQUE,
        1e3 * TORQUE_SLEW * period_s / RATED_TORQUE,
        period_s,
        SPEED * counts,
        ACCELERATION * counts,
        1e3 * GAIN * _FRICTION["coulomb"] / RATED_TORQUE if is_known else math.inf,
    )


def _axis(arena: str, mode: str, events: list[dict[str, Any]], line: Path, random_: random.Random) -> dict[str, Any]:
    state = random_.getstate()  # both files say the same
    path = {"kind": "sine", "amplitude": 0.4, "frequency": round(random_.uniform(0.8, 1.6), 3)}
    random_.setstate(state)
    axis: dict[str, Any] = {
        "mode": mode,
        "rated_torque": RATED_TORQUE,
        "counts_per_unit": COUNTS / math.tau,
        "limits": {"torque": TORQUE, "torque_slew": TORQUE_SLEW, "velocity": SPEED, "following_error": 1.0},
        "model": {
            "axis": "rotary",
            "friction": {"model": "lugre", "parameters": dict(_FRICTION)},
            "mechanics": {"inertia": 1.7e-4, "torque_lag_s": 3.45e-4},
        },
        "compensation": {"gain": GAIN, "fade_s": 0.1},
        "trajectory": {**path, "ramp_s": 0.15},
    }
    simulation: dict[str, Any] = {"encoder": {"counts": COUNTS}, "motor": {"rated_torque": RATED_TORQUE}}
    if mode == "cst":
        axis["controller"] = _CONTROLLER
    if arena == SERIAL:
        axis |= {
            "driver": "modbus",
            "unit": 3,
            "description": "generic_cia402",
            "line": {"port": str(line), "baud": 921600},
            "watchdog_s": WATCHDOG_S,
        }
    else:
        axis |= {"driver": "canopen", "node": NODE}
        simulation["canopen"] = {"events": events}
    if arena == SIDECAR:
        axis["trajectory"] = {"kind": "master"}
        simulation["trajectory"] = path
        axis["sidecar"] = {
            "tpdos": [{"cob_id": each, "entries": MAPPED[each]} for each in (FEEDBACK_ID, MODE_ID)],
            "rpdos": [{"cob_id": TARGET_ID, "entries": MAPPED[TARGET_ID]}],
            "offset": {"cob_id": OFFSET_ID, "entries": MAPPED[OFFSET_ID]},
        }
    return axis | {"simulation": simulation}


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port
