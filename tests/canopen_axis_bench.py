"""One CANopen axis in the cyclic phase on the bench: it is fed with frames, and its commands are bytes."""

import struct

from friction_hil_drivers.canopen.connect.configure import ConfiguredDrive
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
from friction_hil_drivers.cia402.codec import COMMANDS, FEEDBACK
from friction_hil_drivers.cia402.units import DriveUnits

from friction_hil.drive import AxisFacts, Command, Feedback, Mode

NODE = 5
TPDO1, TPDO2, RPDO1, EMCY, HEARTBEAT, SDO_ANSWER = 0x185, 0x285, 0x205, 0x085, 0x705, 0x585
UNITS = DriveUnits(1000.0, 500.0, 0.64)
LAYOUTS = {Mode.CSP: "<Hih", Mode.CSV: "<Hih", Mode.CST: "<Hh"}
MS = 1_000_000
BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = b"\x00", b"\x04", b"\x05", b"\x7f"


def drive_of(mode=Mode.CSP, *, tpdos=None, rpdos=None, ids=(TPDO1, TPDO2, RPDO1), error="", period_s=1e-3, **how):
    """A drive as it is configured, with the PDOs of the driver unless others are given."""
    if tpdos is None:
        layouts = struct.Struct("<Hih"), struct.Struct("<ib")
        tpdos = tuple(map(MappedPdo, ids, FEEDBACK, layouts))
    if rpdos is None:
        rpdos = (MappedPdo(ids[2], COMMANDS[mode], struct.Struct(LAYOUTS[mode])),)
    facts = AxisFacts(how.pop("name", "x"), "a drive", 1e-3, 6.4e-4, 2.5e-3, 1.5e-3)
    return ConfiguredDrive(facts, how.pop("units", UNITS), mode, tpdos, rpdos, error, period_s, **how)


def answers(counts=0, *, state=0x0637, torque=0, velocity=0, mode=8):
    """The TPDOs with which a drive answers SYNC."""
    return (TPDO1, struct.pack("<Hih", state, counts, torque)), (TPDO2, struct.pack("<ib", velocity, mode))


class Bench:
    """The axis, fed with frames in hexadecimal."""

    def __init__(self, mode=Mode.CSP, *, is_listened_to=False, heartbeat_s=0.1, heartbeat=None, **how):
        if is_listened_to:
            how["rpdos"] = ()
        self.mode = mode
        self.axis = CanopenAxis(drive_of(mode, **how), NODE, heartbeat_s)
        self.axis.start(0)
        self.now_ns = 0
        if heartbeat is not None:
            self.heartbeat(heartbeat)

    def heartbeat(self, data):
        self.axis.handlers[HEARTBEAT](data)

    def take(self, *frames):
        for can_id, data in frames:
            self.axis.handlers[can_id](bytes.fromhex(data) if isinstance(data, str) else data)

    def cycle(self, *frames, after_ms=1, without_sync=""):
        """One period: SYNC, then frames (identifier, data); the feedback."""
        self.now_ns += round(after_ms * MS)
        self.axis.begin_cycle(self.now_ns, without_sync)
        self.take(*frames)
        feedback = Feedback()
        self.axis.report(feedback, self.now_ns)
        return feedback

    def heard(self, counts=0, *, after_ms=1, **what):
        """A cycle in which everything arrives."""
        return self.cycle(*answers(counts, **{"mode": self.mode, **what}), after_ms=after_ms)

    def command(self, request, position=0.0, velocity=0.0, torque=0.0):
        [(can_id, data)] = self.axis.encode(Command(request, position, velocity, torque))
        assert can_id == RPDO1
        return data.hex()
