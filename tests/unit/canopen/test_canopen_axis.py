"""One drive in the cyclic phase: the bytes of its frames in, feedback out; commands in, bytes out."""

import math
import struct
from dataclasses import fields

import pytest
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.codec import CommandEncoder, FeedbackDecoder, Measurement
from friction_hil_drivers.cia402.units import DriveUnits, wrap
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.drive import Command, DriveState, Feedback, Mode, Request
from friction_hil.errors import DriveError
from tests.canopen_axis_bench import (
    BOOT_UP,
    EMCY,
    HEARTBEAT,
    OPERATIONAL,
    PRE_OPERATIONAL,
    RPDO1,
    STOPPED,
    TPDO1,
    TPDO2,
    UNITS,
    Bench,
    answers,
)
from tests.messages import codes_in

NO_ERROR = "0000 00 0000000000"

# --- feedback


def known(feedback):
    """The fields that are known: NaN differs from itself, and since Python 3.13 dataclasses compare field by field."""
    values = {field.name: getattr(feedback, field.name) for field in fields(feedback)}
    return {name: value for name, value in values.items() if value == value}


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["as it is", "inverted"])
def test_frames_become_si_values(sign):
    bench = Bench(units=DriveUnits(sign * 1000.0, sign * 500.0, sign * 0.64))
    feedback = bench.cycle((TPDO1, "3706 e8030000 f4ff"), (TPDO2, "18fcffff 08"))
    torque = pytest.approx(sign * -12 * 0.64e-3)
    assert known(feedback) == known(Feedback(sign, sign * -2.0, torque, DriveState.OPERATION_ENABLED, True, "", ""))


def test_the_order_of_frames_does_not_matter_but_their_cycle_does():
    bench = Bench()
    assert bench.cycle((TPDO2, "00000000 08"), (TPDO1, "3706 e8030000 0000")).is_fresh
    bench.take((TPDO1, "3706d00700000000"))  # too late for the last cycle, before this SYNC
    feedback = bench.cycle((TPDO2, "00000000 08"))
    assert (feedback.is_fresh, feedback.position) == (False, 1.0)


@pytest.mark.parametrize(
    ("frames", "missing"),
    [
        ([], "TPDO 1 and TPDO 2 of node 5 did not arrive in time"),
        ([(TPDO1, "2106 d0070000 0000")], "TPDO 2 of node 5 did not arrive in time"),
        ([(TPDO2, "d0070000 08")], "TPDO 1 of node 5 did not arrive in time"),
        ([(TPDO1, "2106 d0070000 00"), (TPDO2, "d0070000 08")], "TPDO 1 of node 5 has 7 bytes instead of 8"),
        ([(TPDO1, "2106 d0070000 0000"), (TPDO2, "d0070000")], "TPDO 2 of node 5 has 4 bytes instead of 5"),
        ([(TPDO1, ""), (TPDO2, "")], "TPDO 2 of node 5 has 0 bytes instead of 5"),
    ],
)
def test_half_a_cycle_changes_nothing(frames, missing):
    """No torn snapshot: the values of the last complete cycle stay, are marked as old, and the reason is given."""
    bench = Bench()
    before = bench.heard(1000, velocity=250, torque=7)
    after = bench.cycle(*frames)
    assert (after.is_fresh, after.missing) == (False, missing)
    is_of_wrong_length = "instead" in missing
    assert bool(after.notices) is is_of_wrong_length
    assert all(notice.endswith("[FH-236]") for notice in after.notices)
    after.is_fresh, after.missing, after.notices = True, "", []
    assert known(after) == known(before)
    assert bench.heard().missing == ""


def test_before_anything_was_heard_nothing_is_known_and_a_drive_is_not_enabled():
    bench = Bench()
    assert bench.command(Request.ENABLE)[:4] == "0000"
    feedback = bench.cycle()
    assert (feedback.is_fresh, feedback.state) == (False, DriveState.UNKNOWN)


def test_longer_frames_are_read_from_their_beginning_and_named_and_a_repeated_one_does_not_count():
    bench = Bench()
    feedback = bench.cycle((TPDO1, "3706 e8030000 0000"), (TPDO1, "3706 d0070000 0000"), (TPDO2, "00000000 08 ff"))
    assert (feedback.is_fresh, feedback.position) == (True, 1.0)
    assert feedback.notices == ["TPDO 2 of node 5 has 6 bytes instead of 5 [FH-236]"]


def test_a_position_goes_on_through_the_wrap_of_the_counter():
    bench = Bench()
    edge = (1 << 31) - 1
    positions = [bench.heard(counts).position for counts in (edge - 5, edge, -edge - 1, -edge + 8, edge - 1)]
    expected = [edge - 5, edge, edge + 1, edge + 10, edge - 1]
    assert positions == pytest.approx([counts / 1000.0 for counts in expected], abs=1e-9)
    # and what is sent back is in the drive's own counts again
    bench.heard(-edge)
    assert bench.command(Request.ENABLE, position=(edge + 3) / 1000.0)[4:12] == struct.pack("<i", -edge + 1).hex()


