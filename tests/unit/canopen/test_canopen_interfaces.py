"""CAN interfaces as the kernel and ``ip`` report them."""

import json

import pytest
from friction_hil_drivers.canopen.wire import interfaces
from friction_hil_drivers.canopen.wire.bus import open_bus
from friction_hil_drivers.canopen.wire.interfaces import Link, check_interface, check_machine, parse

from friction_hil.config import BusConfig
from friction_hil.errors import BusError
from tests.system_files import lay

GOOD = Link("can", 500_000, "ERROR-ACTIVE")


def reported(kind="can", **data):
    """What ``ip -json -details link show`` prints, as far as it matters here."""
    link = {"ifname": "can0", "flags": ["NOARP", "UP"], "linkinfo": {"info_kind": kind, "info_data": data}}
    return json.dumps([link])


@pytest.mark.parametrize(
    ("text", "link"),
    [
        (reported(state="ERROR-ACTIVE", bittiming={"bitrate": 500000, "sample_point": "0.875"}), GOOD),
        (reported(state="ERROR-ACTIVE", bittiming_bitrate=500000, bitrate_const=[125000, 500000]), GOOD),
        (reported(state="STOPPED"), Link("can", None, "STOPPED")),
        (json.dumps([{"ifname": "vcan0", "linkinfo": {"info_kind": "vcan"}}]), Link("vcan")),
        (json.dumps([{"ifname": "eth0"}]), Link()),
        ("[]", Link()),
        ("", Link()),
        ("Option '-json' is unknown", Link()),
        ('{"linkinfo": []}', Link()),
    ],
)
def test_what_ip_prints(text, link):
    assert parse(text) == link


def interface(root, name="can0", *, is_up=True, kind="280"):
    return lay(root, **{f"sys__class__net__{name}__type": kind, f"sys__class__net__{name}__flags": hex(0x40C0 | is_up)})


def test_each_can_interface_is_reported_and_no_other(tmp_path):
    asked = []

    def check(link=GOOD):
        asked.clear()
        return [
            (one.check, one.result, one.detail, one.fix)
            for one in check_machine(tmp_path, lambda name: asked.append(name) or link)
        ]

    [(checked, result, _, fix)] = check()
    assert (checked, result) == ("CAN interfaces", "warn")
    assert fix.endswith("modprobe vcan && ip link add dev vcan0 type vcan && ip link set vcan0 up")
    interface(tmp_path)
    assert check(Link("can", 500_000, "BUS-OFF"))[0][1] == "warn", "no configuration needs it yet"
    interface(tmp_path, "can1", is_up=False)
    interface(tmp_path, "eth0", kind="1")
    up, down = check()
    assert asked == ["can0", "can1"] == interfaces.can_interfaces(tmp_path)
    assert up[:3] == ("CAN interface can0", "pass", "up, 500000 bit/s, ERROR-ACTIVE")
    assert (*down[:2], down[3]) == ("CAN interface can1", "warn", "ip link set can1 up type can bitrate 500000")
    found = check_interface("vcan3", Link("vcan"), None, interface(tmp_path, "vcan3", is_up=False))
    assert (found.result, found.fix) == ("warn", "ip link set vcan3 up"), "brought up, not made"


@pytest.mark.parametrize(
    ("link", "bitrate", "result", "text"),
    [
        (GOOD, 500_000, "pass", "up, 500000 bit/s, ERROR-ACTIVE"),
        (GOOD, None, "pass", "up, 500000 bit/s, ERROR-ACTIVE"),
        (GOOD, 1_000_000, "fail", "it runs at 500000 bit/s, the configuration says 1000000"),
        (Link("can", 500_000, "BUS-OFF"), 500_000, "fail", "BUS-OFF"),
        (Link("can", 500_000, "ERROR-PASSIVE"), 500_000, "warn", "ERROR-PASSIVE"),
        (Link(), 500_000, "warn", "bit rate not reported by this system"),
        (Link("vcan"), None, "pass", "up"),
    ],
)
def test_an_interface_beside_its_configuration(tmp_path, link, bitrate, result, text):
    found = check_interface("can0", link, bitrate, interface(tmp_path))
    assert found.result == result
    assert text in found.detail
    assert bool(found.fix) == (result != "pass")


@pytest.mark.parametrize(
    ("name", "fix"),
    [
        ("vcan77", "bring it up with: ip link add dev vcan77 type vcan && ip link set vcan77 up"),
        ("can77", "plug the adapter in, then: ip link set can77 up type can bitrate 250000"),
    ],
)
def test_a_bus_without_its_interface_says_what_makes_one(name, fix):
    config = BusConfig(interface="socketcan", channel=name, bitrate=250_000)
    with pytest.raises(BusError, match=f"there is no interface {name}; CAN interfaces of this machine: ") as caught:
        open_bus(config)
    assert caught.value.fix == fix
