"""Lines of text on the driver's side: requests, replies, and what must never be taken for a reply."""

import math

import pytest
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.checksum import Checker
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.driver import AsciiLine
from friction_hil_drivers.ascii.messages import sealer
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.serial_line.description import ready
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image, ReplyError
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.checked_yaml.files import read_section
from friction_hil.errors import UsageError

FAST, SLOW = ("position", "velocity"), ("torque", "status", "error")
READY = {name: read_section(path, AsciiDescription) for name, path in ready(DESCRIPTIONS).items()}
ODRIVE, COPLEY = READY["odrive"], READY["copley_ascii"]
# A drive that does what others do not: answers its set-points with feedback, echoes, knows its name in replies.
BUS = AsciiDescription.model_validate(
    {
        "version": 1,
        "protocol": "ascii",
        "name": "drive on a bus",
        "sources": ["this test"],
        "request_end": "\r",
        "reply_end": "\r\n",
        "echo": True,
        "acknowledge": "+",
        "error_replies": {r"!\d+": "refused", "!.*": "something else"},
        "signals": {
            "position": {"unit": "count", "bits": 16},
            "velocity": {"unit": "rpm"},
            "torque": {"unit": "per_mille", "bits": 16},
            "status": {"bits": 8, "is_signed": False},
            "control": {"bits": 8, "is_signed": False},
            "position_command": {"unit": "count", "bits": 16},
            "velocity_command": {"unit": "rpm"},
            "torque_command": {"unit": "per_mille", "bits": 16},
        },
        "messages": {
            "state": {"request": "#{axis}S", "reply": "#{axis}S{status:hex}"},
            "motion": {"request": "#{axis}M", "reply": "#{axis}M{position:hex},{velocity:float}"},
            "all": {"request": "#{axis}A", "reply": "#{axis}A{position:hex},{velocity:float},{torque:int}"},
            "torque": {"request": "#{axis}T{torque_command:int}", "reply": "#{axis}T{torque:int}"},
            "go": {
                "request": "#{axis}G{position_command:hex},{torque_command:int}",
                "reply": "#{axis}M{position:hex},{velocity:float}",
            },
            "velocity": {"request": "#{axis}V{velocity_command:float}"},
            "on": {"request": "#{axis}ON", "sets": {"control": 1}},
            "off": {"request": "#{axis}OFF", "sets": {"control": 0}},
        },
        "states": [{"state": "operation_enabled", "value": 1}, {"state": "switch_on_disabled", "value": 0}],
        "modes": {
            "cst": {"commands": ["torque_command"]},
            "csv": {"commands": ["velocity_command", "torque_command"]},
            "csp": {"commands": ["position_command", "torque_command"]},
        },
        "enable": [{"write": {"control": 1}, "until": "operation_enabled"}],
        "disable": [{"write": {"control": 0}, "until": "switch_on_disabled"}],
    }
)


def on_line(description, axis="0"):
    """A line with one axis, x."""
    options = AsciiOptions.model_validate({"line": {"port": "/dev/ttyS0"}, "description": "any", "axis": axis})
    image = Image()
    return AsciiLine({"x": description}, {"x": options}, {"x": image}), image


def plan_of(description, mode, axis="0"):
    line, image = on_line(description, axis)
    commands = description.modes[mode].commands if mode else ()
    slow = tuple(name for name in SLOW if name in description.signals)
    image.values.update(position_command=-2.0, velocity_command=3.25, torque_command=-0.125)
    return line.plan({"x": CycleSignals(FAST, slow, commands)}), image


def requests(exchanges):
    return [exchange.encode() for exchange in exchanges]


def xored(text):
    """Line with the checksum of the ODrive, computed here once more."""
    value = 0
    for byte in text:
        value ^= byte
    return text + b"*" + str(value).encode() + b"\r\n"


