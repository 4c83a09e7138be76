"""A daemon is killed while it moves a drive; the next run leaves the drive as the first one found it."""

import json
import signal
import struct
import tempfile
import time
from pathlib import Path

import can
import yaml

from tests.processes import listening, run, run_daemon, simulated_drives, start_daemon, write_configuration

NODE = 1
ENABLED, STATE_BITS = 0x27, 0x6F
RECORDS = [base + number for base in (0x1400, 0x1800) for number in range(4)]
SETTINGS = [
    *((record, subindex) for record in RECORDS for subindex in (1, 2, 5)),
    *((record + 0x200, 0) for record in RECORDS),
    *((record + 0x200, position) for record in RECORDS for position in (1, 2, 3, 4)),
    *((index, 0) for index in (0x1017, 0x6007, 0x605A, 0x6060)),
    *((index, subindex) for index in (0x1016, 0x60C2) for subindex in (1, 2)),
]
OF_THE_USER = ["2b17100000000000", "2b5a600002000000", "2f60600009000000", "2fc2600104000000", "2b00180532000000"]


def ask(bus: can.BusABC, request: bytes) -> bytes:
    """Send a request to the SDO server; return its answer."""
    while bus.recv(0.0) is not None:
        pass
    bus.send(can.Message(arbitration_id=0x600 + NODE, data=request, is_extended_id=False))
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == 0x580 + NODE and message.data[1:4] == request[1:4]:
            return bytes(message.data)
    raise AssertionError("no answer within 30 s")


def settings(bus: can.BusABC) -> dict[tuple[int, int], str]:
    """What the drive holds; of a mapping, the entries that count."""
    held = {address: ask(bus, struct.pack("<BHB4x", 0x40, *address)) for address in SETTINGS}
    return {
        (index, subindex): answer.hex()
        for (index, subindex), answer in held.items()
        if not (index - 0x200 in RECORDS and subindex > held[index, 0][4])
    }


def journals(configuration: Path) -> list[Path]:
    """What daemons have kept of the drives on this bus."""
    port = str(yaml.safe_load(configuration.read_text())["bus"]["port"])
    return [path for path in Path(tempfile.gettempdir()).glob("friction_hil-*.json") if port in path.name]


def test_the_run_after_a_kill_leaves_the_drive_as_it_was_found(tmp_path: Path) -> None:
    configuration = write_configuration(tmp_path, x={"node": NODE, "mode": "csp"})
    with simulated_drives(configuration), listening(configuration) as bus:
        for request in OF_THE_USER:
            ask(bus, bytes.fromhex(request))
        found = settings(bus)
        daemon = start_daemon(configuration)
        state = 0
        while state & STATE_BITS != ENABLED:
            message = bus.recv(60.0)
            assert message is not None, "the daemon enables the drive"
            state = message.data[0] if message.arbitration_id == 0x180 + NODE and message.data else 0
        daemon.send_signal(signal.SIGKILL)
        daemon.communicate(timeout=10.0)
        assert settings(bus) != found
        assert len(journals(configuration)) == 1
        # time stands still in this drive without SYNC, and its watchdogs with it
        refused = run("run", configuration, "--pace", "sync", "--duration", 0.1, check=False)
        assert "friction-hil stop" in refused.stderr
        stopped = json.loads(run("drives", "stop", configuration, "--json").stdout)
        assert [each["result"] for each in stopped["drives"]] == ["stopped"]
        result, done = run_daemon(configuration, "--duration", 0.1)
        assert result["faults"] == []
        assert "ended without restoring" in done.stderr + done.stdout
        assert settings(bus) == found
        assert journals(configuration) == []
