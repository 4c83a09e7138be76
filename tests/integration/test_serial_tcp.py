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
CYCLE_NS = 25_000_000  # less than the 40 ms for which a kernel holds an acknowledgement back
CYCLES_IN_A_ROW, MOST_CYCLES = 10, 60


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
    register = RegisterField("position", "holding", 0, "uint16")
    read = ModbusExchange(TcpFraming(), 1, image, read=RegisterBlock("holding", 0, 1, (register,)))
    scheduler = BusScheduler(line, [image], 0.0, 0.0)
    line.open()

    def is_answered():
        image.fresh.clear()
        scheduler.enqueue((read,))
        run_schedulers([scheduler], time.monotonic_ns() + CYCLE_NS, LineSelector())
        scheduler.end_cycle()
        return "position" in image.fresh

    def wait_for_answers():
        """Run cycles until several replies in a row came in time; a busy machine may miss some."""
        answered = 0
        for _ in range(MOST_CYCLES):
            answered = answered + 1 if is_answered() else 0
            if answered == CYCLES_IN_A_ROW:
                return True
        return False

    try:
        assert wait_for_answers()
        slave.is_late = True
        while slave.is_late:
            is_answered()
        assert wait_for_answers()
    finally:
        line.close()
