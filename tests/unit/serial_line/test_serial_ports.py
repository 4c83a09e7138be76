"""Serial ports as the kernel tells them: which there are, who may open them, who has them."""

import grp
import os
import subprocess

import pytest
from friction_hil_drivers.serial_line import ports

from tests.system_files import lay


@pytest.fixture
def port(tmp_path):
    """A machine with one adapter, ttyUSB0."""

    def make(name="ttyUSB0", timer=None, **files):
        lay(tmp_path, **{f"sys__class__tty__{name}__device__uevent": "", f"dev__{name}": ""}, **files)
        if timer is not None:
            lay(tmp_path, **{f"sys__bus__usb-serial__devices__{name}__latency_timer": f"{timer}\n"})
        return tmp_path

    return make


def test_ports_are_those_with_hardware(port):
    root = port()
    port("ttyS0", sys__class__tty__ttyS0__type="4\n")
    port("ttyS1", sys__class__tty__ttyS1__type="0\n")  # room is kept for it, nothing is there
    lay(root, sys__class__tty__tty1__active="")  # a console
    assert ports.serial_ports(root) == ["/dev/ttyS0", "/dev/ttyUSB0"]
    first = next(ports.check_machine(root))
    assert (first.result, first.detail) == ("pass", "/dev/ttyS0, /dev/ttyUSB0")


def test_a_port_that_only_the_kernel_knows_is_not_one_without_permission(port):
    root = port()
    port("ttyACM0")
    (root / "dev" / "ttyACM0").unlink()
    first, right = ports.check_machine(root)
    assert (first.result, first.detail) == ("warn", "/dev/ttyACM0, /dev/ttyUSB0; but /dev has no /dev/ttyACM0")
    assert "--device /dev/ttyACM0" in first.fix
    assert right.result == "pass"


@pytest.mark.parametrize(("user", "groups", "result"), [(1000, (), "warn"), (1000, (20,), "pass"), (0, (), "pass")])
def test_without_ports_the_group_tells_who_may_open_one(tmp_path, monkeypatch, user, groups, result):
    class Dialout:
        gr_name, gr_gid = "dialout", 20

    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(os, "getegid", lambda: 1000)
    monkeypatch.setattr(os, "getgroups", lambda: list(groups))
    monkeypatch.setattr(grp, "getgrall", lambda: [Dialout])
    first, right = ports.check_machine(tmp_path)
    assert (first.check, first.result, right.result) == ("serial ports", "warn", result)
    assert first.fix
    assert ("group dialout" in right.fix) == (result == "warn")


def test_a_port_that_the_user_may_not_open_is_told_with_its_group(port, monkeypatch):
    root = port()
    port("ttyACM0")
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "ttyUSB0")
    monkeypatch.setattr(grp, "getgrgid", lambda number: type("Group", (), {"gr_name": "plugdev"}))
    right = list(ports.check_machine(root))[1]
    assert (right.result, right.detail) == ("warn", "permission denied: /dev/ttyUSB0")
    assert "group plugdev" in right.fix
    monkeypatch.setattr(grp, "getgrgid", lambda number: type("Group", (), {"gr_name": "root"}))
    device = root / "dev" / "ttyUSB0"
    assert f"{device} to the group dialout" in ports.permission_remedy(device), "nobody is to join root"


@pytest.mark.parametrize(("timer", "result"), [(16, "warn"), (2, "warn"), (1, "pass")])
def test_the_latency_of_an_adapter(port, timer, result):
    root = port(timer=timer)
    found = list(ports.check_machine(root))[-1]
    assert (found.check, found.result) == ("latency of ttyUSB0", result)
    assert f"for {timer} ms" in found.detail
    where = "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
    assert found.fix == ("" if result == "pass" else f"as root: echo 1 > {where}")
    assert ports.latency_s("ttyUSB0", root) == pytest.approx(1e-3 * timer)


@pytest.mark.parametrize("timer", [None, "", "soon"])
def test_an_adapter_that_tells_no_latency_has_no_such_check(port, timer):
    root = port(timer=timer)
    assert ports.latency("ttyUSB0", root) is None
    assert ports.latency_s("ttyUSB0", root) is None
    assert [each.check for each in ports.check_machine(root)] == ["serial ports", "right to open serial ports"]


def test_the_process_that_has_a_port_is_named_and_the_drive_behind_it_is_not(tmp_path):
    master, slave = os.openpty()
    link = tmp_path / "line"
    link.symlink_to(os.ttyname(slave))
    started = []
    try:
        assert ports.holders(str(link)) == []  # this process has both ends
        drive = subprocess.Popen(["sleep", "60"], stdin=slave, pass_fds=[master])
        started.append(drive)
        assert ports.holders(str(link)) == []
        other = subprocess.Popen(["sleep", "60"], stdin=slave)
        started.append(other)
        assert ports.holders(str(link)) == [f"process {other.pid}, sleep"]
    finally:
        for process in started:
            process.kill()
            process.wait()
        os.close(master)
        os.close(slave)
