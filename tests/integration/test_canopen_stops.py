"""Stops that RPDOs do not bring about: the daemon and simulated drives as processes, in real time, on udp_multicast."""

import contextlib
import json
import re
import struct
import subprocess
from pathlib import Path
from typing import Any

import can
import pytest

from tests.launcher import start
from tests.loop_run import MODES
from tests.processes import listening, write_configuration

PERIOD_S = 5e-3  # long, for a machine that is busy with other tests
HEARTBEAT_S = 0.2
PRE_OPERATIONAL, STOP, RESET_NODE = 0x80, 0x02, 0x81
SDO_REQUEST, SDO_ANSWER, RPDO1 = 0x601, 0x581, 0x201
CONTROLWORD, STATUSWORD, POSITION, VELOCITY = 0x6040, 0x6041, 0x6064, 0x606C
COUNTS_PER_RAD = 2**20 / 6.283185307179586


def axis(mode: str, node: int, **manners: Any) -> dict[str, Any]:
    """An axis that moves to and fro; its drive goes on with its last set-point when its node leaves Operational."""
    changes: dict[str, Any] = {
        "node": node,
        "heartbeat_s": HEARTBEAT_S,
        "limits": {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "position": [-4.0, 4.0]},
        "trajectory": {"kind": "sine", "amplitude": 1.0, "frequency": 0.5, "ramp_s": 0.25},
        "simulation": {"canopen": {"nmt_stops_drive": False, **manners}},
    }
    if mode == "cst":
        changes["controller"] = {"position_gain": 8.0, "velocity_gain": 5e-3}
    elif mode == "csv":
        changes["controller"] = {"position_gain": 10.0}
    return {**MODES[mode], **changes, "mode": mode}


