"""Simulated serial drives of a configuration, on pseudo-terminals and TCP, served by one thread."""

import contextlib
import socket
import threading
import time

import pytest
from friction_hil_drivers.ascii.simulated import SimulatedAsciiDrives
from friction_hil_drivers.serial_line.simulated.server import serve

from friction_hil.errors import BusError, ConfigurationError, UsageError
from tests.peers.serial_processes import free_tcp_port
from tests.serial_bench import LONG_S, Master
from tests.serial_rig import serial_configuration

ASK = {"a": b"r axis0.current_state*14\n", "b": b"r axis1.current_state*15\n"}
IDLE = b"1*49\r\n"


def drives_of(axes, pace="sync", period_s=1e-3):
    """Simulated ODrives of one axis each; ``axes`` has what is special about them."""
    numbers = {"a": 0, "b": 1, "c": 0}
    given = {name: {"axis": numbers[name], **keys} for name, keys in axes.items()}
    config = serial_configuration("odrive", given).model_copy(update={"period_s": period_s})
    return SimulatedAsciiDrives(config, config.axes, pace=pace)


@contextlib.contextmanager
def running(axes, **options):
    """Drives that are served in another thread; what they say when they are ready."""
    drives = drives_of(axes, **options)
    is_stopping = threading.Event()
    thread = threading.Thread(target=drives.run, args=(is_stopping.is_set,))
    try:
        ready = drives.open()
        thread.start()
        yield ready
    finally:
        is_stopping.set()
        thread.join(LONG_S)
        drives.close()
    assert not thread.is_alive()


def test_several_lines_and_axes_are_served_at_once(tmp_path):
    number = free_tcp_port()
    first, second = {"port": str(tmp_path / "one")}, {"port": f"tcp://127.0.0.1:{number}"}
    with running({"a": {"line": first}, "b": {"line": first}, "c": {"line": second}}) as ready:
        assert ready.startswith(f"a=axis 0, b=axis 1 on {tmp_path}/one (pseudo-terminal /dev/pts/")
        assert ready.endswith(f"; c=axis 0 on tcp://127.0.0.1:{number}")
        master = Master(tmp_path / "one")
        with socket.create_connection(("127.0.0.1", number), LONG_S) as client:
            for name in ("a", "b", "a"):
                master.send(ASK[name])
                assert master.line() == IDLE
            client.sendall(ASK["a"])
            assert client.recv(100) == IDLE
        master.close()
    assert not (tmp_path / "one").exists()


def test_with_pace_real_a_reply_takes_what_the_wire_takes(tmp_path):
    with running({"a": {"line": {"port": str(tmp_path / "line"), "baud": 9600}}}, pace="real", period_s=0.02):
        master = Master(tmp_path / "line")
        begin = time.monotonic()
        for _ in range(10):
            master.send(ASK["a"])
            assert master.line() == IDLE
        took_s = time.monotonic() - begin
        master.close()
    wire_s = 10 * (len(ASK["a"]) + len(IDLE)) * 10 / 9600
    assert wire_s <= took_s < wire_s + LONG_S


def test_a_clock_that_is_given_is_the_clock(tmp_path):
    drives = drives_of({"a": {"line": {"port": str(tmp_path / "line")}}}, pace="real")
    drives.open()
    passed = []

    def clock():
        passed.append(100_000 * len(passed))
        return passed[-1]

    try:
        serve(drives.lines, lambda: len(passed) > 500, period_ns=1_000_000, spin_ns=10**9, now_ns=clock)
        assert drives.lines[0].drives[0].time_s == pytest.approx(0.05)
    finally:
        drives.close()


def test_mistakes_are_told_and_leave_no_port_open(tmp_path):
    line, other = {"port": str(tmp_path / "line")}, {"port": str(tmp_path / "other")}
    (tmp_path / "wrong.yaml").write_text("version: 2")
    wrong = {"line": line, "description": str(tmp_path / "wrong.yaml")}
    for axes, period_s, error, words in (
        ({"a": {"line": line}, "b": {"line": line, "simulation": {"line": {"drop": 0.5}}}}, 1e-3, UsageError, "b: .*a"),
        ({"a": {"line": line}, "b": {"line": other, "description": "nonsense"}}, 1e-3, UsageError, "'nonsense'"),
        ({"a": wrong}, 1e-3, ConfigurationError, r"wrong\.yaml"),
        ({"a": {"line": line}}, 1.00001e-3, UsageError, "steps"),
    ):
        with pytest.raises(error, match=words):
            drives_of(axes, period_s=period_s).open()
        assert not (tmp_path / "line").exists()
    with pytest.raises(BusError):
        drives_of({"a": {"line": line}}).run(lambda: True)
