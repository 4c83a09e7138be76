"""Serial drivers on TCP connections: what the kernels on both ends do to requests and replies."""

import socket
import threading
import time

import pytest
from friction_hil_drivers.modbus.codec import ModbusExchange
from friction_hil_drivers.modbus.framing import TcpFraming
from friction_hil_drivers.modbus.registers import RegisterBlock, RegisterField
from friction_hil_drivers.serial_line.line import Line
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Image
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.waiting import LineSelector, run_schedulers

REQUEST_SIZE = 12
CYCLES, CYCLE_NS = 60, 10_000_000


class Slave(threading.Thread):
    """A register that counts; `is_late` lets the next reply wait for the request after it, as a busy drive does."""

    def __init__(self, listener):
        super().__init__(daemon=True)
        self.is_late = False
        self._listener = listener

    def run(self):
        connection, _ = self._listener.accept()
        kept = []
        with connection, connection.makefile("rb") as requests:
            while len(request := requests.read(REQUEST_SIZE)) == REQUEST_SIZE:
                kept.append(request[:4] + b"\0\5" + request[6:8] + b"\2\0\7")
                if self.is_late:
                    self.is_late = False
                    continue
                for reply in kept:
                    connection.send(reply)  # one by one: the second waits until the first is acknowledged
                kept.clear()


@pytest.fixture
def slave():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        one = Slave(listener)
        one.port = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        one.start()
        yield one
    one.join(10.0)


def test_a_slave_that_was_late_once_is_not_late_for_ever(slave):
    """Neither side switches Nagle's algorithm off for the other: replies would stay one request behind."""
    line, image = Line(LineOptions.model_validate({"port": slave.port})), Image()
    read = ModbusExchange(
        TcpFraming(),
        1,
        image,
        read=RegisterBlock("holding", 0, 1, (RegisterField("position", "holding", 0, "uint16"),)),
    )
    scheduler = BusScheduler(line, [image], 0.0, 0.0)
    line.open()

    def answered(cycles):
        count = 0
        for _ in range(cycles):
            image.fresh.clear()
            scheduler.enqueue((read,))
            run_schedulers([scheduler], time.monotonic_ns() + CYCLE_NS, LineSelector())
            count += "position" in image.fresh
            scheduler.end_cycle()
        return count

    try:
        assert answered(CYCLES) > CYCLES // 2
        slave.is_late = True
        assert answered(CYCLES) > CYCLES // 2
    finally:
        line.close()
