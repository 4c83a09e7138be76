"""``friction-hil doctor``: each obstacle is reported with its fix, and no drive receives a byte."""

import fcntl
import json
import os
import pickle
import re
import socket
import subprocess
import tty
from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.canopen.wire.exclusive import AxisLock
from friction_hil_drivers.serial_line import ports

from friction_hil.cli import main
from friction_hil.config import load
from friction_hil.doctor import checks as doctor
from friction_hil.doctor import codes
from friction_hil.drive import Driver
from friction_hil.drive.finding import Finding, complaints
from friction_hil.errors import BusError, ConfigurationError, ParameterError, UsageError
from tests.servo_drives import axis_dict

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
        failed = [each["check"] for each in findings if each["result"] == "fail"]
        assert status == (2 if "configuration" in failed else bool(failed))
        return {each["check"]: each for each in findings}, status

    return run


@pytest.fixture
def terminal():
    """A line whose other end the test has: (master, path)."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_a_machine_alone(capsys, monkeypatch):
    load_driver = doctor.load_driver

    def load_or_raise(name):
        if name == "modbus":
            raise ImportError("no module named pymodbus")
        return load_driver(name)

    monkeypatch.setattr(doctor, "load_driver", load_or_raise)
    assert main(["doctor", "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)
    checks = [each["check"] for each in findings]
    wanted = ["kernel", "processor clock", "compiled kernels", "memory", "priority", "processor sleep", "serial ports"]
    assert [check for check in checks if check in wanted] == wanted  # once, although three drivers yield it
    assert "configuration" not in checks
    broken = findings[checks.index("driver modbus")]
    assert (broken["result"], "no module named pymodbus" in broken["detail"]) == ("warn", True)


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
    assert "nonsense.yaml: " in found["configuration"]["detail"]


ACCEPTED = {**KINCO, "is_watchdog_required": False}
VIRTUAL = {"interface": "virtual", "channel": f"doctor-{os.getpid()}"}
MODEL = {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1, "static": 0.05}}}


def slcan(channel="/dev/null", **changes):
    return {"interface": "slcan", "channel": channel, **changes}


@pytest.mark.parametrize(
    ("axes", "top", "status", "expected"),
    [
        (
            [GENERIC],
            {},
            0,
            {"line of x": "pass: /dev/", "rate of x": "pass: .* 4 ms on /dev/", "x: description": "pass"}
            | {"x: watchdog": "pass", "priority": "realtime.priority is 0", "memory": None, "processor sleep": None},
        ),
        (
            [ACCEPTED],
            {"period_s": 1e-3},
            2,
            {"configuration": "too short", "line of x": "pass", "x: description": "warn", "rate of x": None},
        ),
        ([ACCEPTED], {}, 0, {"x: description": "warn: .*: mode, position, velocity, torque_", "x: watchdog": "warn"}),
        ([KINCO], {}, 2, {"configuration": "is_watchdog_required: false", "x: watchdog": None}),
        ([{**GENERIC, "model": MODEL}], {}, 0, {"x: model": "static is below coulomb"}),
        ([GENERIC, NODE], {"bus": VIRTUAL}, 2, {"configuration": "one driver", "line of x": "pass", "bus": "pass"}),
        (
            [GENERIC, {**GENERIC, "unit": 4}, {**GENERIC, "unit": 5, "description": "missing.yaml"}],
            {},
            2,
            {"line of x, y, z": "pass", "x: description": "pass", "y: description": "pass", "z: description": None},
        ),
        ([serial("/dev/ttyUSB77")], {}, 1, {"line of x": "fail: .* no such port; serial ports .*-> (?!.*simulate)"}),
        ([serial("/dev/ttyUSB77", simulation={})], {}, 1, {"line of x": "fail: .* no such port.*-> .*-hil simulate"}),
        ([serial("/dev/null", simulation={})], {}, 1, {"line of x": "fail: .* cannot be opened.*-> (?!.*simulate)"}),
        ([serial("tcp://nowhere")], {}, 2, {"configuration": "HOST:PORT"}),
        (
            [NODE, {**NODE, "node": 6}],
            {"bus": VIRTUAL},
            0,
            {"bus": "pass", "x: node 5": "pass", "y: node 6": "pass", "x: units": "608Fh .*60A9h"},
        ),
        ([NODE], {"bus": {"interface": "socketcan", "channel": "can77"}}, 1, {"bus": "fail: .* can77; CAN interfaces"}),
        ([NODE], {"bus": slcan("/dev/none")}, 1, {"bus": "fail: /dev/none: "}),
        ([NODE], {"bus": slcan()}, 0, {"bus": "warn: slcan /dev/null "}),
        ([NODE], {"bus": slcan(bitrate=1_000_000), "period_s": 1e-3}, 0, {"bus load": "pass: .*at 1000000 bit/s"}),
        ([NODE], {"bus": slcan(bitrate=125_000), "period_s": 1e-3}, 1, {"bus load": "fail: .*at 125000 bit/s"}),
        ([NODE], {"bus": {"interface": "pcam", "channel": "x"}}, 2, {"configuration": "'pcam'.*'pcan'", "bus": None}),
    ],
)
def test_each_obstacle_has_its_fix_and_no_drive_receives_a_byte(look, terminal, axes, top, status, expected):
    master, path = terminal
    line = {"line": {"port": path, "baud": 921600}}
    found, got = look(*(line | axis if "unit" in axis else axis for axis in axes), **top)
    assert got == status
    for check, words in expected.items():
        if words is None:
            assert check not in found
        else:
            assert re.search(words, "{result}: {detail} -> {fix}".format(**found[check]))
    with pytest.raises(BlockingIOError):
        os.read(master, 4096)


def test_a_line_is_given_back_and_one_that_is_locked_is_reported_although_its_holder_is_not_known(
    look, terminal, monkeypatch
):
    monkeypatch.setattr(ports, "holders", lambda port: [])  # as of another user's process
    for _ in range(2):
        assert look(serial(terminal[1]))[1] == 0
    descriptor = os.open(terminal[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    found, status = look(serial(terminal[1]))
    os.close(descriptor)
    assert status == 1
    assert "another process has it" in found["line of x"]["detail"]


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
    assert f"(process {other.pid}, sleep)" in found["line of x"]["detail"]
    assert found["line of x"]["fix"] == "end that process first"


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
    assert "Connection refused" in found["line of x"]["detail"]


@pytest.mark.parametrize(("latency_ms", "result"), [(1, "pass"), (2, "warn"), (4, "fail"), (16, "fail")])
def test_the_latency_of_an_adapter_is_judged_by_the_period(look, terminal, monkeypatch, latency_ms, result):
    monkeypatch.setattr(ports, "latency_s", lambda name, root=None: 1e-3 * latency_ms)
    found, status = look(serial(terminal[1]))
    latency = found[f"latency of {os.path.basename(terminal[1])}"]
    assert latency["result"] == result
    assert ("the period is 4 ms" in latency["detail"]) == (result == "fail")
    assert status == (result == "fail")


def test_an_interface_that_python_can_does_not_have_is_a_mistake_of_the_configuration(write, capsys):
    path = write(NODE, bus={"interface": "foo", "channel": "x"})
    assert main(["config", "check", str(path)]) == 2
    err = capsys.readouterr().err
    line = path.read_text().splitlines().index("  interface: foo") + 1
    assert err.startswith(f"{path}:{line}: bus.interface: python-can has no interface 'foo'; there are: ")
    assert ", socketcan, " in err


def test_an_axis_that_another_daemon_drives(look, write):
    lock = AxisLock(load(write(NODE, bus=VIRTUAL)).bus, 5, "x")
    found, status = look(NODE, bus=VIRTUAL)
    lock.release()
    assert status == 1
    assert f"(process {os.getpid()})" in found["x: node 5"]["detail"]
    assert look(NODE, bus=VIRTUAL)[1] == 0


def test_a_driver_without_checks_is_reported(look, terminal, monkeypatch):
    monkeypatch.setattr(doctor, "load_driver", lambda name: Driver)
    found, status = look(serial(terminal[1]))
    assert status == 0
    assert found["driver modbus"]["result"] == "warn"


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


ROOT = Path(__file__).parents[3]
SOURCES = [
    path
    for folder in (ROOT / "friction_hil", ROOT / "drivers")
    for path in folder.rglob("*.py")
    if path != Path(codes.__file__)
]
IN_CODE = re.compile(r'"(FH-[34]\d\d)"')


def test_the_codes_in_use_are_those_that_are_explained():
    assert list(codes.CODES) == sorted(codes.CODES)
    assert set(codes.CODES) == {code for path in SOURCES for code in IN_CODE.findall(path.read_text(encoding="utf-8"))}


def test_no_two_codes_have_the_same_message():
    assert len({each.message for each in codes.CODES.values()}) == len(codes.CODES)


def test_the_code_ends_the_message():
    finding = Finding("memory", "warn", "memory is not locked", "raise memlock", "FH-310")
    assert list(complaints([finding, Finding("kernel", "pass", "PREEMPT_RT")])) == [
        "memory is not locked; raise memlock [FH-310]"
    ]
    assert str(Finding("kernel", "pass", "PREEMPT_RT")) == "PREEMPT_RT"