def test_an_odrive_is_asked_for_its_feedback_and_commanded_as_its_manual_says():
    plan, _ = plan_of(ODRIVE, "cst")
    assert requests(plan.poll) == [b"f 0*118\n"]
    assert [line.split(b"*")[0] for line in requests(plan.background)] == [
        b"r axis0.motor.current_control.Iq_measured",
        b"r axis0.current_state",
        b"r axis0.error",
    ]
    assert requests(plan.push) == [xored(b"c 0 -0.12500").replace(b"\r", b"")]
    assert requests(plan_of(ODRIVE, "csv", "1")[0].push) == [xored(b"v 1 3.25000 -0.12500").replace(b"\r", b"")]
    assert requests(plan_of(ODRIVE, "csp")[0].push) == [xored(b"p 0 -2.000000 0 -0.12500").replace(b"\r", b"")]
    assert plan.push[0].reply_size == 0


def test_a_copley_drive_is_asked_one_by_one_and_acknowledges():
    plan, image = plan_of(COPLEY, "cst", "")
    image.values["torque_command"] = -150.4
    assert requests(plan.poll) == [b"g r0x32\r", b"g r0x18\r"]
    assert requests(plan.background) == [b"g r0x0c\r", b"g r0xa0\r", b"g r0xa4\r"]
    assert requests(plan.push) == [b"s r0x02 -150\r"]
    assert plan.push[0].take(bytearray(b"ok\r"))


def test_what_comes_along_is_not_asked_for_again():
    heard, _ = plan_of(BUS, None)
    assert [exchange.reads for exchange in heard.poll] == [("position", "velocity", "torque")]
    assert [exchange.reads for exchange in heard.background] == [("status",)]
    assert heard.push == ()
    torque, _ = plan_of(BUS, "cst")
    assert [exchange.reads for exchange in torque.poll] == [("position", "velocity")]
    assert [exchange.reads for exchange in torque.push] == [("torque",)]


def test_a_command_that_is_answered_with_feedback_rides_in_the_poll():
    plan, _ = plan_of(BUS, "csp")
    assert [(exchange.writes, exchange.reads) for exchange in plan.poll] == [
        (("position_command", "torque_command"), ("position", "velocity"))
    ]
    assert plan.push == ()
    assert requests(plan.poll) == [b"#0GFFFE,0\r"]
    plan, _ = plan_of(BUS, "csv")  # no single message has both commands
    assert sorted(requests(plan.push)) == [b"#0T0\r", b"#0V3.250000\r"]


@pytest.mark.parametrize("description", [*READY.values(), BUS], ids=lambda description: description.name)
def test_every_mode_and_every_step_has_its_messages(description):
    line, image = on_line(description)
    image.values.update(dict.fromkeys(description.signals, 0.0))
    for mode in description.modes:
        plan_of(description, mode)
    for steps in description.sequences.values():
        for step in steps:
            image.values.update(step.write)
            exchange = line.write("x", tuple(step.write))
            assert len(exchange.encode()) <= exchange.request_size
    for exchange in plan_of(description, None)[0].background:
        for name in exchange.reads:
            assert name in line.read("x", (name,)).reads


@pytest.mark.parametrize(
    ("ask", "named"),
    [
        (lambda line: line.read("x", ("error",)), "x: .*error"),
        (lambda line: line.read("x", ("position", "status")), "position and status"),
        (lambda line: line.write("x", ("status",)), "status"),
        (lambda line: line.plan({"x": CycleSignals(("position",), (), ("position_command",))}), "position_command"),
    ],
)
def test_what_no_message_has_is_refused_with_its_name(ask, named):
    with pytest.raises(UsageError, match=named):
        ask(on_line(BUS)[0])


def test_a_fixed_number_chooses_its_message():
    line, image = on_line(BUS)
    exchange = line.write("x", ("control",))
    image.values["control"] = 1.0
    assert exchange.encode() == b"#0ON\r"
    image.values["control"] = 0.0
    assert exchange.encode() == b"#0OFF\r"
    image.values["control"] = 7.0
    with pytest.raises(ValueError, match=r"control = 7.0 .* control = 1; control = 0"):
        exchange.encode()


