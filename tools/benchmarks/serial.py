"""Drives on serial lines: cycle rate compared with the limit of the wire, processor time, and a circle at 250 Hz.

The driver runs against simulated drives in another process, over a pseudo-terminal on which every character takes its
time. The limit of the wire is the time of request, silence, reply and silence; the cycle also includes the wake-up
times of the two processes. Finally the daemon runs the circle of the demo over a line at 250 Hz.
"""

import itertools
import json
import math
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from friction_hil_drivers.serial_line.drives import SerialDrives
from friction_hil_drivers.serial_line.protocol import Exchange

from friction_hil import config
from friction_hil.checked_yaml.text import dump
from friction_hil.config import Configuration
from friction_hil.config.drivers import load_driver
from friction_hil.daemon.realtime import RealClock, punctuality
from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.drive.finding import complaints
from friction_hil.errors import FrictionHilError
from friction_hil.servo.config import TrueFriction
from tools.benchmarks.processes import PROGRAM, simulated
from tools.benchmarks.report import Row, against, note

CYCLES = 2000
PRIORITY = 70
ENABLE_CYCLES = 200
LEAST_SHARE = 0.85
MODBUS_CPU_US, ASCII_CPU_US = 400.0, 150.0
LEAST_REDUCTION = 2.0
CIRCLE_S = 12.0
_ENABLE = [Command(Request.ENABLE)]
_MOVE = [Command(Request.ENABLE, torque=0.11)]  # above the friction: the replies change
_COUNTS = 2**20 / 6.283185307179586
MODBUS = {"driver": "modbus", "description": "generic_cia402", "counts_per_unit": _COUNTS, "rated_torque": 0.64}
ODRIVE = {"driver": "ascii", "description": "odrive", "torque_constant": 0.1}


def run() -> list[Row]:
    """Measure each line for a few seconds, then two circles.

    Raises
    ------
    FrictionHilError
        A drive was not enabled, or the daemon ended with a fault.
    """
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for label, drive, baud, period_s, target_us in (
            ("Modbus RTU, 115200 baud", MODBUS, 115200, 8e-3, MODBUS_CPU_US),
            ("Modbus RTU, 1 Mbaud", MODBUS, 1_000_000, 1e-3, MODBUS_CPU_US),
            ("ODrive, 921600 baud", ODRIVE, 921600, 2e-3, ASCII_CPU_US),
        ):
            note(label)
            rows += _rates(label, _configuration(folder, drive, baud, period_s), target_us)
        rows.append(_circle(folder))
    return rows


def _configuration(folder: Path, drive: dict[str, Any], baud: int, period_s: float, **changes: Any) -> Path:
    """Write the configuration of one axis; return its path."""
    friction = TrueFriction()  # of the simulated drive
    axis = {
        **drive,
        "line": {"port": str(folder / "line"), "baud": baud},
        "mode": "cst",
        "limits": {"torque": 0.6, "velocity": 30.0, "following_error": 2.0},
        "model": {
            "axis": "rotary",
            "friction": {"model": friction.model, "parameters": friction.parameters},
            "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4},
        },
        "controller": {"position_gain": 15.0, "velocity_gain": 0.03, "integral_hz": 1.0},
        "trajectory": {"kind": "circle", "radius": 1.0, "frequency": 0.5},
        "simulation": {},
        **changes,
    }
    if drive is MODBUS:
        axis["unit"] = 1
    path = folder / "axis.yaml"
    path.write_text(dump({"version": 1, "period_s": period_s, "axes": {"x": axis}}))
    return path


def _rates(label: str, path: Path, target_us: float) -> list[Row]:
    """Measure cycles back to back, then at the period of the configuration."""
    configuration = config.load(path)
    with simulated(path), punctuality(PRIORITY) as findings:
        for line in complaints(findings):
            note(line)
        drives = _enabled(configuration)
        try:
            limit = 1.0 / _wire_s(drives)
            took_s, busy_s = _back_to_back(drives)
            fresh, used_s, warming_s = paced(drives, configuration.period_s)
        finally:
            drives.close()
    rate, period_hz = CYCLES / took_s, 1.0 / configuration.period_s
    return [
        Row(
            f"{label}: cycles a second, back to back (limit of the wire with the longest messages)",
            rate,
            "Hz",
            limit,
            rate / limit,
        ),
        against(target_us, f"{label}: processor time of a cycle, back to back (target)", "us", busy_s * 1e6),
        Row(f"{label}: cycles in time at {period_hz:.0f} Hz", 100.0 * fresh, "%"),
        against(target_us, f"{label}: processor time of a cycle at {period_hz:.0f} Hz (target)", "us", used_s * 1e6),
        Row(f"{label}: processor time of warming the caches, in the spin before the cycle", warming_s * 1e6, "us"),
    ]


