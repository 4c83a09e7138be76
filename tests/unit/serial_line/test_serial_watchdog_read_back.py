"""A watchdog is claimed of what was read back, and what a drive says against its set-up is not passed over."""

import struct
from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.serial_line import codes
from friction_hil_drivers.serial_line.description import Description
from friction_hil_drivers.serial_line.read_back import contradiction
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.simulated import RefusedError, SimulatedDrive

from friction_hil.drive import DriveState, Request
from friction_hil.errors import DriveError
from tests.serial_bench import OWN, TinyDescription
from tests.serial_rig import Rig

READ, ILLEGAL_ADDRESS = 3, 2  # function and exception of Modbus
WATCHDOG = 0x0107  # its register in generic_cia402
UNREAD = {"read_watchdog": None, "read_watchdog_enabled": None}
WATCHED = ("rtu, function 23", "tcp", "dynamixel", "odrive")


def odrive(folder, **changes):
    """A copy of the ODrive's description; a message of None is left out."""
    data = yaml.safe_load((DESCRIPTIONS / "odrive.yaml").read_text())
    messages = {**data["messages"], **changes.pop("messages", {})}
    data |= {**changes, "messages": {name: each for name, each in messages.items() if each is not None}}
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


def treat(monkeypatch, signal, treatment):
    """Let a drive do something else than to take a written signal."""
    write = SimulatedDrive.write

    def changed(drive, name, number):
        if name == signal and number != 0.0:
            treatment()
        else:
            write(drive, name, number)

    monkeypatch.setattr(SimulatedDrive, "write", changed)


def refuse():
    raise RefusedError("not this one")


@pytest.mark.parametrize("kind", WATCHED)
def test_what_is_said_of_a_watchdog_was_read_back(kind, tmp_path):
    with Rig(kind, tmp_path, is_watchdog_required=True).begin() as bench:
        (note,) = [note for note in bench.facts.notes if "watches the daemon" in note]
        assert "100 ms" in note
        assert "(read back" in note
        bench.enable()


@pytest.mark.parametrize("kind", WATCHED)
def test_a_drive_that_drops_its_watchdog_without_a_word_is_refused(kind, tmp_path, monkeypatch):
    treat(monkeypatch, "watchdog", lambda: None)
    with Rig(kind, tmp_path) as bench, pytest.raises(DriveError, match=f"watchdog = .*{codes.WATCHDOG_NOT_HELD}"):
        bench.drives.connect()


@pytest.mark.parametrize("error_replies", [{}, {"error [0-9]+": "something else"}])
def test_a_refusal_that_the_description_does_not_list_is_a_refusal(error_replies, tmp_path, monkeypatch):
    """Without a line that reads the watchdog, the drive's unknown line is all that tells of it."""
    keys = {"error_replies": error_replies, "messages": UNREAD, "watchdog": {"signal": "watchdog"}}
    description = odrive(tmp_path, refusal="what do you mean?", **keys)
    treat(monkeypatch, "watchdog", refuse)
    words = rf"watchdog of x .*what do you mean\?.*{codes.SETUP_REFUSED}"
    with Rig("odrive", tmp_path, description=description) as bench, pytest.raises(DriveError, match=words):
        bench.drives.connect()


def test_a_watchdog_that_cannot_be_read_is_not_claimed(tmp_path):
    description = odrive(tmp_path, messages=UNREAD, watchdog={"signal": "watchdog"})
    with Rig("odrive", tmp_path, description=description).begin() as bench:
        (note,) = [note for note in bench.facts.notes if "without a command" in note]
        assert "not read back" in note
        assert "watches the daemon:" not in note
        bench.enable()


def test_a_register_that_the_drive_lets_nobody_read_is_not_claimed(tmp_path, monkeypatch):
    with Rig("tcp", tmp_path) as bench:
        space = bench.simulated.lines[0].responder.by_address[3]
        answer = space.answer

        def secretive(pdu):
            first, count = struct.unpack_from(">HH", pdu, 1)
            is_asked = pdu[0] == READ and first <= WATCHDOG < first + count
            return bytes((READ | 0x80, ILLEGAL_ADDRESS)) if is_asked else answer(pdu)

        monkeypatch.setattr(space, "answer", secretive)
        bench.begin()
        assert any("not read back" in note for note in bench.facts.notes)
        bench.enable()


@pytest.mark.parametrize("kind", WATCHED)
def test_a_period_needs_room_for_one_exchange_of_a_step(kind, tmp_path, monkeypatch):
    """A read behind the write of a step would never end within a period that has room for the step alone."""
    with Rig(kind, tmp_path).begin() as bench:
        steps: list[int] = []
        enqueue = BusScheduler.enqueue

        def watched(scheduler, exchanges, done=None):
            if done is not None:
                steps.append(len(exchanges))
            enqueue(scheduler, exchanges, done)

        monkeypatch.setattr(BusScheduler, "enqueue", watched)
        bench.enable()
        assert len(steps) >= 2
        assert set(steps) == {1}


def test_a_drive_whose_watchdog_stays_off_gets_no_power(tmp_path, monkeypatch):
    """The switch is written when the drive is enabled, and read back before it gets its power."""
    treat(monkeypatch, "watchdog_enabled", lambda: None)
    with Rig("odrive", tmp_path).begin() as bench:
        for _ in range(1200):  # the step has one second
            bench.cycle(Request.ENABLE)
            assert not bench.feedback.state.is_powered
        assert bench.feedback.state is DriveState.READY_TO_SWITCH_ON
        assert "watchdog_enabled = 1" in bench.feedback.message
        assert codes.SEQUENCE_STUCK in bench.feedback.message


@pytest.mark.parametrize(
    ("name", "written", "read", "is_kept"),
    [
        ("lifetime", 0.1, 0.1, True),
        ("lifetime", 0.1, 0.104, True),  # a drive that counts in steps of 8 ms
        *(("lifetime", 0.1, read, False) for read in (0.2, 0.0, -1.0)),
        ("lifetime", 0.0, 0.0, True),
        ("lifetime", 0.0, 0.1, False),
        ("key", 1.0, 1.0, True),
        ("key", 1.0, 0.0, False),
        ("key", 100.0, 101.0, False),
    ],
)
def test_a_time_is_kept_within_a_tenth_and_all_else_exactly(name, written, read, is_kept):
    description: Description = TinyDescription.model_validate(OWN)
    found = contradiction(description, {name: written}, {name: read}, (name,))
    assert (found == "") is is_kept
    assert is_kept or (name in found and f"{read:g} is read back" in found)


def test_a_signal_that_nothing_reads_cannot_be_read_back(tmp_path):
    data = yaml.safe_load(Path(odrive(tmp_path, messages={"read_watchdog_enabled": None})).read_text())
    with pytest.raises(ValueError, match="nothing reads watchdog_enabled"):
        AsciiDescription.model_validate(data)