# --- faults


def test_an_enabled_drive_in_another_mode_is_a_fault():
    bench = Bench(Mode.CSP)
    assert bench.heard(state=0x0233, mode=0).message == ""
    assert codes_in(bench.heard(state=0x0237, mode=10).message) == "FH-233"
    assert Bench(Mode.CST).heard(mode=10).message == ""
    assert Bench(is_listened_to=True).heard(mode=3).message == ""  # another master chose the mode


@pytest.mark.parametrize(
    ("data", "error", "more"),
    [
        ("1186 20 0000000000", "8611h following error", ", error register 20h"),
        ("3081 10 0000000000", "8130h heartbeat or life guard lost", ", er"),
        ("1186 20", "8611h following error", ", error register 20h"),  # a short one
        ("1186", "8611h following error", ""),
        ("00ff 81 0102030405", "FF00h additional functions", ", error register 81h, 01"),
        ("11", "", "without an error code: 1 bytes 11"),
        ("", "", "without an error code: 0 bytes"),
        (NO_ERROR, "", "0000h: the drive reports no error any more"),
    ],
)
def test_an_emergency_is_a_notice_and_tells_the_reason_of_a_fault(data, error, more):
    bench = Bench(error="as before")
    feedback = bench.cycle((EMCY, data))
    assert feedback.error == (error or "as before")
    (told,) = feedback.notices
    assert told.startswith(f"emergency {error}{more}")
    assert bench.cycle((EMCY, data)).notices[-1:] == [told], "it happened again"
    # "no error" does not take the reason of the fault away; an enabled drive has no reason
    assert bench.heard(state=0x0218).error == feedback.error
    assert bench.cycle((EMCY, NO_ERROR)).error == feedback.error
    assert bench.heard(state=0x0237).error == ""


def test_bits_of_the_statusword_are_told_once_when_they_change_in_mid_run():
    bench = Bench()
    told = [
        [notice[notice.index("6041h bit") : -1] for notice in bench.heard(state=word).notices]
        for word in (0x0250, 0x0237, 0x1237, 0x1237, 0x12B7, 0x0A37, 0x1037, 0x1A37)  # no "follows command" at first
    ]
    assert told[:4] == [[]] * 4
    assert told[4:] == [["6041h bit 7"], ["6041h bit 11", "6041h bit 12"], ["6041h bit 9"], []]


def test_a_restart_of_the_drive_is_a_fault_that_stays():
    bench = Bench()
    bench.heard()
    bench.heartbeat(BOOT_UP)
    assert codes_in(bench.heard().message) == "FH-231"
    bench.heartbeat(OPERATIONAL)
    assert [codes_in(bench.cycle(after_ms=200).message) for _ in range(5)] == ["FH-231"] * 5, "the cause"


@pytest.mark.parametrize(("state", "name"), [(PRE_OPERATIONAL, "pre-operational"), (STOPPED, "stopped")])
def test_a_drive_that_leaves_operational_is_a_fault(state, name):
    bench = Bench(heartbeat=state)  # on its way up
    assert bench.heard().message == ""
    bench.heartbeat(OPERATIONAL)
    bench.heartbeat(bytes([state[0] | 0x80]))  # the toggle bit of node guarding is no state
    assert bench.heard().message == f"node 5 left Operational: it is {name} [FH-232]"


def test_three_missing_heartbeats_are_a_loss():
    bench = Bench(heartbeat_s=0.1)
    assert bench.heard(after_ms=5000).message == ""  # it never had one
    bench.heartbeat(OPERATIONAL)
    for _ in range(5):
        assert bench.heard(after_ms=150).message == ""
        bench.heartbeat(OPERATIONAL)
    assert bench.heard(after_ms=300).message == ""
    assert codes_in(bench.heard(after_ms=1).message) == "FH-230"
    bench.heartbeat(OPERATIONAL)
    assert codes_in(bench.heard().message) == "FH-230"  # a loss is not forgotten


@given(st.lists(st.tuples(st.sampled_from([TPDO1, TPDO2, EMCY, HEARTBEAT]), st.binary(max_size=8)), max_size=30))
def test_no_bytes_on_the_bus_break_the_decoder(frames):
    bench = Bench()
    for start in range(0, len(frames), 4):
        feedback = bench.cycle(*frames[start : start + 4])
        assert all(map(math.isfinite, (feedback.position, feedback.velocity, feedback.torque)))
        assert isinstance(feedback.state, DriveState)
        data = bytes.fromhex(bench.command(Request.ENABLE))
        assert len(data) == 8
        assert data[0] in (0x00, 0x06, 0x07, 0x0F), "neither a fault reset nor a quick stop"


