"""Simulated serial drives of a configuration, on pseudo-terminals and TCP, served by one thread."""

import contextlib
import json
import socket
import threading
import time

import pytest
from friction_hil_drivers.serial_line.simulated import SerialSimulation
from friction_hil_drivers.serial_line.simulated.server import serve

from friction_hil.config import from_dict
from friction_hil.errors import BusError, ConfigurationError, UsageError
from tests.peers.serial_processes import free_tcp_port
from tests.serial_bench import CIA402, LONG_S, PLAIN, Master, TinyOptions, TinySimulatedDrives


def configuration(tmp_path, axes, period_s=1e-3):
    """Axes with the options of the made-up protocol, which no configuration file could name."""
    description = tmp_path / "tiny.yaml"
    description.write_text(json.dumps(CIA402))
    axis = {
        "driver": "canopen",
        "mode": "cst",
        "limits": {"torque": 0.3, "velocity": 100.0},
        "model": {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}},
        "trajectory": {"kind": "none"},
        "controller": None,
    }
    plain = from_dict(
        {
            "version": 1,
            "period_s": period_s,
            "bus": {"interface": "virtual", "channel": "unused"},
            "axes": {name: {**axis, "node": number} for number, name in enumerate(axes, 1)},
        },
        "test",
    )
    replaced = {
        name: plain.axes[name].model_copy(
            update={
                "options": TinyOptions(line=given["line"], description=str(given.get("description", description))),
                "simulation": SerialSimulation.model_validate({**PLAIN, **given.get("simulation", {})}),
            }
        )
        for name, given in axes.items()
    }
    return plain.model_copy(update={"axes": replaced})


@contextlib.contextmanager
def running(config, pace="sync"):
    """Drives that are served in another thread; what they say when they are ready."""
    drives = TinySimulatedDrives(config, config.axes, pace=pace)
    is_stopping = threading.Event()
    thread = threading.Thread(target=drives.run, args=(is_stopping.is_set,))
    try:
        ready = drives.open()
        thread.start()
        yield ready
    finally:
        is_stopping.set()
        if thread.ident is not None:
            thread.join(LONG_S)
        drives.close()
        drives.close()
    assert not thread.is_alive()


def test_several_lines_and_axes_are_served_at_once(tmp_path):
    number = free_tcp_port()
    first, second = {"port": str(tmp_path / "one")}, {"port": f"tcp://127.0.0.1:{number}"}
    config = configuration(tmp_path, {"a": {"line": first}, "b": {"line": first}, "c": {"line": second}})
    with running(config) as ready:
        assert ready.startswith(f"a=the only one, b=the only one on {tmp_path}/one (pseudo-terminal /dev/pts/")
        assert ready.endswith(f"; c=the only one on tcp://127.0.0.1:{number}")
        master = Master(tmp_path / "one")
        with socket.create_connection(("127.0.0.1", number), LONG_S) as client:
            for name in (b"a", b"b", b"a"):
                master.send(b"?" + name + b".status\n")
                assert master.line() == b"592\n"
            client.sendall(b"?status\n")
            assert client.recv(100) == b"592\n"
        master.close()
    assert not (tmp_path / "one").exists()


def test_with_pace_real_a_reply_takes_what_the_wire_takes(tmp_path):
    config = configuration(tmp_path, {"x": {"line": {"port": str(tmp_path / "line"), "baud": 9600}}}, period_s=0.02)
    with running(config, "real"):
        master = Master(tmp_path / "line")
        begin = time.monotonic()
        for _ in range(20):
            master.send(b"?status\n")
            assert master.line() == b"592\n"
        took_s = time.monotonic() - begin
        master.close()
    wire_s = 20 * 12 * 10 / 9600
    assert wire_s <= took_s < wire_s + LONG_S


def test_a_clock_that_is_given_is_the_clock(tmp_path):
    config = configuration(tmp_path, {"x": {"line": {"port": str(tmp_path / "line")}}})
    drives = TinySimulatedDrives(config, config.axes, pace="real")
    drives.open()
    ticks = iter(range(0, 1_000_000_000, 100_000))
    now = 0

    def clock():
        nonlocal now
        now = next(ticks)
        return now

    try:
        serve(drives.lines, lambda: now >= 50_000_000, period_ns=1_000_000, spin_ns=10**9, now_ns=clock)
        assert drives.lines[0].drives[0].time_s == pytest.approx(0.05)
    finally:
        drives.close()


def test_mistakes_are_told_and_leave_no_port_open(tmp_path):
    line, other = {"port": str(tmp_path / "line")}, {"port": str(tmp_path / "other")}

    def opened(**axes):
        config = configuration(tmp_path, axes)
        TinySimulatedDrives(config, config.axes, pace="sync").open()

    with pytest.raises(UsageError, match=r"b: simulation\.line differs from that of a"):
        opened(a={"line": line}, b={"line": line, "simulation": {"line": {"drop": 0.5}}})
    with pytest.raises(UsageError, match=r"no drive is described as 'nonsense'"):
        opened(a={"line": line}, b={"line": other, "description": "nonsense"})
    assert not (tmp_path / "line").exists()
    (tmp_path / "wrong.yaml").write_text("version: 2")
    with pytest.raises(ConfigurationError, match=r"wrong\.yaml"):
        opened(a={"line": line, "description": tmp_path / "wrong.yaml"})
    config = configuration(tmp_path, {"a": {"line": line}}, period_s=1.00001e-3)
    with pytest.raises(UsageError, match="whole number of integration steps"):
        TinySimulatedDrives(config, config.axes, pace="sync").open()
    with pytest.raises(BusError, match="call open"):
        TinySimulatedDrives(config, config.axes, pace="sync").run(lambda: True)
