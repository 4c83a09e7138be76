"""A dry run on a bus where another master drives the servo: feedback is shown, and nothing of it is disturbed."""

import contextlib
import json
import struct
import threading
import time
from collections import Counter

import can
import pytest
import yaml

from tests.processes import multicast_bus, run, simulated_drives, write_configuration

NODE, PERIOD_S = 1, 0.01


class Master(threading.Thread):
    """Maps two TPDOs, enables the drive in csv, then streams SYNC and an RPDO; records what others send."""

    def __init__(self, bus):
        super().__init__()
        self.bus = bus
        self.is_ready, self.is_stopping = threading.Event(), threading.Event()
        self.own, self.heard = Counter(), Counter()
        self.downloads = []
        self.velocity = 0

    def run(self):
        self.map(0x1800, 0x1A00, 0x180 + NODE, [0x60410010, 0x60640020, 0x60770010])
        self.map(0x1801, 0x1A01, 0x280 + NODE, [0x606C0020, 0x60610008])
        self.map(0x1400, 0x1600, 0x200 + NODE, [0x60400010, 0x60FF0020])
        self.write(0x60C2, 1, "B", 10)
        self.write(0x6060, 0, "b", 9)
        self.send(0x000, bytes([1, NODE]))
        for word in (6, 7, 15, 15):
            self.cycle(word)
        self.own.clear()
        self.heard.clear()
        self.is_ready.set()
        while not self.is_stopping.is_set():
            self.cycle(15, 200_000)

    def cycle(self, word, velocity=0):
        end = time.monotonic() + PERIOD_S
        self.send(0x200 + NODE, struct.pack("<Hi", word, velocity))
        self.send(0x080, b"")
        while (left := end - time.monotonic()) > 0.0:
            self.take(self.bus.recv(left))

    def take(self, message):
        if message is None:
            return
        self.heard[message.arbitration_id] += 1
        data = bytes(message.data)
        if message.arbitration_id == 0x280 + NODE:
            self.velocity = struct.unpack_from("<i", data)[0]
        if self.is_ready.is_set() and message.arbitration_id == 0x600 + NODE and data[0] >> 5 not in (2, 3):
            self.downloads.append(data.hex())

    def send(self, can_id, data):
        self.own[can_id] += 1
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def write(self, index, subindex, code, value):
        data = struct.pack(f"<{code}", value)
        self.send(0x600 + NODE, struct.pack("<BHB", 0x23 | 4 - len(data) << 2, index, subindex) + data.ljust(4, b"\0"))
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            message = self.bus.recv(0.1)
            if message is not None and message.arbitration_id == 0x580 + NODE:
                assert message.data[0] == 0x60, message.data.hex()
                return
        raise AssertionError("no answer")

    def map(self, parameter, mapping, cob_id, words):
        self.write(parameter, 1, "I", 0x80000000 | cob_id)
        self.write(mapping, 0, "B", 0)
        for position, word in enumerate(words, 1):
            self.write(mapping, position, "I", word)
        self.write(mapping, 0, "B", len(words))
        self.write(parameter, 2, "B", 1)
        self.write(parameter, 1, "I", cob_id)


@contextlib.contextmanager
def driven(folder):
    axis = {"mode": "csv", "trajectory": {"kind": "hold"}, "limits": {"torque": 0.3, "velocity": 30.0}}
    configuration = write_configuration(folder, x=axis)
    text = configuration.read_text().replace("priority: 0", "max_missed: 400\n  priority: 0")  # on a busy machine
    configuration.write_text(text)
    config = yaml.safe_load(configuration.read_text())["bus"]
    with simulated_drives(configuration, pace="real"):
        bus = multicast_bus(config["channel"], config["port"])
        master = Master(bus)
        master.start()
        try:
            assert master.is_ready.wait(10.0)
            yield configuration, master
        finally:
            master.is_stopping.set()
            master.join()
            bus.shutdown()


def test_a_dry_run_beside_a_master_listens_and_disturbs_nothing(tmp_path):
    with driven(tmp_path) as (configuration, master):
        done = run("run", configuration, "--dry-run", "--duration", 1.0, "--json", check=False)
        time.sleep(0.2)
        own, heard = Counter(master.own), Counter(master.heard)
        velocity = master.velocity
    assert done.returncode == 0, done.stderr
    assert "another master drives it (" in done.stderr
    assert json.loads(done.stdout)["cycles"] > 100  # periods that a busy machine misses are no cycles
    assert master.downloads == []
    assert heard[0x000] == 0
    for can_id in (0x080, 0x200 + NODE):
        assert heard[can_id] <= own[can_id] + 1, hex(can_id)
    assert heard[0x700 + 126] == 0
    assert heard[0x280 + NODE] > 0.8 * own[0x080]  # the master goes on getting its TPDOs
    assert velocity == pytest.approx(200_000, rel=0.2)


def test_a_run_beside_a_master_is_refused_and_disturbs_nothing(tmp_path):
    with driven(tmp_path) as (configuration, master):
        done = run("run", configuration, "--duration", 1.0, check=False)
        time.sleep(0.2)
        velocity, heard = master.velocity, Counter(master.heard)
    assert done.returncode == 1
    assert "another master is at work" in done.stderr
    assert "SYNC (080h)" in done.stderr
    assert "FH-203" in done.stderr
    assert master.downloads == []
    assert heard[0x000] == heard[0x77E] == 0
    assert velocity == pytest.approx(200_000, rel=0.2)
