"""The parts of tools/campaign that judge: a witness that overlooks nothing, a wire that passes on what it should."""

import re
import struct

import pytest
from click.testing import CliRunner

from tests.processes import GROUP, free_port
from tools.campaigns.can_wire import Bus, CanWire
from tools.campaigns.command import command
from tools.campaigns.faults import BY_NAME, FAULTS
from tools.campaigns.judge import judge
from tools.campaigns.table import Row
from tools.campaigns.trial import Seen
from tools.campaigns.witness import Limits, Witness, is_powered, keeps_power

ENABLE, DISABLE = 0x0F, 0x00
SETTLED = {"drive_states": {"x": "switch on disabled"}, "cycles": 100, "faults": []}


def witness() -> Witness:
    return Witness(Limits(torque=300.0, step=50.0))


def seen(**changes) -> Seen:
    values = {"arena": "CAN", "mode": "csp", "phase": "running", "told": [], "witness": witness(), "struck_s": 10.0}
    ended = {"status": 0, "drives_status": 0, "rows": 100, "result": dict(SETTLED)}
    found = Seen(**values | ended | changes)
    found.witness.status(11.0, 0x250)
    return found


def test_a_single_frame_beyond_torque_or_step_is_seen() -> None:
    one = witness()
    for k, torque in enumerate((0.0, 50.0, 100.0, 150.0, 100.0)):
        one.command(k * 1e-3, torque, ENABLE)
    assert (one.broken, one.largest_torque, one.largest_step) == ([], 150.0, 50.0)
    one.command(5e-3, 152.0, ENABLE)
    assert "step of 52.0" in one.broken[0]
    one.command(6e-3, 301.0, ENABLE)
    assert any("torque of 301" in text for text in one.broken)


@pytest.mark.parametrize(
    ("torque", "word", "count"), [(0.0, DISABLE, 0), (0.0, ENABLE, 1), (0.0, 0x02, 1), (10.0, DISABLE, 1)]
)
def test_torque_may_end_in_a_step_only_where_the_power_ends_too(torque: float, word: int, count: int) -> None:
    one = witness()
    one.limits = Limits(torque=300.0, step=150.0)
    one.command(0.0, 150.0, ENABLE)
    one.command(1e-3, 299.0, ENABLE)
    one.command(2e-3, torque, word)
    assert len(one.broken) == count


def test_judgement() -> None:
    assert [is_powered(word) for word in (0x0637, 0x0617, 0x001F, 0x0633, 0x0018, 0x0050)] == [True] * 3 + [False] * 3
    assert [keeps_power(word) for word in (0x0F, 0x1F, 0x02, 0x06, 0x07, 0x00, 0x80)] == [True] * 3 + [False] * 4
    fault = BY_NAME["drive-fault"]
    assert "went on" in judge(fault, seen()).problems[0]
    named = {**SETTLED, "faults": ["x: the drive is in fault [FH-105]"]}
    assert judge(fault, seen(result=named, status=1)).problems == []
    other = {**SETTLED, "faults": ["x: position is outside the limits [FH-108]"]}
    assert "not named" in judge(fault, seen(result=other, status=1)).wrong[0]
    assert "exit status 0" in judge(fault, seen(result=named)).wrong[0]
    assert "90 of 100 rows" in judge(BY_NAME["stop-2"], seen(rows=10)).wrong[0]
    assert "90 of 100 rows" in judge(BY_NAME["stop-2"], seen(rows=10, errors="the heartbeat was lost")).wrong[0]
    assert judge(BY_NAME["stop-2"], seen(rows=10, errors="90 rows were lost", status=1)).wrong == []
    powered = seen()
    powered.witness.status(12.0, 0x637)
    assert "still has power" in judge(BY_NAME["stop-2"], powered).unsafe[0]


@pytest.mark.parametrize(
    ("text", "missed", "named"),
    [
        ("the loop was late by 60000 µs (12 periods) [FH-113]", 12, "late"),
        ("x: the drive is in fault; 3 periods were missed right before [FH-105]", 3, "late"),
        ("x: the drive is in fault [FH-105]", 3, "no: FH-105"),  # missed at another time
        ("x: the drive is in fault; 1 period was missed 20 ms before [FH-105]", 1, "no: FH-105"),
        ("x: position is outside the limits; 3 periods were missed right before [FH-108]", 3, "no: FH-108"),
        ("program error: KeyError; 3 periods were missed right before [FH-126]", 3, "no: FH-126"),
    ],
)
def test_lateness_excuses_only_what_follows_from_it(text: str, missed: int, named: str) -> None:
    result = {**SETTLED, "faults": [text], "missed": missed}
    verdict = judge(BY_NAME["wrap"], seen(result=result, status=1))
    assert (verdict.named, bool(verdict.problems)) == (named, named != "late")
    early = judge(BY_NAME["wrap"], seen(result=result, status=1, struck_s=None))
    assert bool(early.problems) == (named != "late")


