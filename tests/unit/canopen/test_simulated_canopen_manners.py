"""Manners of simulated drives: what stacks and vendors do differently, each on the bench."""

import struct
from typing import Any

import pytest
from pydantic import ValidationError

from friction_hil.drive import DriveState
from friction_hil.errors import UsageError
from tests.canopen_bench import PLAIN, Bench, Frame


def upload(index: int, subindex: int = 0) -> bytes:
    return struct.pack("<BHB4x", 0x40, index, subindex)


@pytest.mark.parametrize("at_sync_only", [False, True])
def test_timer_of_a_synchronous_rpdo_without_sync(at_sync_only: bool) -> None:
    bench = Bench(PLAIN, is_paced_by_sync=False, manners={"timer_at_sync_only": at_sync_only})
    bench.write(0x1400, 5, "H", 20)
    bench.stream(10)
    for time in range(1, 3000):
        bench.at(time)
        if time <= 5:
            bench.move(50)
    assert (bench.node.drive.state is DriveState.OPERATION_ENABLED) == at_sync_only
    assert (abs(bench.servo.true_velocity) > 10.0) == at_sync_only, "nobody stops it"
    bench.sync()
    assert bench.emergencies == ["8250"], "the SYNC makes it look"
    assert bench.node.drive.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)


# SDO


@pytest.mark.parametrize("is_paced_by_sync", [False, True])
def test_every_answer_is_late(is_paced_by_sync: bool) -> None:
    bench = Bench(is_paced_by_sync=is_paced_by_sync, manners={"sdo_delay_s": 0.05})
    assert bench.sdo(upload(0x1000)) == []
    assert bench.node.answers_in_s == pytest.approx(0.05)
    assert bench.wait(49) == []
    assert bench.wait(1) == [(0x585, bytes.fromhex("43 00 10 00 92 01 02 00"))]
    assert bench.node.answers_in_s is None


def test_a_late_answer_comes_after_the_client_gave_up() -> None:
    bench = Bench(manners={"sdo": [{"index": 0x60A9, "delay_s": 0.7, "times": 1}]})
    assert bench.sdo(upload(0x60A9)) == []
    bench.wait(300)
    bench.sdo(struct.pack("<BHBI", 0x80, 0x60A9, 0, 0x05040000))  # as a client does at its time-out
    assert bench.sdo(upload(0x6076)) == [], "a busy drive reads its mailbox afterwards"
    assert [data[1:4] for _, data in bench.wait(400)] == [b"\xa9\x60\0", b"\x76\x60\0"]
    assert bench.read(0x60A9) == 0x00B50300, "slow once"


def test_aborts_of_choice_and_silence() -> None:
    manners = [
        {"index": 0x6007, "access": "write", "abort": 0x08000020},
        {"index": 0x1016, "subindex": 1, "is_silent": True},
        {"index": 0x60C2, "subindex": 2, "access": "write", "abort": 0x08000022, "times": 2},
    ]
    bench = Bench(manners={"sdo": manners})
    assert bench.try_write(0x6007, 0, "h", 3) == 0x08000020
    assert bench.read(0x6007, 0, "h") == 1, "the write had no effect"
    assert bench.sdo(upload(0x1016, 1)) == []
    assert bench.read(0x1016, 0, "B") == 2
    assert [bench.try_write(0x60C2, 2, "b", -3) for _ in range(3)] == [0x08000022, 0x08000022, 0]


# Units and direction


@pytest.mark.parametrize(
    ("unit", "increments", "code", "changes"),
    [
        ("rpm", 60, 0x00B44700, {}),
        ("0.1 rpm", 600, 0xFFB44700, {}),
        ("0.001 rpm", 60_000, 0xFDB44700, {}),
        ("rad/s", 6, 0x00100300, {}),
        ("0.01 deg/s", 36_000, 0xFE410300, {}),
        ("rev/s", 1, 0x00B40300, {}),
        ("counts/s", 1_048_576, 0x00B50300, {}),
        (None, 1_048_576, 0x00B50300, {}),
        pytest.param("rpm", 60, 0x00B50300, {"values": [{"index": 0x60A9, "value": 0x00B50300}]}, id="told wrongly"),
    ],
)
def test_velocity_unit(unit: str | None, increments: int, code: int, changes: dict[str, Any]) -> None:
    bench = Bench(PLAIN, manners={"velocity_unit": unit, **changes})
    bench.stream(9)
    bench.move(increments, 200)
    assert bench.read(0x606C, 0, "i") == pytest.approx(increments, rel=0.02, abs=1.5)
    assert bench.read(0x606B, 0, "i") == pytest.approx(increments, rel=0.02, abs=1.5)
    assert bench.servo.true_velocity == pytest.approx(6.28, rel=0.05)
    assert bench.read(0x60A9) == code