@given(
    mode=st.sampled_from(["cst", "csv", "csp"]),
    value=st.one_of(st.floats(), st.integers(-10, 10).map(float)),
    description=st.sampled_from([ODRIVE, BUS]),
)
def test_a_request_is_never_longer_than_it_says_and_never_holds_what_is_no_number(mode, value, description):
    plan, image = plan_of(description, mode)
    image.values.update(dict.fromkeys(description.modes[mode].commands, value))
    for exchange in (*plan.push, *(exchange for exchange in plan.poll if exchange.writes)):
        if math.isfinite(value):
            assert len(exchange.encode()) <= exchange.request_size
        else:
            with pytest.raises(ValueError, match="cannot be sent"):
                exchange.encode()


def feedback_of(description, axis="0"):
    plan, image = plan_of(description, None, axis)
    plan.poll[0].encode()
    return plan.poll[0], image


def taken(exchange, data):
    """Take what comes in one piece; whether it was a whole reply. Nothing may be left but what follows a reply."""
    received = bytearray(data)
    is_complete = exchange.take(received)
    assert is_complete or received == data or not received.strip(b"\r\n\0")
    return is_complete


def test_a_reply_fills_the_image_and_what_follows_it_is_left_alone():
    exchange, image = feedback_of(ODRIVE)
    reply = xored(b"1.250000 -0.500000")
    received = bytearray(reply + b"invalid mo")
    assert exchange.take(received)
    assert received == b"invalid mo"
    assert (image.values["position"], image.values["velocity"]) == (1.25, -0.5)
    assert image.fresh == {"position", "velocity"}
    assert len(reply) <= exchange.reply_size


@pytest.mark.parametrize(("text", "number"), [(b"8", 8.0), (b"1d", 1.0)])
def test_an_enumeration_with_a_stray_letter_is_read_as_the_drive_means_it(text, number):
    line, image = on_line(ODRIVE)
    status = line.read("x", ("status",))
    status.encode()
    assert taken(status, xored(text))
    assert image.values["status"] == number


positions = st.floats(-99999.0, 99999.0)


@given(positions, st.floats(-9999.0, 9999.0), st.data())
def test_a_reply_may_come_in_any_pieces(position, velocity, data):
    exchange, image = feedback_of(ODRIVE)
    rest = b"\r\n" * data.draw(st.booleans()) + xored(b"%f %f" % (position, velocity))
    received = bytearray()
    while rest:
        count = data.draw(st.integers(1, len(rest)))
        received += rest[:count]
        rest = rest[count:]
        assert exchange.take(received) == (not rest)
        assert bool(image.fresh) == (not rest)
    assert image.values["position"] == pytest.approx(position, rel=0.0, abs=0.5e-6 + 1e-10)
    assert image.values["velocity"] == pytest.approx(velocity, rel=0.0, abs=0.5e-6 + 1e-10)
    assert not received


@given(st.lists(st.tuples(st.sampled_from([b"", b"\r\n", b"\0"]), st.sampled_from([1.0, 2.0])), max_size=6))
def test_stray_characters_before_a_reply_do_not_make_it_the_one_before(replies):
    exchange, image = feedback_of(ODRIVE)
    for stray, position in replies:
        assert taken(exchange, stray + xored(b"%.1f 2.0" % position))
        assert image.values["position"] == position


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *((xored(text), "expected:") for text in (b"1.0", b"1.0 2.0 3.0", b"8", b"nan 0.0", b"inf 0.0")),
        (xored(b"0.0 1e999"), "velocity"),
        (xored(b"1.0 2.0").replace(b"1.0", b"1.1"), "expected: *34"),
        *((text, "no checksum") for text in (b"1.0 2.0\r\n", b"1.0 2.0*\r\n")),
        (b"\xff\xfe1.0 2.0*17\r\n", "checksum"),
        *((b"1" * 300 + end, "256 characters") for end in (b"", b" 2.0\r\n")),
    ],
)
def test_what_is_no_reply_is_refused_whole(line, words):
    exchange, image = feedback_of(ODRIVE)
    with pytest.raises(ReplyError) as caught:
        taken(exchange, line)
    assert words in str(caught.value)
    assert not caught.value.is_complete  # more may come
    assert not image.fresh
    assert not {"position", "velocity"} & image.values.keys()