def test_what_was_saved_by_a_watchdog_killed_or_never_read_is_not_passed() -> None:
    fault = BY_NAME["stop-2"]
    assert "left the drive with statusword 0637h" in judge(fault, seen(end_statusword=0x637)).unsafe[0]
    killed = seen(drives_status=-9)
    killed.witness.forget_status()
    assert "does not tell its state" in judge(fault, killed).unsafe[0]
    blind = seen()
    blind.witness.unread = 3
    assert "3 commands could not be read" in judge(fault, blind).unsafe[0]
    crashed = seen(struck_s=None, status=-11)
    assert "died of signal 11" in judge(fault, crashed).unsafe[0]
    early = {**SETTLED, "faults": ["x: velocity is beyond its limit [FH-107]"]}
    assert "before the fault struck" in judge(fault, seen(struck_s=None, result=early, status=1)).wrong[0]
    row = Row(fault, [(crashed, judge(fault, seen(struck_s=None)))])
    assert row.cells()[-1] == "void"


def test_the_wire_passes_frames_both_ways_and_reads_what_the_daemon_maps() -> None:
    sides = [Bus(GROUP, free_port()), Bus(GROUP, free_port())]
    one = witness()
    wire = CanWire(sides[0], sides[1], {1: one}, {0x501: [0x60B20010]})
    import can

    from tests.processes import multicast_bus

    buses = [multicast_bus(side.group, side.port) for side in sides]
    try:
        buses[0].send(can.Message(arbitration_id=0x501, data=struct.pack("<h", -301), is_extended_id=False))
        wire.poll(5.0)
        passed = buses[1].recv(5.0)
        assert (passed.arbitration_id, bytes(passed.data)) == (0x501, struct.pack("<h", -301))
        buses[1].send(can.Message(arbitration_id=0x181, data=b"\x27\x06", is_extended_id=False))
        wire.poll(5.0)
        assert buses[0].recv(5.0) is not None
    finally:
        for bus in buses:
            bus.shutdown()
        wire.close()
    assert (one.largest_torque, wire.cycles, len(one.broken)) == (301.0, 1, 2)


def test_the_command_lists_faults_and_refuses_others() -> None:
    listed = CliRunner().invoke(command, ["--list"]).output
    assert all(fault.name in listed for fault in FAULTS)
    assert "kill-daemon" in str(CliRunner().invoke(command, ["--only", "kill-deamon"]).exception)


def test_a_disk_without_room_for_a_channel_is_no_error_where_the_run_says_what_is_lost() -> None:
    said = "recording: 100 of 100 rows were lost"
    verdict = judge(BY_NAME["disk-full"], seen(rows=None, row_problem="no channel", errors=said, status=1))
    assert (verdict.problems, verdict.lost) == ([], 100)
    silent = judge(BY_NAME["disk-full"], seen(rows=None, row_problem="no channel", errors="", status=0))
    assert silent.problems == ["recording: no channel"]


@pytest.mark.parametrize(("status", "count"), [(1, 0), (0, 1)])
def test_settings_that_were_not_restored_after_the_stop_are_exit_status_1(status, count) -> None:
    said = "x: not restored in the drive: 1A00h:02 [FH-222]"
    assert len(judge(BY_NAME["lost-10"], seen(errors=said, status=status)).problems) == count


def test_the_table_is_in_its_file_after_every_try(tmp_path, monkeypatch) -> None:
    path, tables = tmp_path / "table.md", []

    def trial(fault, seed, number) -> Seen:
        tables.append(path.read_text() if path.exists() else "")
        return seen(status=number)  # the second one ends with a status that its faults do not explain

    monkeypatch.setattr("tools.campaigns.command.run_trial", trial)
    words = ["--only", "stop-2", "--only", "wrap", "--tries", "2", "--output", str(path)]
    said = CliRunner().invoke(command, words, standalone_mode=False)
    assert said.return_value == 1
    totals = [re.search(r"^(\d) tries.*; (\w+) failed", text, re.MULTILINE) for text in tables[1:]]
    assert [found.groups() for found in totals if found] == [("1", "none"), ("2", "1"), ("3", "1")]
    repeats = re.findall(r"^- `(.+)`: exit status 1", path.read_text(), re.MULTILINE)
    assert repeats == [f"./tools/campaign --only {name} --seed 7 --first 1 --tries 1" for name in ("stop-2", "wrap")]
    missing = CliRunner().invoke(command, ["--output", str(tmp_path / "no/table.md")])
    assert "there is no folder" in str(missing.exception)
