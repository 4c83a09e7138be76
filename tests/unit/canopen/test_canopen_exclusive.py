"""One daemon for each axis: the lock of a node belongs to the process that runs, whoever started it."""

import os
import signal
import tempfile

import pytest
from friction_hil_drivers.canopen.commands.inventory import CanopenInventory
from friction_hil_drivers.canopen.wire.exclusive import AxisLock
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil.config.bus import BusConfig
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, BenchBus

NOBODY = 65534


@pytest.fixture
def bus(tmp_path):
    """A bus of this test alone."""
    return BusConfig(interface="socketcan", channel=f"can-{os.getpid()}-{tmp_path.name}")


@pytest.fixture
def hold():
    """Take the lock of node 5 in another process; return its number and how to kill it."""
    left = []

    def kill():
        pid = left.pop()
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)

    def take(bus, user=None):
        read_end, write_end = os.pipe()
        pid = os.fork()
        if pid == 0:
            try:
                if user is not None:
                    os.setuid(user)
                lock = AxisLock(bus, 5, "x")
                os.write(write_end, b"taken")
                signal.pause()
                lock.release()
            finally:
                os._exit(1)
        left.append(pid)
        os.close(write_end)
        with os.fdopen(read_end, "rb") as answer:
            assert answer.read(5) == b"taken"
        return pid, kill

    yield take
    while left:
        kill()


def refusal(bus, node=5):
    """The message for whoever wants an axis that is taken."""
    with pytest.raises(DriveError) as caught:
        AxisLock(bus, node, "x")
    return str(caught.value)


def test_the_lock_belongs_to_who_runs_and_ends_with_it(bus, hold):
    pid, kill = hold(bus)
    assert f"node 5 on socketcan {bus.channel} belongs to another daemon already (process {pid});" in refusal(bus)
    AxisLock(bus, 6, "y").release()
    kill()
    lock = AxisLock(bus, 5, "x")
    assert f"(process {os.getpid()})" in refusal(bus)
    lock.release()
    lock.release()
    AxisLock(bus, 5, "x").release()


def test_no_daemon_can_begin_while_a_fault_is_reset(bus):
    """It would enable the drive that has just been left without power."""

    class Asked(BenchBus):
        def loses(self, can_id, data):
            assert f"process {os.getpid()}" in refusal(bus)
            return False

    own = Asked()
    inventory = CanopenInventory(bus, FrameBus(own, "bench"))
    (stop,) = inventory.reset_axes({"x": (NODE, 0)}).stops
    assert stop.result == "unpowered"
    assert own.sent
    inventory.close()
    own.shutdown()
    AxisLock(bus, NODE, "x").release()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_killed_daemon_of_one_user_shuts_out_nobody(bus, hold):
    pid, kill = hold(bus, NOBODY)
    assert f"(process {pid} of user {NOBODY})" in refusal(bus)
    kill()
    for user in (None, NOBODY - 1, NOBODY):  # None: root
        _, kill = hold(bus, user)
        kill()


def test_the_folder_for_temporary_files_does_not_matter(bus, hold, tmp_path, monkeypatch):
    """Neither one of its own (TMPDIR, PrivateTmp of systemd) nor a link in the way."""
    for name in ("lock", "pid"):
        os.symlink(tmp_path / "victim", tmp_path / f"friction_hil-socketcan-{bus.channel}-5.{name}")
    pid, kill = hold(bus)
    for folder in (tmp_path, tmp_path / "missing"):
        monkeypatch.setattr(tempfile, "tempdir", str(folder))
        assert f"process {pid}" in refusal(bus)
    kill()
    AxisLock(bus, 5, "x").release()
    assert not (tmp_path / "victim").exists()


MULTICAST = {"interface": "udp_multicast", "channel": "239.74.163.177"}


@pytest.mark.parametrize(
    ("written", "other"),
    [
        (MULTICAST, MULTICAST | {"port": 43113}),
        ({"interface": "slcan", "channel": "/dev/null"}, {"interface": "slcan", "channel": "{folder}/by-id@115200"}),
    ],
)
def test_the_same_bus_has_one_lock_however_it_is_written(tmp_path, written, other):
    (tmp_path / "by-id").symlink_to("/dev/null")
    lock = AxisLock(BusConfig(**written), 77, "x")
    other = other | {"channel": other["channel"].format(folder=tmp_path)}
    assert f"process {os.getpid()}" in refusal(BusConfig(**other), 77)
    lock.release()


@pytest.mark.parametrize(
    "other",
    [
        {"interface": "udp_multicast", "channel": "239.74.163.178", "port": 20001},
        {"interface": "udp_multicast", "channel": "239.74.163.178", "port": 20002},
        {"interface": "udp_multicast", "channel": "239.74.163.179", "port": 20001},
        {"interface": "slcan", "channel": "/dev/zero"},
        {"interface": "slcan", "channel": "/dev/" + 200 * "long"},
        {"interface": "slcan", "channel": "/dev/" + 200 * "long" + "er"},
        {"interface": "socketcan", "channel": "can-other"},
    ],
)
def test_other_buses_have_other_locks(other, bus):
    buses = [BusConfig(interface="slcan", channel=f"/dev/{200 * 'long'}est"), bus, BusConfig(**other)]
    locks = [AxisLock(each, 78, "x") for each in buses]
    for each, lock in zip(buses, locks, strict=True):
        assert "FH-204" in refusal(each, 78)
        lock.release()
        AxisLock(each, 78, "x").release()


def test_a_virtual_bus_does_not_leave_its_process(hold):
    virtual = BusConfig(interface="virtual", channel="test-lock")
    hold(virtual)
    lock = AxisLock(virtual, 5, "x")
    assert f"process {os.getpid()}" in refusal(virtual)
    lock.release()
