"""Modbus between programs of different origin: libmodbus's command line at our drives, our driver at a libmodbus drive.

Everything is on the loopback or on pseudo-terminals. Time passes by requests, so that nothing depends on the clock.
"""

import contextlib
import re
import subprocess
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import yaml
from friction_hil_drivers.modbus.description import DESCRIPTIONS
from friction_hil_drivers.modbus.driver import ModbusDrives

import friction_hil as fh
from friction_hil.config import load
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import DriveError
from tests.peers.serial_processes import (
    COUNTS,
    LONG_S,
    free_tcp_port,
    process,
    program,
    socat_pair,
    wait_until,
    write_serial_configuration,
)
from tests.processes import run, run_daemon, simulated_drives

SOURCE = Path(__file__).parents[1] / "peers" / "modbus_slave.c"
UNIT = 3
STATUS, POSITION, VELOCITY = 0, 3, 5
TORQUE_COMMAND, CONTROL, MODE = 0x102, 0x105, 0x106
START = -1e6 / COUNTS  # rad, where the C drive stands at first
IN_CST = {"mode": "cst", "controller": {"position_gain": 20.0, "velocity_gain": 0.02}}  # all that the C drive has


class Mbpoll:
    """The command line of libmodbus at a drive."""

    def __init__(self, port: str) -> None:
        self._program = program("mbpoll")
        host, _, number = port.removeprefix("tcp://").rpartition(":")
        serial = ["-m", "rtu", "-b", "921600", "-P", "none", port]
        self._where = ["-m", "tcp", "-p", number, host] if port.startswith("tcp://") else serial

    def __call__(self, address, *values, count=1, table="4", unit=UNIT, patience_s=5):
        words = [self._program, "-0", "-1", "-B", "-a", unit, "-r", address, "-t", table, "-o", patience_s]
        words += ([] if values else ["-c", count]) + self._where + list(values)
        return subprocess.run(
            [str(word) for word in words], capture_output=True, text=True, timeout=LONG_S, check=False
        )

    def read(self, address, **options) -> list[int]:
        done = self(address, **options)
        assert done.returncode == 0, done.stderr
        # beyond 32767 the number is shown signed, too: "65535 (-1)"
        return [int(found) for found in re.findall(r"^\[\d+\]:\s+(-?\d+)", done.stdout, re.MULTILINE)]

    def write(self, address, *values) -> None:
        done = self(address, *values)
        assert done.returncode == 0, done.stderr


def port_in(configuration: Path) -> str:
    return yaml.safe_load(configuration.read_text())["axes"]["x"]["line"]["port"]


@pytest.fixture(params=["rtu", "rtu through socat", "tcp"])
def mbpoll(request, tmp_path):
    """A simulated drive in CST and mbpoll on its line, or behind another pair of pseudo-terminals."""
    configuration = write_serial_configuration(tmp_path, f"modbus {request.param[:3]}", **IN_CST)
    port = port_in(configuration)
    with simulated_drives(configuration), contextlib.ExitStack() as stack:
        if request.param == "rtu through socat":
            end = tmp_path / "end"
            stack.enter_context(process(program("socat"), f"pty,raw,echo=0,link={end}", f"{port},raw,echo=0"))
            wait_until(end.exists, "socat's pseudo-terminal")
            port = str(end)
        yield Mbpoll(port)


def test_mbpoll_reads_the_simulated_drive(mbpoll):
    status, error, torque, *_ = mbpoll.read(STATUS, count=7)
    assert status & 0x6F == 0x40  # Switch On Disabled
    assert (error, torque) == (0, 0)
    assert mbpoll.read(POSITION, table="4:int") == [0]


def test_mbpoll_enables_and_pushes_the_simulated_drive(mbpoll):
    for word, state in ((6, 0x21), (7, 0x23), (15, 0x27)):
        mbpoll.write(CONTROL, word)
        assert mbpoll.read(STATUS)[0] & 0x6F == state
    mbpoll.write(TORQUE_COMMAND, 0x10000 - 400)  # per mille of 0.64 N m: 0.256 N m, more than the friction
    (before,) = mbpoll.read(POSITION, table="4:int")
    positions = [mbpoll.read(POSITION, table="4:int")[0] for _ in range(4)]
    assert before > positions[0] > positions[1] > positions[2] > positions[3]
    assert mbpoll.read(VELOCITY, table="4:int")[0] < 0
    mbpoll.write(CONTROL, 0)
    assert mbpoll.read(STATUS)[0] & 0x6F == 0x40
    mbpoll.read(POSITION, count=1)  # a period passes, after which there is no torque any more
    assert mbpoll.read(2)[0] in (0, 0xFFFF)