@pytest.mark.parametrize(
    "text", [b"invalid command format", b"invalid motor 3", b"invalid property", b"unknown command"]
)
def test_the_error_of_a_set_point_is_never_taken_for_the_reply_that_follows(text):
    exchange, image = feedback_of(ODRIVE)
    with pytest.raises(ReplyError, match="earlier request") as caught:
        exchange.take(bytearray(xored(text) + xored(b"1.0 2.0")))
    assert text.decode() in str(caught.value)
    assert not caught.value.is_complete  # the reply to this request is still to come
    assert not image.fresh


@pytest.mark.parametrize(
    ("is_push", "line", "words", "is_complete"),
    [
        (False, b"e 9\r", "unknown parameter", True),  # the reply of a drive that answers everything
        (True, b"e -77\r", "-77", True),
        (False, b"ok\r", "expected:", False),  # an acknowledgement is not a value
        (True, b"v 1\r", "expected:", False),  # nor a value an acknowledgement
    ],
)
def test_what_a_copley_drive_says_in_place_of_its_reply_is_told(is_push, line, words, is_complete):
    plan, image = plan_of(COPLEY, "cst", "")
    exchange = (plan.push if is_push else plan.poll)[0]
    exchange.encode()
    with pytest.raises(ReplyError, match=words) as caught:
        exchange.take(bytearray(line))
    assert caught.value.is_complete is is_complete
    assert not image.fresh


def test_an_echo_comes_before_the_reply():
    exchange, image = feedback_of(BUS)
    assert exchange.encode() == b"#0A\r"
    whole = b"\n#0A\r\r\n#0AFFFF,-1.5,-3\r\n"
    for count in range(len(whole)):
        assert not exchange.take(bytearray(whole[:count]))
        exchange.encode()
    received = bytearray()
    for count, byte in enumerate(whole, 1):  # an echo in pieces is dropped once
        received.append(byte)
        assert exchange.take(received) == (count == len(whole))
    assert image.values["position"] == -1.0
    assert len(whole) <= exchange.reply_size + 3  # with the stray line ends


@pytest.mark.parametrize(
    ("axis", "line", "words"),
    [
        ("0", b"#0A0001,1.0,2\r\n", "the echo"),
        ("0", b"#0M\r#0A0001,1.0,2\r\n", "the echo"),
        ("0", b"x#0A\r#0A0001,1.0,2\r\n", "the echo"),
        ("0", b"#0A\r#0A10000,1.0,2\r\n", "position"),  # of another width than described
        ("2", b"#2A\r#3A0001,1.0,5\r\n", "#3A0001"),  # of another axis
    ],
)
def test_a_reply_without_its_echo_or_of_another_form_is_none(axis, line, words):
    exchange, image = feedback_of(BUS, axis)
    with pytest.raises(ReplyError, match=words):
        exchange.take(bytearray(line))
    assert not image.fresh


def test_an_echo_alone_answers_what_has_no_reply():
    odrive = ODRIVE.model_copy(update={"echo": True})
    plan, _ = plan_of(odrive, "cst")
    request = plan.push[0].encode()
    assert len(request) <= plan.push[0].reply_size
    assert not taken(plan.push[0], request[:5])
    assert taken(plan.push[0], request)


def understood(data):
    """Return the numbers of the first line that is not empty, read by the manual of the ODrive alone."""
    lines = [line.strip(b"\r\n\0") for line in data.split(b"\r\n")[:-1]]
    first = next((line for line in lines if line), b"")
    body, star, checksum = first.rpartition(b"*")
    if not star or not checksum.strip(b" ").isdigit() or int(checksum) != int(xored(body).rpartition(b"*")[2]):
        return None
    try:
        position, velocity = (float(word) for word in body.decode().split())
    except ValueError:
        return None
    return {"position": position, "velocity": velocity}


