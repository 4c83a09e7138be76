"""A drive that owes its reply: what the next single request to it is, when the axis is to stop."""

import struct

import pytest
from friction_hil_drivers.modbus.description import ModbusDescription
from friction_hil_drivers.modbus.driver import ModbusDrives, ModbusLine
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.serial_line.axis import SerialAxis, make_scales
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.description import load_description
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from pymodbus.framer.rtu import FramerRTU

from tests.serial_rig import BenchLine, Time

READ_WRITE, WRITE_MANY = 23, 16
CONTROL = 0x0105
QUICK_STOP = {"x": {"control": 2.0}}


class Bench:
    """Modbus drive on one line that answers its polls in zero time, while ``is_alive``."""

    def __init__(self):
        description = load_description("generic_cia402", None, ModbusDrives.descriptions, ModbusDescription)
        options = ModbusOptions.model_validate(
            {
                "line": {"port": "/dev/bench", "baud": 921600},
                "description": "generic_cia402",
                "unit": 1,
                "counts_per_unit": 10000.0,
                "rated_torque": 0.64,
            }
        )
        commands = description.modes["csv"].commands
        image = Image(dict.fromkeys(commands, 0.0))
        protocol = ModbusLine({"x": description}, {"x": options}, {"x": image})
        signals = CycleSignals(("position", "velocity"), ("torque", "status", "error"), commands)
        scales = make_scales("x", description, options.units, kind="rotary", is_inverted=False)
        self.time = Time()
        self.line = BenchLine(self._answer, baud=921600)
        self.scheduler = BusScheduler(self.line, [image], protocol.silence_chars, 8e-3, self.time)
        axes = [SerialAxis("x", description, scales, image, commands)]
        plan = protocol.plan({"x": signals})
        self.bus = SerialBus(self.scheduler, protocol, axes, plan, plan)
        self.is_alive = True

    def _answer(self, request):
        if not self.is_alive:
            return b""
        if request[1] == READ_WRITE:
            reply = bytes([1, READ_WRITE, 2 * request[5], *bytes(2 * request[5])])
        elif request[1] == WRITE_MANY:
            reply = request[:6]
        else:
            reply = request[:-2]
        return reply + struct.pack(">H", FramerRTU.compute_CRC(reply))

    def cycle(self, steps):
        """Run one cycle of 2 ms; functions of the requests that were written."""
        before = len(self.line.sent)
        self.bus.request_feedback(None, is_commanding=True, is_read=False)
        self._pass(1.0)
        self.scheduler.end_cycle()
        self.bus.send_commands(steps, None, is_commanding=True, stopping=steps)
        self._pass(1.0)
        return ["stop" if writes_control(each) else each[1] for each in self.line.sent[before:]]

    def _pass(self, ms):
        for _ in range(10):
            self.scheduler.poll()
            self.time.pass_ms(0.1 * ms)


def writes_control(request):
    at = {6: 2, WRITE_MANY: 2}.get(request[1])
    return at is not None and struct.unpack_from(">H", request, at)[0] == CONTROL


def test_to_a_silent_drive_the_stop_goes_before_the_next_set_points():
    bench = Bench()
    for _ in range(5):
        assert READ_WRITE in bench.cycle({})
    bench.is_alive = False
    for _ in range(3):
        bench.cycle({})
    sent = [request for _ in range(40) for request in bench.cycle(QUICK_STOP)]
    assert sent[:4] == ["stop", READ_WRITE, "stop", READ_WRITE]  # one each time the limit of 8 ms is over


def test_the_stop_waits_for_no_second_cycle_when_the_drive_answers_again():
    bench = Bench()
    bench.cycle({})
    bench.is_alive = False
    for _ in range(3):
        bench.cycle({})
    bench.is_alive = True
    sent = [request for _ in range(8) for request in bench.cycle(QUICK_STOP)]
    assert sent[0] == "stop"


@pytest.mark.parametrize("offset", [0, 1])
def test_while_the_drive_answers_a_step_goes_in_every_second_cycle(offset):
    bench = Bench()
    for _ in range(offset + 1):
        bench.cycle({})
    kinds = ["stop" in bench.cycle(QUICK_STOP) for _ in range(6)]
    assert kinds == [True, False, True, False, True, False]
