"""SIGKILL to the daemon while an axis turns: the drive, which looks at RPDO timers at SYNC only, loses its torque.

Which watchdog acts is seen by its emergency. How fast stands in tests/unit/canopen/test_kill_figures.py, in simulated
time: here the daemon may be late by a third of a second, so that a busy machine does not end it before it is killed.
"""

import contextlib
import signal
import struct
import subprocess

import can
import pytest

from tests.launcher import start
from tests.processes import listening, write_configuration

NODE, TPDO1, EMERGENCY = 1, 0x181, 0x081
READ_STATUSWORD = b"\x40\x41\x60\0\0\0\0\0"
ENABLED, FAULT, TURNING = 0x27, 0x08, 50  # state bits; cycles enabled before the kill
PERIOD_S, MAX_MISSED = 10e-3, 30
ONE_RPDO_WITHOUT_TIMER = {
    "missing": [0x1401, 0x1402, 0x1403],
    "sdo": [{"index": 0x1400, "subindex": 5, "abort": 0x06090011}],
}
MEANS = {  # manners of the drive, what the daemon says of its watchdog, emergency
    "rpdo": ({}, "RPDO 4 within", 0x8250),
    "heartbeat": (ONE_RPDO_WITHOUT_TIMER, "heartbeat (1016h:01) within", 0x8130),
    "guarding": (
        {**ONE_RPDO_WITHOUT_TIMER, "missing": [0x1016, *ONE_RPDO_WITHOUT_TIMER["missing"]]},
        "node guarding (100Ch, 100Dh) within",
        0x8130,
    ),
}


@contextlib.contextmanager
def drives_in_real_time(configuration):
    process = start(
        *("simulate", configuration, "--exit-with-stdin"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        ready = process.stdout.readline()
        assert ready.startswith("ready:"), process.stderr.read()
        yield
    finally:
        process.stdin.close()
        process.wait(30)
        process.stdout.close()
        process.stderr.close()


def axis(manners):
    return {
        "mode": "csv",
        "limits": {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 5.0},
        "controller": {"position_gain": 5.0},
        "trajectory": {"kind": "sine", "amplitude": 2.0, "frequency": 0.5, "ramp_s": 0.1},
        "simulation": {"canopen": {"timer_at_sync_only": True, **manners}},
    }


def emergency_after_kill(bus, daemon):
    """Kill the daemon once the axis has turned for a while; return the code of the next emergency."""
    turning = 0
    while (message := bus.recv(20.0)) is not None:
        can_id, data = message.arbitration_id, bytes(message.data)
        if can_id == EMERGENCY and turning > TURNING and (code := struct.unpack_from("<H", data)[0]):
            return code
        if can_id == TPDO1 and turning <= TURNING:
            turning += struct.unpack_from("<H", data)[0] & 0x6F == ENABLED
            if turning > TURNING:
                assert daemon.poll() is None, "".join(daemon.communicate(timeout=20))
                daemon.send_signal(signal.SIGKILL)
    daemon.kill()
    said = "".join(daemon.communicate(timeout=20))
    raise AssertionError(f"no emergency; {turning} frames with the drive enabled; the daemon said: {said}")


def state_by_sdo(bus):
    """State bits of the drive, when its fault reaction is over."""
    request = can.Message(arbitration_id=0x600 + NODE, data=READ_STATUSWORD, is_extended_id=False)
    for _ in range(100):
        bus.send(request)
        while True:
            message = bus.recv(5.0)
            assert message is not None, "no answer to SDO"
            if message.arbitration_id == 0x580 + NODE:
                break
        found = struct.unpack_from("<H", bytes(message.data), 4)[0] & 0x4F
        if found == FAULT:
            return found
    return found


@pytest.mark.deep
@pytest.mark.parametrize("means", MEANS)
def test_a_killed_daemon_leaves_no_torque(tmp_path, means):
    manners, words, error = MEANS[means]
    path = write_configuration(tmp_path, period_s=PERIOD_S, x=axis(manners))
    path.write_text(path.read_text().replace("realtime:\n", f"realtime:\n  max_missed: {MAX_MISSED}\n"))
    with drives_in_real_time(path), listening(path) as bus:
        daemon = start("run", path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            assert f"{emergency_after_kill(bus, daemon):04X}h" == f"{error:04X}h"
            assert state_by_sdo(bus) == FAULT
            assert words in "".join(daemon.communicate(timeout=20))
        finally:
            daemon.kill()
            daemon.wait(20)