numbers_and_noise = st.text("0123456789.-+e* \r\nnai", max_size=60).map(str.encode)
whole_lines = st.tuples(positions, positions).map(lambda pair: xored(b"%f %f" % pair))
pieces = st.one_of(st.binary(max_size=40), numbers_and_noise, whole_lines, st.just(b"\r\n"))


@given(st.lists(pieces, max_size=6).map(b"".join))
def test_random_bytes_never_crash_and_never_tell_what_was_not_said(data):
    exchange, image = feedback_of(ODRIVE)
    received = bytearray(data)
    try:
        is_complete = exchange.take(received)
    except ReplyError:
        is_complete = False
    values = {name: image.values[name] for name in image.fresh}
    assert bool(values) == is_complete
    if is_complete:
        assert values == understood(data)


@given(st.sampled_from(["cst", "csv", "csp"]), st.lists(st.binary(max_size=80), max_size=8))
def test_random_bytes_never_change_a_command(mode, chunks):
    for description in (COPLEY, BUS, ODRIVE):
        if mode not in description.modes:
            continue
        plan, image = plan_of(description, mode)
        before = dict(image.values)
        for exchange in (*plan.poll, *plan.background, *plan.push):
            request = exchange.encode()
            received = bytearray()
            for chunk in chunks:
                received += chunk
                try:
                    exchange.take(received)
                except ReplyError:
                    received.clear()
            assert exchange.encode() == request
        assert {name: image.values[name] for name in before} == before


def test_requests_may_go_out_together_whose_replies_differ_in_their_words():
    plan, _ = plan_of(ODRIVE, "cst")
    (feedback,), (first, second, *_) = plan.poll, plan.background
    assert first.may_follow(feedback)
    assert feedback.may_follow(first)
    assert not second.may_follow(first)
    assert not feedback.may_follow(feedback)
    assert not plan.push[0].may_follow(feedback), "it would be unknown what an error belongs to"


@given(st.floats(-9e4, 9e4), st.floats(-9e3, 9e3), st.floats(-900.0, 900.0))
def test_no_reply_to_one_of_requests_that_go_out_together_is_taken_for_one_to_another(p, v, t):
    assert ODRIVE.checksum is not None
    seal = sealer(Checker(ODRIVE.checksum), b"")
    plan, _ = plan_of(ODRIVE, "cst")
    replies = {"position": seal(b"%.6f %.6f" % (p, v)), "torque": seal(b"%.6f" % t)}
    for asked, answered in (("position", "torque"), ("torque", "position")):
        exchange = next(each for each in (*plan.poll, *plan.background) if asked in each.reads)
        exchange.encode()
        with pytest.raises(ReplyError):
            exchange.take(bytearray(replies[answered] + b"\r\n"))


@pytest.mark.parametrize("is_rs485", [False, True])
def test_on_a_line_with_one_pair_of_wires_nothing_is_sent_ahead(is_rs485):
    line = {"port": "/dev/ttyS0", "is_rs485": is_rs485}
    options = AsciiOptions.model_validate({"line": line, "description": "odrive"})
    assert AsciiLine({"x": ODRIVE}, {"x": options}, {"x": Image()}).ahead_chars == (0 if is_rs485 else 64)


def test_an_error_line_is_a_refusal_of_a_set_point_without_a_reply_and_nothing_else_is():
    assert ODRIVE.checksum is not None
    seal = sealer(Checker(ODRIVE.checksum), b"\r\n")
    plan, _ = plan_of(ODRIVE, "cst")
    (push,) = plan.push
    push.encode()
    assert push.reports_refusal
    assert not push.take(bytearray(b"invalid mo"))
    with pytest.raises(ReplyError, match="no axis") as error:
        push.take(bytearray(seal(b"invalid motor 7")))
    assert error.value.is_unsolicited
    with pytest.raises(ReplyError) as error:
        push.take(bytearray(seal(b"0.5")))
    assert not error.value.is_unsolicited