def _enabled(configuration: Configuration) -> SerialDrives:
    (axis,) = configuration.axes.values()
    drives = load_driver(axis.driver)(configuration, configuration.axes, RealClock(), dry_run=False)
    assert isinstance(drives, SerialDrives)
    drives.connect()
    drives.start()
    feedback = Feedback()
    for _ in range(ENABLE_CYCLES):
        _cycle(drives, feedback, _ENABLE)
        if feedback.state is DriveState.OPERATION_ENABLED:
            return drives
    drives.close()
    raise FrictionHilError(f"the simulated drive was not enabled: {feedback}")


def _cycle(
    drives: SerialDrives, feedback: Feedback, commands: list[Command] = _MOVE, timeout_ns: int = 100_000_000
) -> None:
    drives.receive([feedback], time.monotonic_ns() + timeout_ns)
    drives.send(commands)


def _wire_s(drives: SerialDrives) -> float:
    """Return the mean time of a cycle on the wire, s: commands, feedback, and one background read after the other."""
    (bus,) = drives.buses
    background: list[tuple[Exchange, ...]] = [(each,) for each in bus.plan.background] or [()]
    cycles = [bus.wire_s(*bus.plan.push, *each, *bus.plan.poll) for each in background]
    return sum(cycles) / len(cycles)


def _back_to_back(drives: SerialDrives) -> tuple[float, float]:
    """Return the time of all cycles, one after the other, and the median processor time of one, s."""
    feedback, marks = Feedback(), [time.process_time()]
    began = time.perf_counter()
    for _ in range(CYCLES):
        _cycle(drives, feedback)
        marks.append(time.process_time())
    took_s = time.perf_counter() - began
    return took_s, statistics.median(after - before for before, after in itertools.pairwise(marks))


def paced(drives: SerialDrives, period_s: float) -> tuple[float, float, float]:
    """Run cycles that begin at their deadlines.

    Returns
    -------
    fraction : float
        Fraction of the cycles with fresh feedback before the next deadline.
    used_s : float
        Median processor time of a cycle, s, in user and system mode: receiving and sending, with the wake-ups for
        replies, without the loop's sleep and spin before the deadline. The median, because pauses of a virtual machine
        distort the mean.
    warming_s : float
        Median processor time of `warm_caches` during that spin, s; NaN if no cycle left time for one.
    """
    feedback, fresh, period_ns = Feedback(), 0, round(period_s * 1e9)
    used_s: list[float] = []
    warming_s: list[float] = []
    clock = RealClock()
    deadline_ns = clock.now_ns() + period_ns
    for _ in range(CYCLES):
        if clock.doze_until(deadline_ns):
            began = time.process_time()
            drives.warm_caches()
            warming_s.append(time.process_time() - began)
        clock.sleep_until(deadline_ns)
        began = time.process_time()
        _cycle(drives, feedback, _MOVE, deadline_ns + period_ns - clock.now_ns())
        used_s.append(time.process_time() - began)
        fresh += feedback.is_fresh
        deadline_ns += period_ns
    if not warming_s:
        note(f"at a period of {period_s * 1e3:g} ms no cycle left time to warm the caches: its time is unknown")
    return fresh / CYCLES, statistics.median(used_s), statistics.median(warming_s or [math.nan])


def _circle(folder: Path) -> Row:
    """Measure the reduction of the following error of the demo's motion over a line at 250 Hz."""
    errors = []
    for is_compensated in (False, True):
        path = _configuration(folder, ODRIVE, 921600, 4e-3, compensation={"enabled": is_compensated})
        note(f"a circle at 250 Hz, {'with' if is_compensated else 'without'} compensation")
        with simulated(path):
            words = [*PROGRAM, "run", str(path), "--duration", f"{CIRCLE_S:g}", "--json"]
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            raise FrictionHilError(done.stderr.strip())
        errors.append(json.loads(done.stdout)["axes"]["x"]["rms"])
    reduction = errors[0] / errors[1]
    return Row(
        "circle at 250 Hz: RMS following error without over with compensation (target)",
        reduction,
        "",
        LEAST_REDUCTION,
        reduction / LEAST_REDUCTION,
    )
