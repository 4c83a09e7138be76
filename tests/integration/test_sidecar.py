"""The demonstration beside another controller: simulated drives, a stand-in master and the daemon, as processes."""

import json
import struct
import subprocess
import threading
import time
from collections import Counter
from contextlib import ExitStack, contextmanager

import pytest
import yaml

from friction_hil.recordings import read_all
from tests.peers.plc_master import EVENT_DRIVEN, PlcMaster
from tests.processes import free_port, listening, run, run_daemon, simulated_drives, start
from tests.readme_commands import ROOT

OFFSET, SYNC, STATUS, RPDO, SDO = 0x501, 0x080, 0x181, 0x201, 0x601


@pytest.fixture
def configuration(tmp_path):
    """The shipped configuration on a bus of its own."""
    values = yaml.safe_load((ROOT / "config/sidecar.yaml").read_text())
    values["bus"]["port"] = free_port()
    values["realtime"] = {"priority": 0, "max_missed": 200}  # tests share a machine
    values["axes"]["x"]["compensation"]["baseline_s"] = 3.0
    del values["recording"]
    path = tmp_path / "sidecar.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


@contextmanager
def frame_log(configuration):
    """Every frame on the bus while the context lasts."""
    frames, is_over = [], threading.Event()
    with listening(configuration) as bus:

        def read():
            while (message := bus.recv(0.1)) is not None or not is_over.is_set():
                if message is not None:
                    frames.append((message.arbitration_id, bytes(message.data)))

        thread = threading.Thread(target=read)
        thread.start()
        try:
            yield frames
        finally:
            is_over.set()
            thread.join()  # what has arrived by then is read: the bus is to be silent


def offsets(frames):
    return [struct.unpack("<h", data)[0] for can_id, data in frames if can_id == OFFSET]


def slow_down(configuration, max_missed):
    """A period that a busy computer keeps in real time, and patience."""
    values = yaml.safe_load(configuration.read_text())
    values["period_s"] = 1e-2
    values["realtime"]["max_missed"] = max_missed
    values["axes"]["x"]["compensation"]["baseline_s"] = 0.0
    values["axes"]["x"]["limits"] |= {"following_error": 10.0, "velocity": 300.0}
    configuration.write_text(yaml.safe_dump(values))