def test_mbpoll_writes_several_registers_at_once(mbpoll):
    mbpoll.write(0x103, 0x1234, 0x5678)  # a position command, both words by function 16
    assert mbpoll.read(0x103, table="4:int") == [0x12345678]
    mbpoll.write(MODE, 10)
    assert mbpoll.read(MODE) == [10]


REFUSALS = (
    ((7,), {}, "Illegal data address"),
    ((6,), {"count": 2}, "Illegal data address"),
    ((0x108, 1), {}, "Illegal data address"),
    ((0,), {"table": "3"}, "Illegal function"),
    ((0,), {"table": "0"}, "Illegal function"),
    ((MODE, 4711), {}, "Illegal data value"),
    ((STATUS, 5), {}, "Illegal data value"),  # it can only be read
    ((STATUS,), {"unit": UNIT + 1}, "timed out"),  # nobody
)


@pytest.mark.parametrize("kind", ["modbus rtu", "modbus tcp"])
def test_what_the_simulated_drive_has_not_is_refused_by_name(tmp_path, kind):
    configuration = write_serial_configuration(tmp_path, kind, **IN_CST)
    with simulated_drives(configuration):
        mbpoll = Mbpoll(port_in(configuration))
        for arguments, options, reason in REFUSALS:
            done = mbpoll(*arguments, patience_s=0.5 if "timed" in reason else 5, **options)
            assert done.returncode == 1
            assert reason in done.stderr
            assert mbpoll.read(STATUS)[0] & 0x6F == 0x40  # it goes on


# The driver, and a drive in C

LITTLE = {"word_order: big": "word_order: little"}
VARIANTS = {
    "function 23": {},
    "low word first": LITTLE,
    "functions 3 and 16": {"read_write_multiple: true": "", "write_functions: [6, 16]": "write_functions: [16]"},
}


@pytest.fixture(scope="module")
def slave_program(tmp_path_factory):
    """The C drive, compiled."""
    built = tmp_path_factory.mktemp("peer") / "modbus_slave"
    compiler = program("gcc")
    header = "#include <modbus.h>\n"
    flags = ["-I/usr/include/modbus", "-I/usr/local/include/modbus"]
    probe = subprocess.run(
        [compiler, *flags, "-E", "-xc", "-"], input=header, capture_output=True, text=True, check=False
    )
    if probe.returncode:
        pytest.skip("libmodbus's header is not installed (libmodbus-dev)")
    flags += ["-std=c11", "-D_DEFAULT_SOURCE", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *flags, str(SOURCE), "-o", str(built), "-lmodbus", "-lm"], check=True)
    return built


@contextlib.contextmanager
def c_drive(slave_program, folder, kind, replaced=MappingProxyType({}), **changes):
    """The drive in C on its line; the configuration of its axis, with some text of its description replaced."""
    word_order = "little" if replaced == LITTLE else "big"
    with contextlib.ExitStack() as stack:
        if kind == "tcp":
            number = str(free_tcp_port())
            line, where = {"port": f"tcp://127.0.0.1:{number}"}, number
        else:
            ours, where = stack.enter_context(socat_pair(folder, "ours", "theirs"))
            line = {"port": ours, "baud": 921600}
        text = (DESCRIPTIONS / "generic_cia402.yaml").read_text()
        for before, after in replaced.items():
            assert before in text
            text = text.replace(before, after)
        (folder / "drive.yaml").write_text(text)
        configuration = write_serial_configuration(
            folder,
            f"modbus {kind}",
            period_s=1e-3,
            line=line,
            **{"description": "drive.yaml", "watchdog_s": 10.0, **IN_CST, **changes},
        )
        slave = stack.enter_context(
            process(slave_program, kind, where, UNIT, word_order, stdout=subprocess.PIPE, text=True)
        )
        assert slave.stdout.readline() == "ready\n"
        yield configuration
        slave.stdout.close()


