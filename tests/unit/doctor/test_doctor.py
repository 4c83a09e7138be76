"""``friction-hil doctor``: each obstacle is reported with its fix, and no drive receives a byte."""

import fcntl
import json
import os
import pickle
import socket
import subprocess
import tty

import pytest
import yaml
from friction_hil_drivers.canopen.wire.exclusive import AxisLock
from friction_hil_drivers.serial_line import ports

from friction_hil.cli import main
from friction_hil.config import load
from friction_hil.doctor import checks as doctor
from friction_hil.drive import Driver
from friction_hil.errors import BusError, ConfigurationError, ParameterError, UsageError
from tests.servo_drives import axis_dict
from tests.system_files import lay

CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}
KINCO = {"driver": "modbus", "unit": 3, "description": "kinco_fd5p", "counts_per_unit": 1e5, "rated_torque": 0.64}
KINCO["torque_constant"] = 0.1
GENERIC = {**KINCO, "description": "generic_cia402"}
NODE = {"driver": "canopen", "node": 5}


def serial(port, kind=GENERIC, **changes):
    """An axis on a serial line."""
    return {**kind, "line": {"port": str(port), "baud": 921600}, **changes}


@pytest.fixture
def write(tmp_path):
    """Write a configuration whose loop makes no real-time settings."""

    def run(*axes, name="machine", period_s=4e-3, **top):
        data = {"version": 1, "period_s": period_s, "realtime": {"priority": 0}, **top, "axes": {}}
        for axis_name, changes in zip("xyz", axes, strict=False):
            axis = axis_dict(mode="cst", controller=CONTROLLER) | changes
            data["axes"][axis_name] = {key: value for key, value in axis.items() if key != "node" or "node" in changes}
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(data))
        return path

    return run


@pytest.fixture
def look(write, capsys):
    """Findings by their check, and the exit status, of a configuration with these axes."""

    def run(*axes, path=None, **top):
        path = write(*axes, **top) if path is None else path
        status = main(["doctor", "--json", str(path)])
        out, err = capsys.readouterr()
        assert err == ""
        findings = json.loads(out)
        for each in findings:
            assert list(each) == ["check", "result", "detail", "fix", "code"]
            assert each["result"] in ("pass", "warn", "fail")
            assert bool(each["fix"]) == bool(each["code"]) == (each["result"] != "pass"), each
        is_failed = any(each["result"] == "fail" for each in findings)
        assert status == (2 if any(is_mistake(each) for each in findings) else is_failed)
        return {each["check"]: each for each in findings}, status

    return run


def is_mistake(finding):
    return (finding["check"], finding["result"]) == ("configuration", "fail")


