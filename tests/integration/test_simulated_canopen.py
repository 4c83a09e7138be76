"""``friction-hil simulate`` as a process on a real bus, met by raw frames through python-can."""

import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from friction_hil.cli import main
from tests.launcher import start
from tests.processes import free_port, multicast_bus

GROUP = "239.74.163.2"
INERTIA, FRICTION, RATED = 2e-4, 0.02, 0.5
COUNTS = 1 << 22
PATIENCE_S = 60.0  # nothing here is timed: this only ends a test that hangs


def configuration(port: int, **bus: Any) -> dict[str, Any]:
    simulation = {
        "mechanics": {"inertia": INERTIA},
        "friction": {"model": "coulomb", "parameters": {"coulomb": FRICTION}},
        "encoder": {"counts": COUNTS},
        "motor": {"rated_torque": RATED, "peak_torque": 1.0},
        "canopen": {"vendor_id": 0x1234, "serial": 77},
    }
    axis = {
        "driver": "canopen",
        "mode": "cst",
        "limits": {"torque": 0.3, "velocity": 100.0},
        "model": {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": FRICTION}}},
        "trajectory": {"kind": "none"},
    }
    return {
        "version": 1,
        "period_s": 1e-3,
        "bus": bus or {"interface": "udp_multicast", "channel": GROUP, "port": port},
        "axes": {
            "x": {**axis, "node": 1, "simulation": simulation},
            "y": {**axis, "node": 2, "simulation": {}},
        },
        "realtime": {"priority": 0},
    }


def command(path: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "friction_hil", "simulate", str(path), *options]


class Drives:
    """A simulation process, and a master that knows nothing but CAN frames."""

    def __init__(self, folder: Path, pace: str) -> None:
        port = free_port()
        path = folder / "axes.yaml"
        path.write_text(yaml.safe_dump(configuration(port)))
        self.bus = multicast_bus(GROUP, port)
        self.process = start(
            *("simulate", path, "--pace", pace, "--exit-with-stdin"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert self.process.stdout is not None
        self.ready = self.process.stdout.readline()
        assert self.ready, self.process.communicate()[1]
        self.port = port

    def close(self) -> int:
        _, errors = self.process.communicate(timeout=PATIENCE_S)  # closes standard input
        self.bus.shutdown()
        assert errors == ""
        return self.process.returncode

    def send(self, can_id: int, data: bytes | str = b"") -> None:
        data = bytes.fromhex(data) if isinstance(data, str) else data
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def expect(self, can_id: int) -> bytes:
        """Data of the next frame with this identifier."""
        while (message := self.bus.recv(PATIENCE_S)) is not None:
            if message.arbitration_id == can_id:
                return bytes(message.data)
        raise AssertionError(f"no frame {can_id:03X}h came")

    def collect(self, last: int) -> list[tuple[int, bytes]]:
        """All frames up to the next one with the identifier ``last``."""
        frames: list[tuple[int, bytes]] = []
        while (message := self.bus.recv(PATIENCE_S)) is not None:
            frames.append((message.arbitration_id, bytes(message.data)))
            if message.arbitration_id == last:
                return frames
        raise AssertionError(f"no frame {last:03X}h came, but {frames}")

    def ask(self, request: bytes | str, node: int = 1) -> bytes:
        self.send(0x600 + node, request)
        return self.expect(0x580 + node)

    def write(self, index: int, subindex: int, code: str, value: int, node: int = 1) -> None:
        data = struct.pack(f"<{code}", value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex)
        assert self.ask(head + data.ljust(4, b"\0"), node)[:4] == b"\x60" + head[1:]

    def map(self, parameter: int, cob_id: int, words: list[int], node: int = 1) -> None:
        mapping = parameter + 0x200
        self.write(parameter, 1, "I", 0x80000000 | cob_id, node)
        self.write(mapping, 0, "B", 0, node)
        for position, word in enumerate(words, 1):
            self.write(mapping, position, "I", word, node)
        self.write(mapping, 0, "B", len(words), node)
        self.write(parameter, 2, "B", 1, node)
        self.write(parameter, 1, "I", cob_id, node)

    def reset(self) -> None:
        self.send(0x000, "81 00")
        assert self.expect(0x702) == b"\0"

    def start(self, node: int = 1) -> None:
        """Torque in and speed out with every SYNC, enabled by the controlword in the same RPDO."""
        self.map(0x1400, 0x200 + node, [0x60400010, 0x60710010], node)
        self.map(0x1800, 0x180 + node, [0x60410010, 0x606C0020, 0x60740010], node)
        self.write(0x6060, 0, "b", 10, node)
        self.send(0x000, bytes([0x01, node]))

    def cycle(self, word: int | None, torque: int = 0, node: int = 1) -> tuple[int, float, int]:
        """Set-point (none: silence) and SYNC; statusword, speed in rad/s and torque demand that come back."""
        if word is not None:
            self.send(0x200 + node, struct.pack("<Hh", word, torque))
        self.send(0x080)
        statusword, speed, demand = struct.unpack("<Hih", self.expect(0x180 + node))
        return statusword, speed * 2.0 * 3.141592653589793 / COUNTS, demand

    def enable(self) -> None:
        for word in (0x06, 0x07, 0x0F, 0x0F):
            statusword, _, _ = self.cycle(word)
        assert statusword & 0x6F == 0x27


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drives]:
    drives = Drives(tmp_path_factory.mktemp("simulated"), "sync")
    yield drives
    assert drives.close() == 0


@pytest.fixture
def drives(process: Drives) -> Drives:
    process.reset()
    return process


def test_ready_line_and_boot_up(process: Drives) -> None:
    assert process.ready == f"ready: x=node 1, y=node 2 on udp_multicast {GROUP}:{process.port}\n"
    asked = bytes.fromhex("4000100000000000")  # is there somebody of this number?
    assert process.collect(0x702) == [(0x601, asked), (0x602, asked), (0x701, b"\0"), (0x702, b"\0")]


def test_identity_and_wrong_sizes(drives: Drives) -> None:
    assert drives.ask("40 18 10 01 00 00 00 00") == bytes.fromhex("43 18 10 01 34 12 00 00")
    assert drives.ask("40 18 10 04 00 00 00 00") == bytes.fromhex("43 18 10 04 4d 00 00 00")
    assert drives.ask("40 18 10 04 00 00 00 00", node=2) == bytes.fromhex("43 18 10 04 02 00 00 00")
    assert drives.ask("40 76 60 00 00 00 00 00") == bytes.fromhex("43 76 60 00 f4 01 00 00")
    assert drives.ask("23 71 60 00 00 00 00 00") == bytes.fromhex("80 71 60 00 10 00 07 06")
    assert drives.ask("2f 71 60 00 00 00 00 00") == bytes.fromhex("80 71 60 00 10 00 07 06")


def test_frames_of_other_kinds_are_no_business_of_the_drives(drives: Drives) -> None:
    request = bytes.fromhex("40 00 10 00 00 00 00 00")
    drives.bus.send(can.Message(arbitration_id=0x601, data=request, is_extended_id=True))
    drives.bus.send(can.Message(arbitration_id=0x601, is_remote_frame=True, dlc=8, is_extended_id=False))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        stranger.sendto(b"no CAN frame", (GROUP, drives.port))
        stranger.sendto(b"", (GROUP, drives.port))
    drives.send(0x601, "40 18 10 02 00 00 00 00")
    answers = []
    while not answers:
        try:
            message = drives.bus.recv(PATIENCE_S)
        except can.CanOperationError:  # python-can's own opinion of the stranger's datagrams
            continue
        assert message is not None
        answers += [bytes(message.data)] * (message.arbitration_id == 0x581)
    assert answers == [bytes.fromhex("43 18 10 02 02 04 00 00")], "the answer to the proper frame alone"


def test_torque_step_accelerates_the_axis_as_newton_says(drives: Drives) -> None:
    drives.start()
    drives.enable()
    per_mille = 200
    for _ in range(10):
        drives.cycle(0x0F, per_mille)
    _, before, _ = drives.cycle(0x0F, per_mille)
    for _ in range(20):
        _, after, demand = drives.cycle(0x0F, per_mille)
    expected = (per_mille / 1000 * RATED - FRICTION) / INERTIA
    assert (after - before) / 20e-3 == pytest.approx(expected, rel=0.005)
    assert demand == per_mille
    for _ in range(20):
        statusword, _, demand = drives.cycle(0x00, per_mille)
    assert (statusword & 0x6F, demand) == (0x40, 0)


def test_lost_heartbeat_takes_the_torque_away(drives: Drives) -> None:
    drives.write(0x1016, 1, "I", 126 << 16 | 30)
    drives.write(0x1029, 1, "B", 1)
    drives.start()
    drives.send(0x77E, b"\x05")
    drives.enable()
    for cycle in range(60):
        if cycle % 20 == 0:
            drives.send(0x77E, b"\x05")
        statusword, _, demand = drives.cycle(0x0F, 100)
    assert (statusword & 0x6F, demand) == (0x27, 100)
    for _ in range(200):  # torque goes on, the heartbeat does not
        statusword, speed, demand = drives.cycle(0x0F, 100)
    assert statusword & 0x4F == 0x08
    assert (abs(speed) < 0.2, demand) == (True, 0)
    assert drives.ask("40 03 10 01 00 00 00 00") == bytes.fromhex("43 03 10 01 30 81 00 00")


def test_lost_heartbeat_is_an_emergency(drives: Drives) -> None:
    drives.write(0x1016, 1, "I", 126 << 16 | 30)
    drives.send(0x77E, b"\x05")
    for _ in range(30):
        drives.send(0x080)
    assert drives.expect(0x081) == bytes.fromhex("30 81 11 00 00 00 00 00")


def test_silent_master_takes_the_torque_away(drives: Drives) -> None:
    drives.write(0x1400, 5, "H", 20)
    drives.start()
    drives.enable()
    for _ in range(20):
        drives.cycle(0x0F, 100)
    for _ in range(200):
        statusword, speed, demand = drives.cycle(None)
    assert statusword & 0x4F == 0x08
    assert (abs(speed) < 0.2, demand) == (True, 0)
    history = drives.ask("40 03 10 01 00 00 00 00")
    assert history == bytes.fromhex("43 03 10 01 50 82 00 00")


def test_axes_are_independent(drives: Drives) -> None:
    drives.start(1)
    drives.start(2)
    drives.enable()
    for _ in range(20):
        drives.send(0x202, struct.pack("<Hh", 0x0F, 500))
        drives.cycle(0x0F, 100)
    statusword, speed, _ = drives.cycle(0x0F, 100, node=2)
    assert (statusword & 0x6F, speed) == (0x40, 0.0)


def test_same_frames_same_bytes(tmp_path: Path) -> None:
    def run(target: Drives) -> list[tuple[int, float, int]]:
        target.start()
        target.enable()
        return [target.cycle(0x0F, (37 * cycle) % 200 - 100) for cycle in range(100)]

    runs = []
    for _ in range(2):
        drives = Drives(tmp_path, "sync")
        try:
            runs.append(run(drives))
        finally:
            assert drives.close() == 0
    assert runs[0] == runs[1]


def test_in_real_time_heartbeats_need_no_sync(tmp_path: Path) -> None:
    drives = Drives(tmp_path, "real")
    try:
        drives.write(0x1017, 0, "H", 20)
        for _ in range(3):
            assert drives.collect(0x701)[-1] == (0x701, b"\x7f")
        drives.start()
        drives.enable()
        speed = 0.0
        while speed < 5.0:
            _, speed, _ = drives.cycle(0x0F, 100)
        drives.cycle(0x00)
    finally:
        assert drives.close() == 0


@pytest.mark.deep
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "axes.yaml"
    path.write_text(yaml.safe_dump(configuration(free_port())))
    reader, writer = os.pipe()
    with subprocess.Popen(
        command(path, "--ready-fd", str(writer)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        pass_fds=[writer],
        text=True,
    ) as process:
        os.close(writer)
        with os.fdopen(reader) as stream:
            ready = stream.readline()
        process.send_signal(number)
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert ready.startswith("ready: x=node 1, y=node 2 on udp_multicast")
    assert (process.returncode, output, errors) == (0, ready, "")


@pytest.mark.parametrize(
    ("change", "status", "message"),
    [
        ({"bus": {"interface": "socketcan", "channel": "nocan7"}}, 1, "does not open"),
        ({"bus": {"interface": "socketcann", "channel": "can0"}}, 2, "did you mean 'socketcan'"),
        ({"bus": {"interface": "virtual", "channel": "a"}}, 2, "udp_multicast"),
        ({"period_s": 0.0012345}, 2, "whole number of integration steps"),
        ({"axes": {"simulation": None}}, 2, "simulation"),
        ({"axes": {"simulation": {"canopen": {"eds": "nowhere.eds"}}}}, 2, "nowhere.eds"),
        ({"axes": {"simulation": {"encodr": {}}}}, 2, "did you mean 'encoder'"),
    ],
)
def test_mistakes_get_a_clear_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], status: int, message: str
) -> None:
    content = configuration(free_port())
    for name, value in change.items():
        if name == "axes":
            for axis in content["axes"].values():
                axis.update(value)
        else:
            content[name] = value
    path = tmp_path / "axes.yaml"
    path.write_text(yaml.safe_dump(content))
    handler = signal.getsignal(signal.SIGTERM)
    assert main(["simulate", str(path), "--pace", "sync"]) == status
    output, errors = capsys.readouterr()
    assert message in errors
    assert "Traceback" not in errors
    assert output == ""
    assert signal.getsignal(signal.SIGTERM) is handler
