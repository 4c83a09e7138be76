"""SIGKILL to the daemon while an axis turns: the drive, which looks at RPDO timers at SYNC only, loses its torque.

Times are read from the time stamps of the drive's own frames on the bus, relative to the last frame of the daemon, so
that a busy machine makes no difference to what is measured: the drive counts from the last frame that it got.
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
OF_DAEMON = (0x080, 0x201, 0x501, 0x77E)  # SYNC, RPDO 1 and 4, heartbeat
READ_STATUSWORD = b"\x40\x41\x60\0\0\0\0\0"
ENABLED, FAULT, TURNING = 0x27, 0x08, 150  # state bits; cycles enabled before the kill
ATTEMPTS = 6  # on a machine so busy that a run ends before it is killed
SLACK_MS = 25.0  # for processes that are served late on a machine with two cores
ONE_RPDO_WITHOUT_TIMER = {
    "missing": [0x1401, 0x1402, 0x1403],
    "sdo": [{"index": 0x1400, "subindex": 5, "abort": 0x06090011}],
}
MEANS = {
    "rpdo": ({}, 20.0, "RPDO 4 within 20 ms", 0x8250),
    "heartbeat": (ONE_RPDO_WITHOUT_TIMER, 20.0, "heartbeat (1016h:01) within 20 ms", 0x8130),
    "guarding": (
        {**ONE_RPDO_WITHOUT_TIMER, "missing": [0x1016, *ONE_RPDO_WITHOUT_TIMER["missing"]]},
        20.0,
        "node guarding (100Ch, 100Dh) within 20 ms",
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
    """Kill the daemon once the axis has turned for a while; return the next error code, and its time in ms.

    The time counts from the daemon's last frame. None: the run ended before.
    """
    turning, last_s = 0, 0.0
    while (message := bus.recv(8.0)) is not None:
        if turning <= TURNING and daemon.poll() is not None:
            return None
        can_id, data = message.arbitration_id, bytes(message.data)
        if can_id in OF_DAEMON or message.is_remote_frame:
            last_s = message.timestamp
        elif can_id == EMERGENCY and turning > TURNING and (code := struct.unpack_from("<H", data)[0]):
            return code, 1e3 * (message.timestamp - last_s)
        elif can_id == TPDO1 and turning <= TURNING:
            turning += struct.unpack_from("<H", data)[0] & 0x6F == ENABLED
            if turning > TURNING:
                daemon.send_signal(signal.SIGKILL)
    assert turning <= TURNING, "the bus fell silent without an emergency"
    return None


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


def attempt(path, words):
    """Run, kill, and look at the drive; return the error code and its time, None if the run ended before."""
    with drives_in_real_time(path), listening(path) as bus:
        daemon = start("run", path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            found = emergency_after_kill(bus, daemon)
            if found is not None:
                assert state_by_sdo(bus) == FAULT
                assert words in "".join(daemon.communicate(timeout=20))
            return found
        finally:
            daemon.kill()
            daemon.wait(20)


@pytest.mark.parametrize("means", MEANS)
def test_a_killed_daemon_leaves_no_torque(tmp_path, means):
    manners, within_ms, words, error = MEANS[means]
    path = write_configuration(tmp_path, x=axis(manners))
    found = None
    for _ in range(ATTEMPTS):
        found = found or attempt(path, words)
    assert found is not None, "the machine is too busy for a run of a quarter of a second"
    code, after_ms = found
    assert f"{code:04X}h" == f"{error:04X}h"
    assert after_ms <= within_ms + SLACK_MS