@pytest.fixture
def terminal():
    """A line whose other end the test has: (master, path)."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def received_by_the_drive(master):
    try:
        return os.read(master, 4096)
    except BlockingIOError:
        return b""


# The machine


def test_a_machine_alone(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "load_driver", raising_for("modbus", doctor.load_driver))
    assert main(["doctor", "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)
    checks = [each["check"] for each in findings]
    wanted = ["kernel", "processor clock", "compiled kernels", "memory", "priority", "processor sleep", "serial ports"]
    assert [check for check in checks if check in wanted] == wanted  # once, although three drivers yield it
    assert "configuration" not in checks
    broken = findings[checks.index("driver modbus")]
    assert (broken["result"], "no module named pymodbus" in broken["detail"]) == ("warn", True)


def raising_for(broken, load_driver):
    def load_or_raise(name):
        if name == broken:
            raise ImportError("no module named pymodbus")
        return load_driver(name)

    return load_or_raise


def test_a_system_without_information_passes_no_check_that_needs_it(tmp_path):
    lay(tmp_path, proc__empty="")
    found = {each.check: each for each in doctor.examine(None, tmp_path)}
    for check in ("kernel", "processor clock"):
        assert found[check].result == "warn"
        assert "not reported by this system" in found[check].detail


def test_without_a_priority_nothing_is_asked_of_the_system(look, terminal):
    found, _ = look(serial(terminal[1]))
    assert "realtime.priority is 0" in found["priority"]["detail"]
    assert not {"memory", "processor sleep"} & set(found)


# The configuration


def test_mistakes_of_a_configuration_are_reported_beside_the_machine(look, write):
    path = write(serial("/dev/none", description="kinko_fd5p"))
    path.write_text(path.read_text().replace("period_s: 0.004", "period_s: none"))
    found, status = look(path=path)
    assert status == 2
    assert found["configuration"]["detail"].startswith("period_s: ")
    line = 1 + path.read_text().splitlines().index("period_s: none")
    assert found["configuration"]["fix"] == f"correct {path}, line {line}"
    assert "serial ports" in found


def test_a_configuration_that_is_not_there(look, tmp_path):
    found, status = look(path=tmp_path / "nonsense.yaml")
    assert status == 2
    assert "nonsense.yaml: cannot be read: No such file" in found["configuration"]["detail"]


def test_what_config_check_finds_in_files_is_found_and_the_rest_is_reported_all_the_same(look, terminal):
    found, status = look(serial(terminal[1], KINCO, is_watchdog_required=False), period_s=1e-3)
    assert status == 2
    assert "is too short for" in found["configuration"]["detail"]
    assert found["line of x"]["result"] == "pass"
    assert found["x: description"]["result"] == "warn"
    assert "rate of x" not in found


def test_two_drivers_in_one_run_are_refused_beforehand(look, terminal):
    found, status = look(serial(terminal[1]), NODE, bus={"interface": "virtual", "channel": f"doctor-{os.getpid()}"})
    assert status == 2
    assert "one run drives axes of one driver" in found["configuration"]["detail"]
    assert found["line of x"]["result"] == found["bus"]["result"] == "pass"


def test_notes_on_a_model_are_reported(look, terminal):
    model = {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1, "static": 0.05}}}
    found, status = look(serial(terminal[1], model=model))
    assert status == 0
    assert "static is below coulomb" in found["x: model"]["detail"]


# Serial lines


def test_a_line_that_is_free_passes_and_its_drive_hears_nothing(look, terminal):
    master, path = terminal
    found, status = look(serial(path))
    assert status == 0
    assert found["line of x"] == {
        "check": "line of x",
        "result": "pass",
        "detail": f"{path} can be opened",
        "fix": "",
        "code": "",
    }
    assert found["rate of x"]["result"] == found["x: description"]["result"] == found["x: watchdog"]["result"] == "pass"
    assert f"of 4 ms on {path}" in found["rate of x"]["detail"]
    assert received_by_the_drive(master) == b""


def test_a_line_is_given_back(look, terminal):
    for _ in range(2):
        assert look(serial(terminal[1]))[1] == 0
    descriptor = os.open(terminal[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(descriptor)


def test_a_line_that_another_process_has_is_reported_with_that_process_and_left_as_it_is(look, terminal):
    """Some programs do not lock their port: opening it would change its baud rate while they use it."""
    with open(terminal[1], "rb", buffering=0) as line, subprocess.Popen(["sleep", "60"], stdin=line) as other:
        before = tty.tcgetattr(line)
        try:
            found, status = look(serial(terminal[1]))
        finally:
            other.kill()
        assert tty.tcgetattr(line) == before
    assert status == 1
    assert f"another process has it (process {other.pid}, sleep)" in found["line of x"]["detail"]
    assert found["line of x"]["fix"] == "end that process first"


def test_a_line_that_is_locked_is_reported_although_its_holder_is_not_known(look, terminal, monkeypatch):
    monkeypatch.setattr(ports, "holders", lambda port: [])  # as of another user's process
    descriptor = os.open(terminal[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    found, status = look(serial(terminal[1]))
    os.close(descriptor)
    assert status == 1
    assert "another process has it: a line must have only one master" in found["line of x"]["detail"]


@pytest.mark.parametrize("is_simulated", [False, True])
def test_a_missing_port_is_reported(look, tmp_path, is_simulated):
    found, status = look(serial(tmp_path / "ttyUSB7", **({"simulation": {}} if is_simulated else {})))
    assert status == 1
    assert "there is no such port; serial ports of this machine:" in found["line of x"]["detail"]
    assert ("friction-hil simulate" in found["line of x"]["fix"]) == is_simulated


def test_a_file_is_no_port(look, tmp_path):
    (tmp_path / "file").write_text("")
    found, status = look(serial(tmp_path / "file", simulation={}))
    assert status == 1
    assert "cannot be opened" in found["line of x"]["detail"]
    assert "simulate" not in found["line of x"]["fix"]


def test_an_address_that_is_none_is_a_mistake_of_the_configuration(look):
    found, status = look(serial("tcp://nowhere"))
    assert status == 2
    assert "is no tcp://HOST:PORT" in found["configuration"]["detail"]


def test_a_tcp_connection_sends_nothing(look):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        listener.settimeout(10.0)
        found, status = look(serial(port))
        connection, _ = listener.accept()
        with connection:
            connection.settimeout(10.0)
            assert connection.recv(100) == b""  # it has gone again, and said nothing
    assert status == 0
    assert found["line of x"]["detail"] == f"{port} accepts connections"
    found, status = look(serial(port))
    assert status == 1
    assert "no connection: Connection refused" in found["line of x"]["detail"]


@pytest.mark.parametrize(("latency_ms", "result"), [(1, "pass"), (2, "warn"), (4, "fail"), (16, "fail")])
def test_the_latency_of_an_adapter_is_judged_by_the_period(look, terminal, monkeypatch, latency_ms, result):
    monkeypatch.setattr(ports, "latency_s", lambda name, root=None: 1e-3 * latency_ms)
    found, status = look(serial(terminal[1]))
    latency = found[f"latency of {os.path.basename(terminal[1])}"]
    assert latency["result"] == result
    assert ("the period is 4 ms" in latency["detail"]) == (result == "fail")
    assert status == (result == "fail")


def test_signals_that_no_manual_was_read_for_are_reported(look, terminal):
    found, status = look(serial(terminal[1], KINCO, is_watchdog_required=False))
    assert status == 0
    assert found["x: description"]["result"] == "warn"
    assert "Kinco FD5P / CD3: mode, position, velocity, torque_command" in found["x: description"]["detail"]
    assert found["x: watchdog"]["result"] == "warn"


def test_a_drive_that_would_not_notice_a_dead_daemon_is_a_mistake_where_that_is_required(look, terminal):
    found, status = look(serial(terminal[1], KINCO))
    assert status == 2
    assert "Set is_watchdog_required: false to accept that" in found["configuration"]["detail"]
    assert "x: watchdog" not in found


def test_axes_on_one_line_are_reported_together_and_a_broken_description_hides_no_other(look, terminal, tmp_path):
    line = serial(terminal[1])
    found, status = look(line, {**line, "unit": 4}, {**line, "unit": 5, "description": "missing.yaml"})
    assert status == 2
    assert found["line of x, y, z"]["result"] == "pass"
    assert found["x: description"]["result"] == found["y: description"]["result"] == "pass"
    assert "z: description" not in found


# CAN


def test_a_bus_that_opens(look):
    found, status = look(NODE, {**NODE, "node": 6}, bus={"interface": "virtual", "channel": f"doctor-{os.getpid()}"})
    assert status == 0
    assert {check: found[check]["result"] for check in ("bus", "x: node 5", "y: node 6")} == {
        "bus": "pass",
        "x: node 5": "pass",
        "y: node 6": "pass",
    }
    assert "position as 608Fh says, velocity as 60A9h says" in found["x: units"]["detail"]


@pytest.mark.parametrize(
    ("bus", "result", "text"),
    [
        ({"interface": "socketcan", "channel": "can77"}, "fail", "there is no interface can77; CAN interfaces of"),
        ({"interface": "slcan", "channel": "/dev/none"}, "fail", "/dev/none: there is no such device"),
        ({"interface": "slcan", "channel": "/dev/null"}, "warn", "slcan /dev/null is not opened here"),
    ],
)
def test_a_bus_that_does_not_open_or_is_not_opened(look, bus, result, text):
    found, status = look(NODE, bus=bus)
    assert (found["bus"]["result"], status) == (result, int(result == "fail"))
    assert text in found["bus"]["detail"]


def test_an_interface_that_python_can_does_not_have_is_a_mistake_of_the_configuration(look, write, capsys):
    found, status = look(NODE, bus={"interface": "pcam", "channel": "x"})
    assert "bus" not in found
    assert status == 2
    text = "bus.interface: python-can has no interface 'pcam'; did you mean 'pcan'? There are: "
    assert found["configuration"]["detail"].startswith(text)
    path = write(NODE, bus={"interface": "foo", "channel": "x"})
    assert main(["config", "check", str(path)]) == 2
    err = capsys.readouterr().err
    line = path.read_text().splitlines().index("  interface: foo") + 1
    assert err.startswith(f"{path}:{line}: bus.interface: python-can has no interface 'foo'; there are: ")
    assert ", socketcan, " in err


@pytest.mark.parametrize(("bitrate", "result"), [(1_000_000, "pass"), (125_000, "fail")])
def test_the_load_of_a_bus(look, bitrate, result):
    bus = {"interface": "slcan", "channel": "/dev/null", "bitrate": bitrate}
    found, status = look(NODE, bus=bus, period_s=1e-3)
    assert (found["bus load"]["result"], status) == (result, int(result == "fail"))
    assert f"at {bitrate} bit/s" in found["bus load"]["detail"]


def test_an_axis_that_another_daemon_drives(look, write):
    bus = {"interface": "virtual", "channel": f"doctor-lock-{os.getpid()}"}
    config = load(write(NODE, bus=bus)).bus
    lock = AxisLock(config, 5, "x")
    found, status = look(NODE, bus=bus)
    lock.release()
    assert status == 1
    assert f"another daemon already (process {os.getpid()})" in found["x: node 5"]["detail"]
    assert look(NODE, bus=bus)[1] == 0


# A driver without checks


def test_a_driver_without_checks_is_reported(look, terminal, monkeypatch):
    monkeypatch.setattr(doctor, "load_driver", lambda name: Driver)
    found, status = look(serial(terminal[1]))
    assert status == 0
    assert found["driver modbus"]["result"] == "warn"


# For people, and the errors


def test_people_read_each_check_with_its_fix(write, terminal, tmp_path, capsys):
    path = write(serial(terminal[1]), serial(tmp_path / "missing", unit=4))
    assert main(["doctor", str(path)]) == 1
    out, err = capsys.readouterr()
    assert err == ""
    rows = out.splitlines()
    start = next(k for k, row in enumerate(rows) if row.startswith("fail  line of y:"))
    fix = next(row for row in rows[start + 1 :] if not row.startswith("      ") or row.startswith("      fix: "))
    assert fix == "      fix: plug the adapter in, or correct line.port"
    counts = [sum(row.startswith(f"{word}  ") for row in rows) for word in ("pass", "warn", "fail")]
    assert rows[-1] == f"{counts[0]} passed, {counts[1]} with a warning, {counts[2]} failed"
    assert counts[2] == 1


@pytest.mark.parametrize("kind", [BusError, UsageError, ParameterError])
def test_an_error_has_its_fix_in_its_message_and_apart(kind):
    for error in (kind("no port", "plug it in"), pickle.loads(pickle.dumps(kind("no port", "plug it in")))):
        assert (str(error), error.detail, error.fix) == ("no port; plug it in", "no port", "plug it in")
    assert (str(kind("no port")), kind("no port").fix) == ("no port", "")
    assert ConfigurationError([]).fix == ""