class Cycles:
    """The driver at a drive, cycle by cycle."""

    def __init__(self, configuration: Path) -> None:
        config = load(configuration)
        self.clock = SteppedClock()
        self.drives = ModbusDrives(config, config.axes, self.clock, dry_run=False)
        self.feedback, self.command = Feedback(), Command()

    def __enter__(self):
        (self.facts,) = self.drives.connect()
        self.drives.start()
        return self

    def __exit__(self, *_):
        self.drives.close()

    def pass_(self, request, torque=0.0, count=1):
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            self.drives.receive([self.feedback], self.clock.now_ns() + 1_000_000)
            self.command.request, self.command.torque = request, torque
            self.drives.send([self.command])


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("kind", ["rtu", "tcp"])
def test_a_drive_from_another_hand_is_enabled_pushed_and_disabled(slave_program, tmp_path, kind, variant):
    with c_drive(slave_program, tmp_path, kind, VARIANTS[variant]) as configuration, Cycles(configuration) as cycles:
        feedback = cycles.feedback
        cycles.pass_(Request.LISTEN)
        assert feedback.is_fresh
        assert feedback.position == pytest.approx(START, abs=1.0 / COUNTS)
        assert feedback.state is DriveState.SWITCH_ON_DISABLED
        cycles.pass_(Request.ENABLE, count=20)
        assert feedback.state is DriveState.OPERATION_ENABLED
        assert feedback.velocity == 0.0

        cycles.pass_(Request.ENABLE, -0.3, count=21)  # of which 19 or 20 act by the last feedback
        assert feedback.is_fresh
        assert feedback.torque == pytest.approx(-0.3, abs=1e-3)
        # (0.3 - 0.05) N m on 2e-4 kg m^2
        assert feedback.velocity == pytest.approx(-1250.0 * 0.02, abs=1.4)
        assert feedback.position - START == pytest.approx(-0.5 * 1250.0 * 0.02**2, abs=0.03)

        cycles.pass_(Request.QUICK_STOP, count=150)
        assert not feedback.state.is_powered
        assert feedback.velocity == 0.0
        cycles.pass_(Request.ENABLE, count=20)
        assert feedback.state is DriveState.OPERATION_ENABLED
        cycles.pass_(Request.ENABLE, 0.2, count=5)
        cycles.pass_(Request.DISABLE, 0.0, count=10)
        assert not feedback.state.is_powered
        assert feedback.torque == 0.0


def test_after_the_driver_has_left_the_drive_has_no_power(slave_program, tmp_path):
    with c_drive(slave_program, tmp_path, "tcp") as configuration:
        mbpoll = Mbpoll(port_in(configuration))
        with Cycles(configuration) as cycles:
            cycles.pass_(Request.ENABLE, 0.3, count=30)
            assert cycles.feedback.state is DriveState.OPERATION_ENABLED
        assert mbpoll.read(STATUS)[0] & 0x6F == 0x40
        assert mbpoll.read(TORQUE_COMMAND) == [0]


def test_a_refusal_of_a_drive_from_another_hand_is_told_in_words(slave_program, tmp_path):
    with c_drive(slave_program, tmp_path, "rtu", mode="csp", controller=None) as configuration:
        config = load(configuration)
        drives = ModbusDrives(config, config.axes, SteppedClock(), dry_run=False)
        with pytest.raises(
            DriveError, match=r"^x: write [^:]* 0106h of unit 3: unit 3 refuses: illegal data value.*\(exception 3\)"
        ):
            drives.connect()
        drives.close()


@pytest.mark.parametrize("before", [4, 5])  # a step of a sequence has every second cycle
def test_a_fault_of_a_drive_from_another_hand_is_told_and_reset(slave_program, tmp_path, before):
    with c_drive(slave_program, tmp_path, "tcp", watchdog_s=0.2) as configuration:
        mbpoll = Mbpoll(port_in(configuration))
        cycles = Cycles(configuration).__enter__()
        cycles.pass_(Request.ENABLE, 0.0, count=20)
        for bus in cycles.drives.buses:
            bus.scheduler.line.close()  # as if the daemon had died
        wait_until(lambda: mbpoll.read(STATUS)[0] & 0x6F == 0x08, "the drive's watchdog")
        with Cycles(configuration) as again:
            again.pass_(Request.LISTEN)
            assert again.feedback.state is DriveState.FAULT
            assert again.feedback.error == "8100h communication error"
            again.pass_(Request.ENABLE, count=before)  # never leads out of a fault
            assert again.feedback.state is DriveState.FAULT
            again.pass_(Request.RESET_FAULT, count=5)
            assert again.feedback.state is DriveState.SWITCH_ON_DISABLED


@pytest.mark.deep
@pytest.mark.parametrize(("kind", "variant"), [("rtu", "low word first"), ("tcp", "functions 3 and 16")])
def test_the_daemon_moves_a_drive_from_another_hand(slave_program, tmp_path, kind, variant):
    coulomb = {
        "axis": "rotary",
        "friction": {"model": "coulomb", "parameters": {"coulomb": 0.05}},
        "mechanics": {"inertia": 2e-4},
    }
    with c_drive(slave_program, tmp_path, kind, VARIANTS[variant], model=coulomb) as configuration:
        result, _ = run_daemon(configuration, "--duration", 1.5, "--record", tmp_path / "run.mcap")
    assert result["faults"] == []
    recording = fh.recordings.read(tmp_path / "run.mcap")
    assert recording["position"][0] == pytest.approx(START, abs=1e-3)
    running = recording["state"] == LoopState.RUNNING
    assert np.all(recording["is_fresh"] == 1.0)
    assert np.ptp(recording["position"][running]) > 0.55  # of 0.6
    assert np.abs((recording["position_demand"] - recording["position"])[running]).max() < 0.06
    assert "verified" in run("replay", tmp_path / "run.mcap", "--verify").stdout
