"""A driver for serial lines with its simulated drive, connected by a pseudo-terminal or a TCP connection."""

import threading
import time

from friction_hil_drivers.ascii.driver import AsciiDrives
from friction_hil_drivers.ascii.simulated import SimulatedAsciiDrives
from friction_hil_drivers.dynamixel.driver import DynamixelDrives
from friction_hil_drivers.dynamixel.simulated import SimulatedDynamixelDrives
from friction_hil_drivers.modbus.driver import ModbusDrives
from friction_hil_drivers.modbus.simulated import SimulatedModbusDrives

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Command, DriveState, Feedback, Request
from tests.peers.serial_processes import free_tcp_port
from tests.servo_drives import axis_dict, configuration

COUNTS = 2**20 / 6.283185307179586
CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}
PROTOCOLS = {
    "modbus": (ModbusDrives, SimulatedModbusDrives),
    "ascii": (AsciiDrives, SimulatedAsciiDrives),
    "dynamixel": (DynamixelDrives, SimulatedDynamixelDrives),
}
BY_REGISTERS = {"driver": "modbus", "unit": 3, "counts_per_unit": COUNTS, "rated_torque": 0.64}
KINDS = {
    "rtu": {**BY_REGISTERS, "description": "kinco_fd5p", "torque_constant": 0.1},
    "rtu, function 23": {**BY_REGISTERS, "description": "generic_cia402"},
    "tcp": {**BY_REGISTERS, "description": "generic_cia402"},
    "dynamixel": {"driver": "dynamixel", "description": "xl330", "id": 1, "torque_constant": 0.2},
    "odrive": {"driver": "ascii", "description": "odrive", "torque_constant": 0.1},
}
FAST_LINE = {"baud": 4_000_000, "reply_limit_s": 0.05}


def port_of(kind, tmp_path):
    if kind != "tcp":
        return str(tmp_path / "line")
    return f"tcp://127.0.0.1:{free_tcp_port()}"


class Bench:
    """An axis in CST with its simulated drive."""

    def __init__(self, kind, tmp_path, *, dry_run=False, faults=None, **changes):
        given = {
            **KINDS[kind],
            "line": {"port": port_of(kind, tmp_path), **FAST_LINE},
            "is_watchdog_required": False,
            "simulation": {"line": faults or {}},
            **changes,
        }
        self._set_up(given["driver"], {"x": given}, dry_run=dry_run)
        self.feedback, self.command = Feedback(), Command()

    def _set_up(self, driver, axes, *, dry_run=False):
        base = axis_dict(mode="cst", controller=CONTROLLER)
        del base["node"]
        self.config = configuration(**{name: {**base, **given} for name, given in axes.items()})
        self.clock = SteppedClock()
        self.driver, simulated = PROTOCOLS[driver]
        self.simulated = simulated(self.config, self.config.axes, pace="sync")
        self.simulated.open()
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(target=self.simulated.run, args=(self._is_stopping.is_set,))
        self._thread.start()
        self.drives = self.daemon(dry_run=dry_run)

    def daemon(self, *, dry_run=False):
        return self.driver(self.config, self.config.axes, self.clock, dry_run=dry_run)

    def begin(self):
        (self.facts,) = self.drives.connect()
        self.drives.start()
        return self

    def cycle(self, request, torque=0.0, count=1):
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            end_ns = time.monotonic_ns() + 100_000_000 if self.clock.is_real else self.clock.now_ns() + 1_000_000
            self.drives.receive([self.feedback], end_ns)
            self.command.request, self.command.torque = request, torque
            self.drives.send([self.command])

    def enable(self):
        for _ in range(60):
            self.cycle(Request.ENABLE)
            if self.feedback.state is DriveState.OPERATION_ENABLED:
                return self
        raise AssertionError(self.feedback)

    def unplug(self):
        self._is_stopping.set()
        self._thread.join()
        self.simulated.close()

    def close(self):
        self.drives.close()
        self.unplug()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