def wait_until(condition, timeout_s=240.0):  # on a busy computer the start alone takes a minute
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def compensating(configuration, frames):
    """Start a daemon, and wait for its offsets; a busy computer stamps SYNC unevenly, which it refuses."""
    for _ in range(5):
        daemon = start("run", configuration, "--json", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        wait_until(lambda daemon=daemon: len(offsets(frames)) > 100 or daemon.poll() is not None)
        if daemon.poll() is None:
            return daemon
        output, errors = daemon.communicate()
        assert "gives no time base" in errors, (output, errors)
    raise AssertionError(errors)


@pytest.mark.deep
def test_compensation_beside_a_master_reduces_its_following_error(configuration, tmp_path):
    recording = tmp_path / "run.mcap"
    with frame_log(configuration) as frames, simulated_drives(configuration, "--master"):
        wait_until(lambda: sum(can_id == SYNC for can_id, _ in frames) > 1)
        at_start = len(frames)
        summary, done = run_daemon(configuration, "--duration", "9", "--record", recording)
        at_end = len(frames)
    assert summary["faults"] == []
    error = summary["axes"]["x"]
    assert error["compensated"]["rms"] == error["rms"] < 0.4 * error["baseline"]["rms"]
    assert "demand from 607Ah" in done.stderr
    # nothing but the master's and the drive's own frames, and the offset
    count = Counter(can_id for can_id, _ in frames[at_start:at_end])
    assert set(count) <= {SYNC, STATUS, 0x281, RPDO, OFFSET, 0x701, 0x77F}
    assert max(offsets(frames)) > 60
    assert 1000 < count[OFFSET] <= summary["cycles"] + 2  # a slow log may lose frames
    verified = json.loads(run("replay", recording, "--verify", "--json").stdout)
    assert verified["recordings"][0]["verified"] is True
    identified = json.loads(run("identify", recording, "--models", "coulomb", "--lowpass", "100", "--json").stdout)
    assert identified["best"].startswith("coulomb")


@pytest.mark.deep
def test_two_runs_are_equal_bit_for_bit(configuration, tmp_path):
    runs = []
    for name, late_s in (("first.mcap", 0.0), ("second.mcap", 2.5)):
        with simulated_drives(configuration, "--master"):
            time.sleep(late_s)  # the master waits for the sidecar, and nothing changes meanwhile
            run_daemon(configuration, "--duration", "2", "--record", tmp_path / name)
        runs.append(read_all(tmp_path / name)["x"].columns["checksum"])
    assert runs[0].tobytes() == runs[1].tobytes()


def test_a_dry_run_sends_nothing(configuration):
    with frame_log(configuration) as frames, simulated_drives(configuration, "--master"):
        summary, _ = run_daemon(configuration, "--duration", "0.005", "--dry-run")
    assert summary["faults"] == []
    assert offsets(frames) == []


@contextmanager
def machine(configuration, *options):
    """Drives and, unless other options are given, their master in real time."""
    words = ("simulate", configuration, *(options or ("--master",)), "--exit-with-stdin")
    process = start(*words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stdout.readline().startswith("ready:")
        yield process
    finally:
        process.stdin.close()
        process.wait(30)
        process.stdout.close()
        process.stderr.close()


@pytest.mark.deep
def test_when_the_daemon_is_killed_the_machine_runs_on_and_its_master_clears_the_offset(configuration):
    slow_down(configuration, max_missed=300)
    with frame_log(configuration) as frames, machine(configuration):
        wait_until(lambda: any(can_id == SYNC for can_id, _ in frames))
        daemon = start("run", configuration, "--json")
        wait_until(lambda: len(offsets(frames)) > 150 and offsets(frames)[-1] != 0)
        daemon.kill()
        daemon.wait(10)
        at_end = len(frames)
        wait_until(lambda: sum(can_id == STATUS for can_id, _ in frames[at_end:]) > 150)
        after = frames[at_end:]
    assert not any(can_id == 0x081 for can_id, _ in after)  # no emergency
    assert {data[0] & 0x6F for can_id, data in after if can_id == STATUS} == {0x27}  # Operation enabled throughout
    assert (SDO, bytes.fromhex("2bb2600000000000")) in after
    positions = [struct.unpack("<i", data[2:6])[0] for can_id, data in after if can_id == STATUS]
    assert max(positions) - min(positions) > 1000


@pytest.mark.deep
def test_when_the_machine_ends_the_daemon_fades_out_and_says_why(configuration):
    slow_down(configuration, max_missed=100)
    with frame_log(configuration) as frames:
        with machine(configuration):
            wait_until(lambda: any(can_id == SYNC for can_id, _ in frames))
            daemon = compensating(configuration, frames)
        output, _ = daemon.communicate(timeout=30)
    assert daemon.returncode == 1
    assert any("FH-248" in fault or "did not come" in fault for fault in json.loads(output)["faults"])
    assert offsets(frames)[-1] == 0


@pytest.mark.deep
def test_beside_an_independent_master_only_offsets_are_sent(configuration):
    """A PLC on the canopen library moves the drive; its commissioning has prepared the offset's RPDO."""
    slow_down(configuration, max_missed=300)
    values = yaml.safe_load(configuration.read_text())
    values["axes"]["x"]["sidecar"]["tpdos"] = [{"cob_id": 0x181, "entries": [0x6041, 0x6064]}]
    configuration.write_text(yaml.safe_dump(values))
    bus = {key: value for key, value in values["bus"].items() if key not in ("role", "sync_cob_id")}
    with ExitStack() as until_silence, machine(configuration, "--pace", "real"), PlcMaster(bus, 1) as plc:
        plc.map(0x1403, 0x500, EVENT_DRIVEN, (0x60B20010,))
        before = plc.dictionary()
        frames = until_silence.enter_context(frame_log(configuration))  # a log from before may lag behind these SDOs
        done = run("run", configuration, "--duration", "3", "--json", check=False)
        wait_until(lambda: offsets(frames)[-1:] == [0])
        frames_of_run = frames[:]
        assert plc.dictionary() == before
        assert plc.is_in_command
    summary = json.loads(done.stdout)
    assert summary["faults"] == []
    assert {can_id for can_id, _ in frames_of_run} == {SYNC, STATUS, RPDO, OFFSET}
    assert len(offsets(frames_of_run)) == pytest.approx(summary["cycles"], abs=3)
    assert max(map(abs, offsets(frames_of_run))) > 50
    assert offsets(frames_of_run)[-1] == 0


def test_without_a_master_nothing_starts(configuration):
    with simulated_drives(configuration):
        done = run("run", configuration, "--duration", "1", check=False)
    assert done.returncode == 1
    assert "no SYNC (080h) within 5 s" in done.stderr
    assert "FH-247" in done.stderr


def test_a_stand_in_master_needs_the_configuration_of_a_sidecar_and_no_real_bus(configuration):
    done = run("simulate", "--master", ROOT / "config/demo.yaml", check=False)
    assert done.returncode == 2
    assert "--master needs bus.role: sidecar" in done.stderr
    values = yaml.safe_load(configuration.read_text())
    values["bus"] = {"interface": "socketcan", "channel": "can0", "role": "sidecar"}
    configuration.write_text(yaml.safe_dump(values))
    done = run("simulate", "--master", configuration, check=False)
    assert done.returncode == 2
    assert "may have real drives" in done.stderr


def test_tune_refuses_what_it_cannot_move(configuration):
    done = run("tune", configuration, "--yes", "--pace", "sync", check=False)
    assert done.returncode == 2
    assert "another controller moves the axes" in done.stderr


def test_a_stand_in_master_ends_although_its_drives_were_killed(configuration):
    slow_down(configuration, max_missed=100)
    with frame_log(configuration) as frames, machine(configuration) as drives:
        wait_until(lambda: sum(can_id == STATUS for can_id, _ in frames) > 50)
        drives.kill()
        drives.wait(10)
        wait_until(lambda: is_silent(frames))


def is_silent(frames, for_s=0.5):
    """Whether nothing arrives for a while."""
    before = len(frames)
    time.sleep(for_s)
    return len(frames) == before
