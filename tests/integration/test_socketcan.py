"""The same end-to-end run on SocketCAN: the kernel's CAN, and the frames read and written on its sockets."""

from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.daemon.safety import LoopState
from friction_hil.replay.verify import verify
from tests.processes import run_daemon, simulated_drives, write_configuration

INTERFACE = "vcan0"
PERIOD_S = 5e-3  # the kernel that tools/vcan-run boots is slow and coarse

pytestmark = [
    pytest.mark.socketcan,
    pytest.mark.skipif(
        not Path("/sys/class/net", INTERFACE).exists(), reason=f"no interface {INTERFACE}; tools/vcan-run has one"
    ),
]


def test_compensation_takes_the_friction_out_on_socketcan(tmp_path):
    axis = {
        "trajectory": {"kind": "sine", "amplitude": 0.5, "frequency": 0.5, "ramp_s": 0.5},
        "compensation": {"baseline_s": 3.5, "fade_s": 0.5},
    }
    bus = {"interface": "socketcan", "channel": INTERFACE}
    configuration = write_configuration(tmp_path, bus=bus, period_s=PERIOD_S, x=axis)
    with simulated_drives(configuration):
        result, _ = run_daemon(configuration, "--duration", 7.0, "--record", tmp_path / "run.mcap")
    assert result["faults"] == []
    recording = fh.recordings.read(tmp_path / "run.mcap")
    moving = recording["state"] == LoopState.RUNNING
    error = (recording["position_demand"] - recording["position"])[moving]
    lap = round(2.0 / PERIOD_S)
    before, after = error[lap // 2 : lap // 2 + lap], error[-lap:]
    assert np.sqrt(np.mean(after**2)) < 0.5 * np.sqrt(np.mean(before**2))
    assert verify(recording).is_verified
