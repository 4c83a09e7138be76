"""``friction-hil drives``: on servo drives of an independent stack, and on drives that a killed daemon left enabled."""

import json
import time
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from tests.durand_process import durand_configuration, durand_drives
from tests.peers.plc_master import PlcMaster
from tests.processes import listening, run


def bus_of(configuration: Path) -> str:
    bus = yaml.safe_load(configuration.read_text())["bus"]
    return f"{bus['interface']}:{bus['channel']}:{bus['port']}"


def told(*words: object, check: bool = True) -> Any:
    return json.loads(run("drives", *words, "--json", check=check).stdout)


def write_frame(bus: can.BusABC, can_id: int, data: bytes) -> None:
    bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


def enable(bus: can.BusABC, node: int, target: bytes) -> None:
    """Turn a drive by SDO alone, in csv, with nobody who watches it."""
    for request in (
        "2f60600009000000",
        "2b40600006000000",
        "2b40600007000000",
        "2b4060000f000000",
    ):
        write_frame(bus, 0x600 + node, bytes.fromhex(request))
        time.sleep(0.02)
    write_frame(bus, 0x600 + node, bytes.fromhex("23ff6000") + target)


def test_scan_finds_the_nodes_and_writes_nothing(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path, nodes=(1, 5))
    with durand_drives(configuration), listening(configuration) as bus:
        found = told("scan", "--bus", bus_of(configuration))
        frames = list(iter(lambda: bus.recv(0.0), None))
    assert [entry["node"] for entry in found["drives"]] == [1, 5]
    [first, _] = found["drives"]
    assert first["name"] == "durand servo"
    assert (first["vendor_id"], first["product_code"], first["serial"]) == (0x7EE7, 0x0402, 1001)
    assert (first["profile"], first["state"], first["is_powered"]) == (402, "switch on disabled", False)
    assert first["modes"] == ["csp", "csv", "cst"]
    assert found["notes"] == []
    for message in frames:
        sent_by_drive = 0x580 < message.arbitration_id < 0x600
        assert sent_by_drive or message.arbitration_id & 0x780 == 0x600, message
        assert sent_by_drive or message.data[0] in (0x40, 0x60, 0x70), "an upload"


def test_show_tells_units_mapping_watchdogs_and_the_way_of_the_compensation(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path)
    with durand_drives(configuration, "--rpm", "--missing", "60B2"):
        shown = told("show", configuration, 1)
        text = run("drives", "show", configuration, 1).stdout
    assert shown["units"]["velocity_unit"] == "1/min"
    assert shown["units"]["counts_per_revolution"] == 65536.0
    assert shown["units"]["rated_torque_Nm"] == 0.64
    first = shown["mapping"][0]
    assert (first["pdo"], first["cob_id"], first["transmission_type"]) == ("RPDO 1", 0x201, 255)
    assert [entry["index"] for entry in first["entries"]] == [0x6040]
    assert shown["watchdogs"]["reaction"] == "fault"
    assert shown["compensation"]["csp"]["object"] is None
    assert shown["compensation"]["cst"]["object"].startswith("6071h")
    assert "RPDO 1 201h on, type 255 (event-driven): 6040h controlword (16 bits)" in text
    assert "csp: no object for it in this drive" in text
    assert "vendor_id 0x7ee7" in text


def test_stop_takes_the_power_and_reads_it_back_in_pre_operational(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path, nodes=(1, 2))
    with durand_drives(configuration) as drives, listening(configuration) as bus:
        enable(bus, 1, (200_000).to_bytes(4, "little"))
        drives.wait_for(lambda event: event.what == "OPERATION_ENABLED torque")
        answer = told("stop", "--bus", bus_of(configuration))
        assert drives.is_free
    assert [(each["node"], each["result"]) for each in answer["drives"]] == [(1, "stopped"), (2, "unpowered")]
    assert answer["drives"][0]["before"] == "operation enabled"
    states = [what.split()[0] for what in drives.told(1)]
    assert states.index("QUICK_STOP_ACTIVE") < len(states) - 1 - states[::-1].index("SWITCH_ON_DISABLED")


def test_stop_calls_unknown_what_does_not_answer(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path)
    with durand_drives(configuration):
        done = run("drives", "stop", configuration, 1, 7, "--json", check=False)
        silent = run("drives", "show", configuration, 7, check=False)
    assert done.returncode == 1
    assert [each["result"] for each in json.loads(done.stdout)["drives"]] == ["unpowered", "unknown"]
    assert silent.returncode == 1
    assert "FH-244" in silent.stderr


def test_stop_says_that_another_master_is_there_and_stops_all_the_same(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path)
    with durand_drives(configuration) as drives, listening(configuration) as bus:
        enable(bus, 1, (200_000).to_bytes(4, "little"))
        task = bus.send_periodic(can.Message(arbitration_id=0x80, is_extended_id=False), 0.02)
        answer = told("stop", configuration)
        task.stop()
        assert drives.is_free
    assert [each["result"] for each in answer["drives"]] == ["stopped"]
    assert any("SYNC" in note for note in answer["notes"])


def test_stop_does_not_say_stopped_where_another_master_enables_the_drive_again(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path)
    bus = yaml.safe_load(configuration.read_text())["bus"]
    with durand_drives(configuration), PlcMaster(bus, 1):
        done = run("drives", "stop", configuration, "--json", check=False)
    assert done.returncode == 1
    assert [each["result"] for each in json.loads(done.stdout)["drives"]] == ["powered"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["scan"], "--bus"),
        (["scan", "--bus", "udp_multicast:239.1.1.1:banana"], "port"),
        (["stop", "--bus", "socketcan:"], "--bus"),
        (["show", "--bus", "virtual:x"], "NODE"),
        (["stop", "200", "--bus", "virtual:x"], "1 to 127"),
    ],
)
def test_wrong_use_is_explained(words: list[str], reason: str) -> None:
    done = run("drives", *words, check=False)
    assert done.returncode == 2
    assert reason in done.stderr
