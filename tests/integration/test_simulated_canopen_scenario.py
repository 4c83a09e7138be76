"""Manners and events of simulated drives, by configuration and command line, with the daemon on the other end."""

from pathlib import Path
from typing import Any

from tests.processes import run_daemon, simulated_drives, write_configuration
from tests.unit.canopen.test_simulated_canopen_vendor_eds import SERVO, pdo, record, variable

FIXED = "".join(
    (
        SERVO.replace(
            pdo(0, is_receive=True, cob_id="$NODEID+0x200", words=[0x60400010, 0x60FF0020]),
            pdo(0, is_receive=True, cob_id="$NODEID+0x200", words=[0x60400010, 0x60710010]),
        ).replace(
            pdo(0, is_receive=False, cob_id="$NODEID+0x40000180", words=[0x60410010, 0x60640020]),
            pdo(0, is_receive=False, cob_id="$NODEID+0x40000180", words=[0x60410010, 0x60640020, 0x60770010]),
        ),
        pdo(1, is_receive=False, cob_id="$NODEID+0x40000280", words=[0x606C0020, 0x60610008]),
        record("608F", variable("608Fsub1", 7, 65536, "ro"), variable("608Fsub2", 7, 1)),
        variable("6076", 7, 500, "ro"),
        variable("60A9", 7, "0x00B44700", "ro"),
        variable("6502", 7, "0x380", "ro"),
        variable("6007", 3, 1),
        record("1016", variable("1016sub0", 5, 1, "ro"), variable("1016sub1", 7, 0), kind=8),
        variable("1017", 6, 0),
    )
)
CST: dict[str, Any] = {
    "mode": "cst",
    "controller": {"position_gain": 20.0, "velocity_gain": 0.02, "integral_hz": 1.0},
}


def scene(folder: Path, **canopen: Any) -> Path:
    return write_configuration(folder, x={"trajectory": {"kind": "hold"}, "simulation": {"canopen": canopen}, **CST})


def test_a_drive_with_a_vendors_eds_and_slow_manners_runs(tmp_path: Path) -> None:
    (tmp_path / "vendor.eds").write_text("[DeviceInfo]\nVendorName=somebody\n" + FIXED)
    path = scene(
        tmp_path,
        eds="vendor.eds",
        sdo_delay_s=0.005,
        sdo=[{"index": 0x6502, "delay_s": 0.2, "times": 1}],
        switch_on_s=0.1,
        enable_s=0.2,
        controlword="edge",
        timer_at_sync_only=True,
    )
    with simulated_drives(path):
        _, done = run_daemon(path, "--duration", 1)
    assert "rpm" in done.stderr + done.stdout


def test_what_the_file_says_wrongly_is_told_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "vendor.eds").write_text("[DeviceInfo]\nVendorName=somebody\n" + FIXED + variable("2000", 5, 300))
    path = scene(tmp_path, eds="vendor.eds")
    with simulated_drives(path) as process:
        assert process.stdout.readline() == "note: x: 2000h:00: the default 300 does not fit its type; 44 is used\n"
