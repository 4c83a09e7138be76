"""``friction-hil simulate`` as a process on a real bus, met by raw frames through python-can."""

import os
import signal
import socket
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

    def collect(self, last: int) -> list[tuple[int, bytes]]:
        """All frames up to the next one with the identifier ``last``."""
        frames: list[tuple[int, bytes]] = []
        while (message := self.bus.recv(PATIENCE_S)) is not None:
            frames.append((message.arbitration_id, bytes(message.data)))
            if message.arbitration_id == last:
                return frames
        raise AssertionError(f"no frame {last:03X}h came, but {frames}")


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drives]:
    drives = Drives(tmp_path_factory.mktemp("simulated"), "sync")
    yield drives
    assert drives.close() == 0


def test_ready_line_and_boot_up(process: Drives) -> None:
    assert process.ready == f"ready: x=node 1, y=node 2 on udp_multicast {GROUP}:{process.port}\n"
    asked = bytes.fromhex("4000100000000000")  # is there somebody of this number?
    assert process.collect(0x702) == [(0x601, asked), (0x602, asked), (0x701, b"\0"), (0x702, b"\0")]


def test_frames_of_other_kinds_are_no_business_of_the_drives(process: Drives) -> None:
    request = bytes.fromhex("40 00 10 00 00 00 00 00")
    process.bus.send(can.Message(arbitration_id=0x601, data=request, is_extended_id=True))
    process.bus.send(can.Message(arbitration_id=0x601, is_remote_frame=True, dlc=8, is_extended_id=False))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        stranger.sendto(b"no CAN frame", (GROUP, process.port))
        stranger.sendto(b"", (GROUP, process.port))
    process.send(0x601, "40 18 10 02 00 00 00 00")
    answers = []
    while not answers:
        try:
            message = process.bus.recv(PATIENCE_S)
        except can.CanOperationError:  # python-can's own opinion of the stranger's datagrams
            continue
        assert message is not None
        answers += [bytes(message.data)] * (message.arbitration_id == 0x581)
    assert answers == [bytes.fromhex("43 18 10 02 02 04 00 00")], "the answer to the proper frame alone"


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