# --- commands


@pytest.mark.parametrize(
    ("mode", "data"),
    [(Mode.CSP, "0f00 dc050000 9cff"), (Mode.CSV, "0f00 18fcffff 9cff"), (Mode.CST, "0f00 9cff")],
)
def test_a_command_is_packed_as_it_is_mapped_and_one_that_is_not_finite_makes_no_frame(mode, data):
    bench = Bench(mode)
    bench.heard()
    assert bench.command(Request.ENABLE, 1.5, -2.0, -0.064) == data.replace(" ", "")
    for value in (math.nan, math.inf):
        wrong = [{"torque": value}, {"position": value, "velocity": value}]
        for values in wrong[: 1 if mode is Mode.CST else 2]:
            with pytest.raises(ValueError, match="cannot be sent"):
                bench.command(Request.ENABLE, **values)


@pytest.mark.parametrize(
    ("word", "state", "words"),
    [
        (0x0250, DriveState.SWITCH_ON_DISABLED, {Request.ENABLE: 0x06}),
        (0x0231, DriveState.READY_TO_SWITCH_ON, {Request.ENABLE: 0x07}),
        (0x0233, DriveState.SWITCHED_ON, {Request.ENABLE: 0x0F, Request.DISABLE: 0x06}),
        (0x1237, DriveState.OPERATION_ENABLED, {Request.ENABLE: 0x0F, Request.QUICK_STOP: 0x02, Request.DISABLE: 0x07}),
        # ENABLE leaves the quick stop through Switch On Disabled
        (0x0217, DriveState.QUICK_STOP_ACTIVE, {Request.ENABLE: 0x00, Request.QUICK_STOP: 0x02, Request.DISABLE: 0x00}),
        (0x021F, DriveState.FAULT_REACTION_ACTIVE, {Request.ENABLE: 0x00}),
        (0x0218, DriveState.FAULT, {Request.ENABLE: 0x00, Request.DISABLE: 0x00}),  # a fault stays
        (0x0200, DriveState.NOT_READY, {}),
    ],
)
def test_the_statusword_is_decoded_and_the_controlword_asks_for_one_step_towards_the_request(word, state, words):
    bench = Bench()
    assert bench.heard(state=word).state is state
    sent = {request: bench.command(request)[:4] for request in words}
    assert sent == {request: struct.pack("<H", wanted).hex() for request, wanted in words.items()}


def test_a_fault_is_reset_by_a_rising_edge_and_only_in_fault():
    bench = Bench()
    bench.heard(state=0x0218)
    words = [bench.command(Request.RESET_FAULT)[:4] for _ in range(4)]
    assert words == ["8000", "0000", "8000", "0000"]
    bench.heard(state=0x0250)
    assert bench.command(Request.RESET_FAULT)[:4] == "0000"
    assert bench.command(Request.ENABLE)[:4] == "0600"


def test_a_torque_beyond_16_bits_saturates():
    bench = Bench(Mode.CST)
    bench.heard()
    assert [bench.command(Request.ENABLE, torque=torque) for torque in (1e6, -1e6)] == ["0f00ff7f", "0f000080"]


def test_a_drive_that_is_only_listened_to_gets_no_command():
    bench = Bench(is_listened_to=True)
    bench.heard()
    with pytest.raises(DriveError, match="x: a drive that is only listened to"):
        bench.axis.encode(Command(Request.DISABLE))
    assert [pdo.cob_id for pdo in bench.axis.pdos] == [TPDO1, TPDO2]


def test_a_copy_decodes_by_itself():
    bench = Bench()
    bench.heard(1000)
    copy = bench.axis.copy()
    copy.begin_cycle(0)
    for can_id, data in answers(77, state=0x0218):
        copy.handlers[can_id](data)
    feedback = Feedback()
    copy.report(feedback, 0)
    assert feedback.state is DriveState.FAULT
    assert bench.cycle().state is DriveState.OPERATION_ENABLED


def decoder():
    return FeedbackDecoder(Bench().axis.drive.tpdos, UNITS, Mode.CSP, 1e-3)


def at(counts):
    return [struct.pack("<Hih", 0x0637, counts, 0), bytes(5)]


@pytest.mark.parametrize(
    ("before", "after"),
    [(None, -(1 << 31) + 4), ((1 << 31) - 1, (1 << 31) + 4), (-(1 << 32), -(3 << 31) + 4)],
)
def test_a_position_is_unwrapped_from_the_cycle_before(before, after):
    assert decoder().decode(at(-(1 << 31) + 4), Measurement(counts=before)).counts == after