class Rig:
    """Drives and daemon, and a listener on their bus."""

    def __init__(
        self, folder: Path, stack: contextlib.ExitStack, *, max_missed: int = 40, **axes: dict[str, Any]
    ) -> None:
        self.path = write_configuration(folder, period_s=PERIOD_S, **axes)
        text = self.path.read_text().replace("priority: 0", f"max_missed: {max_missed}\n  priority: 0")
        self.path.write_text(text)
        simulation = start(*("simulate", self.path, "--exit-with-stdin"), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        stack.callback(simulation.wait, 30)
        assert simulation.stdin is not None
        assert simulation.stdout is not None
        stack.callback(simulation.stdout.close)
        stack.callback(simulation.stdin.close)
        assert simulation.stdout.readline().startswith("ready:")
        self.bus = stack.enter_context(listening(self.path))
        words = ("run", self.path, "--json", "--duration", "20")
        self.daemon = start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        stack.callback(self.daemon.wait, 30)
        stack.callback(self.daemon.kill)
        self.frames: list[can.Message] = []

    def listen(self, is_last: Any, timeout_s: float = 60.0) -> can.Message:
        """Keep frames up to one for which ``is_last``."""
        while (message := self.bus.recv(timeout_s)) is not None:
            self.frames.append(message)
            if is_last(message):
                return message
        raise AssertionError(f"no such frame within {timeout_s} s")

    def run_until_it_moves(self, node: int = 1) -> None:
        """Wait until the axis is far from its start and fast: an RPDO enables, and the position has changed."""
        tpdo, began = 0x180 + node, None
        while True:
            data = self.listen(lambda message: message.arbitration_id == tpdo).data
            word, position = struct.unpack_from("<Hi", data)
            began = position if began is None else began
            if word & 0x6F == 0x27 and abs(position - began) > 0.5 * COUNTS_PER_RAD:
                return

    def nmt(self, command: int, node: int = 1) -> None:
        self.frames.clear()
        self.bus.send(can.Message(arbitration_id=0, data=[command, node], is_extended_id=False))

    def result(self) -> dict[str, Any]:
        """The daemon's JSON; frames are kept meanwhile."""
        while self.daemon.poll() is None:
            if (message := self.bus.recv(0.05)) is not None:
                self.frames.append(message)
        assert self.daemon.stdout is not None
        assert self.daemon.stderr is not None
        output, errors = self.daemon.stdout.read(), self.daemon.stderr.read()
        assert output, errors
        result: dict[str, Any] = json.loads(output)
        result["exit"] = self.daemon.returncode
        return result

    def read(self, index: int, code: str, node: int = 1) -> int:
        request = struct.pack("<BHB4x", 0x40, index, 0)
        self.bus.send(can.Message(arbitration_id=0x600 + node, data=request, is_extended_id=False))
        answer = self.listen(
            lambda message: message.arbitration_id == 0x580 + node and message.data[1:4] == request[1:4]
        )
        return int(struct.unpack_from(f"<{code}", answer.data, 4)[0])

    def after(self, can_id: int, start_s: float) -> list[can.Message]:
        return [frame for frame in self.frames if frame.arbitration_id == can_id and frame.timestamp > start_s]


def messages(result: dict[str, Any], *kinds: str) -> list[str]:
    """Messages of a run, without the words on what a busy machine missed shortly before: these belong to no test."""
    missed = r"; \d+ periods? (was|were) missed .* before"
    return [re.sub(missed, "", message) for kind in kinds for message in result[kind]]


def is_quick_stop(frame: can.Message) -> bool:
    by_sdo = frame.arbitration_id == SDO_REQUEST and bytes(frame.data) == bytes.fromhex("2b40600002000000")
    return by_sdo or (frame.arbitration_id == RPDO1 and frame.data[:2] == b"\x02\x00")


@pytest.mark.deep
@pytest.mark.parametrize("command", [PRE_OPERATIONAL, STOP])
@pytest.mark.parametrize("mode", MODES)
def test_an_axis_whose_node_is_taken_out_of_operational_is_stopped_for_certain(
    tmp_path: Path, mode: str, command: int
) -> None:
    with contextlib.ExitStack() as stack:
        rig = Rig(tmp_path, stack, x=axis(mode, 1))
        rig.run_until_it_moves()
        before_s = rig.frames[-1].timestamp
        rig.nmt(command)
        result = rig.result()
        assert result["exit"] == 1
        name = "pre-operational" if command == PRE_OPERATIONAL else "stopped"
        cause = f"x: node 1 left Operational: it is {name} [FH-232]"
        faults = messages(result, "faults")
        nmt = [fault for fault in faults if "NMT" in fault and fault.endswith("[FH-220]")]
        # either may be missing: it stood before the next heartbeat, or the multicast bus kept no order of two senders
        assert faults
        assert [fault for fault in faults if fault not in nmt] in ([cause], [])
        assert result["drive_states"] == {"x": "switch on disabled"}
        # the report is true: no power, no motion, and not far from where it was
        assert rig.read(STATUSWORD, "H") & 0x6F == 0x40
        assert abs(rig.read(VELOCITY, "i")) < 0.01 * COUNTS_PER_RAD
        assert abs(rig.read(POSITION, "i")) < 4.0 * COUNTS_PER_RAD
        # at once: quick stop by SDO, or by RPDO once NMT start has brought the node back
        stops = [frame for frame in rig.frames if frame.timestamp > before_s and is_quick_stop(frame)]
        assert stops[0].timestamp - before_s < HEARTBEAT_S + 0.1
        words = [struct.unpack_from("<H", frame.data)[0] for frame in rig.after(RPDO1, stops[0].timestamp)]
        assert 0x0F not in words


@pytest.mark.deep
def test_a_restarted_node_gets_no_rpdo_and_the_other_axis_is_disabled_in_its_own_time(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        rig = Rig(tmp_path, stack, x=axis("csv", 1), y=axis("csv", 2))
        rig.run_until_it_moves()
        rig.nmt(RESET_NODE)
        boot = rig.listen(lambda message: message.arbitration_id == 0x701 and message.data[0] == 0)
        result = rig.result()
        assert result["exit"] == 1
        told = messages(result, "faults", "notices")
        assert any(each.startswith("x: node 1 restarted (boot-up message)") and "[FH-231]" in each for each in told)
        assert "x: another master has appeared on the bus: NMT reset node to node 1 [FH-220]" in told
        assert result["drive_states"] == {"x": "switch on disabled", "y": "switch on disabled"}
        assert not [fault for fault in result["faults"] if "standstill" in fault or "powered" in fault]
        late = [frame for frame in rig.after(RPDO1, boot.timestamp + 0.1) if len(frame.data)]
        assert late == []
        off = next(
            frame
            for frame in rig.after(0x182, boot.timestamp)
            if struct.unpack_from("<H", frame.data)[0] & 0x6F in (0x40, 0x21, 0x23)
        )
        assert off.timestamp - boot.timestamp < 1.0, "the healthy one does not wait for the other"


@pytest.mark.deep
def test_a_drive_that_cannot_be_asked_any_more_is_unknown_and_trips_when_the_heartbeat_ends(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        events = [{"at_s": 2.0, "do": "mute", "for_s": 1000.0}]
        # watchdogs of more than a second: a busy machine does not trip the drive while it can still be asked
        rig = Rig(tmp_path, stack, max_missed=300, x={**axis("csv", 1, events=events), "heartbeat_s": 1.0})
        result = rig.result()
        assert result["exit"] == 1
        assert result["drive_states"] == {"x": "unknown"}
        told = messages(result, "faults", "warnings")
        assert "x: the state of the drive after the stop is unknown: it may have power [FH-120]" in told
        assert not [fault for fault in result["faults"] if "still powered" in fault]