@pytest.mark.parametrize("mode", [8, 9, 10])
def test_inverted_drive(mode: int) -> None:
    """Everything on the bus is as on the drive beside it, and the axis turns the other way."""
    turned, answers, errors = [], [], []
    for is_inverted in (False, True):
        bench = Bench(PLAIN, manners={"is_inverted": is_inverted})
        bench.stream(mode)
        for cycle in range(1, 101):
            bench.move({8: 500 * cycle, 9: 500_000, 10: 20}[mode], offset=10)
        turned.append(bench.servo.true_position)
        answers.append(struct.unpack("<Hih", bench.sync()[0][1]))
        assert answers[-1][1] > 1000
        assert bench.read(0x606C, 0, "i") > 100_000
        errors.append(bench.read(0x60F4, 0, "i"))
    assert turned[0] == pytest.approx(-turned[1], rel=1e-3)
    assert errors[0] == pytest.approx(errors[1], abs=2)
    assert answers[0][1:] == pytest.approx(answers[1][1:], abs=3)


@pytest.mark.parametrize(
    "manners",
    [{"velocity_unit": "knots"}, {"velocity_unit": "3 rpm"}, {"sdo": [{"index": 5}]}, {"sdo_delay_s": -1}],
)
def test_manners_are_checked(manners: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Bench(manners=manners)


@pytest.mark.parametrize(
    "manners",
    [
        {"values": [{"index": 0x6099, "value": 1}]},
        {"values": [{"index": 0x6007, "value": 40_000}]},
        {"events": [{"at_s": 1.0, "do": "write", "index": 0x6099, "value": 1}]},
    ],
)
def test_values_are_checked(manners: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=r"simulation\.canopen.* (6099|6007)h"):
        Bench(manners=manners)


# Controlword


OFF, READY, ON, ENABLED = "SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "OPERATION_ENABLED"


@pytest.mark.parametrize(
    ("manners", "words", "states"),
    [
        pytest.param({}, [6, 15], [READY, ENABLED], id="3, then 4, as long as it asks for it"),
        ({"controlword": "edge"}, [6, 15, 15, 15, 7, 15], [READY, ON, ON, ON, ON, ENABLED]),
        ({"controlword": "twice"}, [6, 6, 7, 7, 15, 15], [OFF, READY, READY, ON, ON, ENABLED]),
    ],
)
def test_controlwords_that_are_taken_differently(manners: dict[str, Any], words: list[int], states: list[str]) -> None:
    bench, passed = Bench(manners=manners), []
    bench.write(0x6060, 0, "b", 10)
    for word in words:
        bench.write(0x6040, 0, "H", word)
        bench.sync()
        passed.append(bench.node.drive.state.name)
    assert passed == states


def test_slow_switch_on() -> None:
    bench = Bench(manners={"switch_on_s": 0.05, "enable_s": 0.2})
    bench.write(0x6060, 0, "b", 10)
    states = []
    for word, syncs in ((6, 1), (7, 49), (7, 2), (15, 150), (7, 100), (15, 199), (15, 1)):  # revoked meanwhile
        bench.write(0x6040, 0, "H", word)
        bench.sync(syncs)
        states.append(bench.node.drive.state.name)
    assert states == [READY, READY, ON, ON, ON, ON, ENABLED]


# Events


def scene(*events: dict[str, Any]) -> Bench:
    """Return a bench in Operational with TPDO 1 (statusword and position) and 2 (velocity), before the first SYNC."""
    made = Bench(PLAIN, manners={"events": events})
    made.map(0x1800, 0x1A00, 0x185, 1, [0x60410010, 0x60640020])
    made.map(0x1801, 0x1A01, 0x285, 1, [0x606C0020])
    made.sync(50)  # in Pre-operational: time does not count
    made.nmt(0x01)
    return made


def listen(bench: Bench, cycles: int) -> list[list[Frame]]:
    return [bench.sync() for _ in range(cycles)]


def spin(bench: Bench, cycles: int) -> list[list[Frame]]:
    """Enable in cst and push; return what comes in each cycle."""
    bench.map(0x1400, 0x1600, 0x205, 1, [0x60400010, 0x60710010])
    bench.command = struct.Struct("<Hh")
    bench.enable(10)
    return [bench.move(50) for _ in range(cycles)]


@pytest.mark.parametrize("state", ["pre_operational", "stopped"])
def test_event_of_the_nmt_state(state: str) -> None:
    bench = scene({"at_s": 0.01, "do": state}, {"at_s": 0.02, "do": "operational"})
    answers = [len(frames) for frames in listen(bench, 30)]
    assert answers == [2] * 11 + [0] * 10 + [2] * 9, "the event comes after the answer to its SYNC"


@pytest.mark.parametrize("is_paced_by_sync", [True, False])
def test_reboot(is_paced_by_sync: bool) -> None:
    manners = {"events": [{"at_s": 0.01, "do": "reboot", "for_s": 0.5}]}
    bench = Bench(PLAIN, is_paced_by_sync=is_paced_by_sync, manners=manners)
    bench.stream(10)
    for time in range(1, 601):
        bench.at(time)
        bench.move(50)
        if time == 100:
            assert bench.sdo(upload(0x1000)) == []
            assert bench.servo.torque_demand == 0.0
    assert bench.sent[-1] == (0x705, b"\0"), "the boot-up message, and nothing after it"
    assert bench.read(0x6060, 0, "b") == 0, "back at its defaults"


@pytest.mark.parametrize(("kind", "hears"), [("mute", True), ("deaf", False), ("unplug", False)])
def test_mute_deaf_and_unplugged(kind: str, hears: bool) -> None:
    bench = scene({"at_s": 0.005, "do": kind, "for_s": 0.01})
    assert [len(answer) for answer in listen(bench, 6)] == [2] * 6
    bench.send(0x605, "2365600001000000")
    assert listen(bench, 9) == [[]] * 9
    bench.sync(3)
    assert (bench.read(0x6065) == 1) == hears


def test_lost_power_stage() -> None:
    bench = scene({"at_s": 0.02, "do": "disable"})
    spin(bench, 20)
    assert bench.node.drive.state is DriveState.OPERATION_ENABLED
    assert listen(bench, 3)[-1][0][1][:1] == b"\x50"
    assert bench.servo.torque_demand == 0.0


def test_emergency_fault_and_an_object_that_changes_by_itself() -> None:
    bench = scene(
        {"at_s": 0.005, "do": "emergency", "code": 0x2310, "for_s": 0.01},
        {"at_s": 0.005, "do": "write", "index": 0x6060, "value": 1},
        {"at_s": 0.03, "do": "fault", "code": 0x4210},
    )
    bench.sync(20)
    assert (bench.emergencies, bench.read(0x6061, 0, "b")) == (["2310", "0000"], 1)
    bench.sync(20)
    assert bench.emergencies == ["2310", "0000", "4210"]
    assert (bench.node.drive.state, bench.read(0x603F, 0, "H")) == (DriveState.FAULT, 0x4210)


def test_bits_of_the_statusword() -> None:
    bench = scene({"at_s": 0.005, "do": "statusword", "set": 0x0880, "clear": 0x0200, "for_s": 0.005})
    words = [struct.unpack_from("<H", frames[0][1])[0] for frames in listen(bench, 15)]
    assert words == [0x250] * 6 + [0x8D0] * 5 + [0x250] * 4


def test_frozen_encoder() -> None:
    frames = spin(scene({"at_s": 0.02, "do": "freeze_encoder", "for_s": 0.1}), 150)
    positions = [struct.unpack("<Hi", answer[0][1])[1] for answer in frames]
    speeds = [struct.unpack("<i", answer[1][1])[0] for answer in frames]
    assert len(set(positions[22:119])) == 1
    assert speeds[110] > speeds[30] > 0
    assert positions[125] - positions[119] > 10_000


def test_jump_of_the_encoder() -> None:
    bench = scene({"at_s": 0.005, "do": "jump_encoder", "counts": 1 << 31, "for_s": 0.001})
    positions = [struct.unpack("<Hi", frames[0][1])[1] for frames in listen(bench, 10)]
    assert [position < -(1 << 30) for position in positions] == [False] * 6 + [True] + [False] * 3


def test_tpdos_that_stop_get_lost_or_cut() -> None:
    bench = scene({"at_s": 0.005, "do": "stop_tpdo", "tpdo": 2, "for_s": 0.005})
    assert [[can_id for can_id, _ in frames] for frames in listen(bench, 12)][6:11] == [[0x185]] * 5
    bench = scene({"at_s": 0.002, "do": "cut_tpdo", "tpdo": 1, "length": 4})
    assert [[len(data) for _, data in frames] for frames in listen(bench, 5)] == [[6, 4]] * 3 + [[4, 4]] * 2
    runs = [
        [
            [can_id for can_id, _ in frames]
            for frames in listen(scene({"at_s": 0.0, "do": "lose_tpdo", "share": 0.5}), 400)
        ]
        for _ in range(2)
    ]
    assert runs[0] == runs[1], "the same ones in every run"
    assert sum(map(len, runs[0])) == pytest.approx(400, abs=60)


def test_late_tpdos_paced_by_sync() -> None:
    late = [
        frames[0] if frames else None for frames in spin(scene({"at_s": 0.0, "do": "late_tpdo", "by_s": 0.002}), 50)
    ]
    usual = [frames[0] for frames in spin(scene(), 50)]
    assert late[1:3] == [None, None]
    assert late[3:] == usual[1:48]


def test_babbling() -> None:
    babble = {"do": "babble", "can_id": 0x585, "data": "8060600000000405", "per_ms": 3}
    bench = scene({"at_s": 0.005, "for_s": 0.01, **babble})
    bench.sync(30)
    assert [data.hex() for _, data in bench.sent].count("8060600000000405") == 30


@pytest.mark.parametrize(
    ("event", "named"),
    [
        ({"do": "explode"}, "pre_operational"),
        ({"do": "fault"}, "needs code"),
        ({"do": "mute", "code": 1}, "mute has no code"),
        ({"do": "fault", "code": 1, "for_s": 1.0}, "happens once"),
        ({"do": "babble", "can_id": 1, "data": "123"}, "data"),
        ({"do": "mute", "at_s": -1.0}, "at_s"),
    ],
)
def test_events_are_checked(event: dict[str, Any], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        scene({"at_s": 0.0, **event})