@given(st.integers(-(1 << 31), (1 << 31) - 1), st.lists(st.integers(-(1 << 31) + 1, (1 << 31) - 1), max_size=50))
def test_a_position_is_followed_through_all_wraps(start, steps):
    true, measured, one = start, Measurement(), decoder()
    for step in [0, *steps]:
        true += step
        measured = one.decode(at(wrap(true)), measured)
        assert measured.counts == true


# --- PDOs of any layout


def pdos(*contents, first=0x181):
    """PDOs from lists of (object, struct code); a code alone is a field that is skipped."""
    return tuple(
        MappedPdo(
            first + 0x100 * number,
            tuple(one[0] for one in content if not isinstance(one, str)),
            struct.Struct("<" + "".join(one if isinstance(one, str) else one[1] for one in content)),
        )
        for number, content in enumerate(contents)
    )


def test_feedback_is_found_wherever_it_stands():
    """In any order, in several PDOs, beside fields of other objects, twice, and wider than in the standard."""
    tpdos = pdos(
        ["3x", (objects.MODE_DISPLAY, "b"), (objects.STATUSWORD, "H")],
        [(objects.TORQUE_ACTUAL, "i"), (objects.STATUSWORD, "H")],
        [(objects.VELOCITY_ACTUAL, "i"), (objects.POSITION_ACTUAL, "i")],
    )
    frames = [struct.pack("<3sbH", b"???", 9, 0x0637), struct.pack("<iH", -12, 0), struct.pack("<ii", -1000, 1000)]
    measured = FeedbackDecoder(tpdos, UNITS, Mode.CSV, 1e-3).decode(frames, Measurement())
    assert measured == (DriveState.OPERATION_ENABLED, 1000, 1.0, -2.0, pytest.approx(-12 * 0.64e-3), 9, 0x0637)


def test_a_drive_that_reports_little_more_than_its_position_can_be_followed():
    """No 606Ch: the velocity follows from the position, over lost cycles too; no 6077h; no 6061h."""
    tpdos = pdos([(objects.STATUSWORD, "H"), (objects.POSITION_ACTUAL, "i")])
    bench = Bench(tpdos=tpdos, period_s=2e-3)
    heard = []
    for counts in (5000, 5020, None, 5000):
        frames = [] if counts is None else [(0x181, struct.pack("<Hi", 0x0637, counts))]
        heard.append(bench.cycle(*frames, after_ms=2))
    assert [one.message for one in heard] == [""] * 4
    assert [one.is_fresh for one in heard] == [True, True, False, True]
    first, second, _, last = (one.velocity for one in heard)
    assert first == 0.0
    assert second == pytest.approx(20 / 1000.0 / 2e-3)
    assert last == pytest.approx(-20 / 1000.0 / 4e-3)
    assert heard[-1].torque == 0.0


def encoded(rpdos, mode, command):
    return CommandEncoder({pdo.cob_id: pdo for pdo in rpdos}, mode, UNITS).encode(0x0F, command)


def test_commands_go_wherever_they_are_mapped():
    """In any order, in several PDOs, beside constant values, the controlword in each, 60B2h of 32 bits."""
    other = objects.Object(0x6081, "profile velocity", objects.DataType.UNSIGNED32)
    rpdos = [
        MappedPdo(0x305, (other, objects.CONTROLWORD), struct.Struct("<4sH"), carried={other: b"abcd"}),
        MappedPdo(0x405, (objects.TORQUE_OFFSET, objects.CONTROLWORD), struct.Struct("<iH")),
        MappedPdo(0x505, (objects.TARGET_POSITION,), struct.Struct("<i")),
    ]
    assert encoded(rpdos, Mode.CSP, Command(Request.ENABLE, 1.0, 0.0, -0.064)) == [
        (0x305, b"abcd\x0f\x00"),
        (0x405, struct.pack("<iH", -100, 0x0F)),
        (0x505, struct.pack("<i", 1000)),
    ]
    # without a torque offset it gets its target alone
    rpdos = pdos([(objects.CONTROLWORD, "H"), (objects.TARGET_VELOCITY, "i")], first=RPDO1)
    [frame] = encoded(rpdos, Mode.CSV, Command(Request.ENABLE, 0.0, 2.0, 0.1))
    assert frame == (RPDO1, struct.pack("<Hi", 0x0F, 1000))


@pytest.mark.parametrize(
    ("statusword", "words"),
    [
        (0x0250, "6041h = 0250h"),
        (0x0240, "6041h = 0240h: no voltage"),
        (0x0080 | 0x0231, "6041h = 02B1h: a warning"),
        (0x0040, "6041h = 0040h: no voltage, not in remote control, so that it takes no controlword"),
        (0x0637, ""),  # enabled
    ],
)
def test_the_statusword_of_a_drive_that_is_not_enabled_is_told_in_words(statusword, words):
    assert Bench().heard(state=statusword).status == words
