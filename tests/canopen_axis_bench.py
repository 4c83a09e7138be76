"""One CANopen axis in the cyclic phase on the bench: it is fed with frames, and its commands are bytes."""

import struct

from friction_hil_drivers.canopen.connect.configure import ConfiguredDrive
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
from friction_hil_drivers.cia402.codec import COMMANDS, FEEDBACK
from friction_hil_drivers.cia402.units import DriveUnits

from friction_hil.drive import AxisFacts, Command, Feedback, Mode

NODE = 5
TPDO1, TPDO2, RPDO1, EMCY, HEARTBEAT = 0x185, 0x285, 0x205, 0x085, 0x705
UNITS = DriveUnits(1000.0, 500.0, 0.64)
LAYOUTS = {Mode.CSP: "<Hih", Mode.CSV: "<Hih", Mode.CST: "<Hh"}
MS = 1_000_000
BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = b"\x00", b"\x04", b"\x05", b"\x7f"


class Bench:
    """The axis, fed with frames in hexadecimal."""

    def __init__(self, mode=Mode.CSP, units=UNITS, *, is_listened_to=False, error="", heartbeat_s=0.1):
        tpdos = (
            MappedPdo(TPDO1, FEEDBACK[0], struct.Struct("<Hih")),
            MappedPdo(TPDO2, FEEDBACK[1], struct.Struct("<ib")),
        )
        rpdos = () if is_listened_to else (MappedPdo(RPDO1, COMMANDS[mode], struct.Struct(LAYOUTS[mode])),)
        facts = AxisFacts("x", "a drive", 1e-3, 6.4e-4, 2.5e-3, 1.5e-3)
        self.axis = CanopenAxis(ConfiguredDrive(facts, units, mode, tpdos, rpdos, error, 1e-3), NODE, heartbeat_s)
        self.axis.start(0)
        self.now_ns = 0

    def cycle(self, *frames, after_ms=1):
        """One period: SYNC, then frames (identifier, data); the feedback."""
        self.now_ns += after_ms * MS
        self.axis.begin_cycle(self.now_ns)
        for can_id, data in frames:
            self.axis.handlers[can_id](bytes.fromhex(data) if isinstance(data, str) else data)
        feedback = Feedback()
        self.axis.report(feedback, self.now_ns)
        return feedback

    def heard(self, state=0x0637, counts=0, torque=0, velocity=0, mode=8, **what):
        """A cycle in which everything arrives."""
        first, second = struct.pack("<Hih", state, counts, torque), struct.pack("<ib", velocity, mode)
        return self.cycle((TPDO1, first), (TPDO2, second), **what)

    def command(self, request, position=0.0, velocity=0.0, torque=0.0):
        [(can_id, data)] = self.axis.encode(Command(request, position, velocity, torque))
        assert can_id == RPDO1
        return data.hex()
