"""Replies read at once: a line is one only if its checksum, its form and the absence of an error say so."""

import pytest
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.messages import LONGEST_LINE, Language, reader, sealer, take_line
from friction_hil_drivers.serial_line.description import load_description
from hypothesis import given
from hypothesis import strategies as st

ODRIVE = load_description("odrive", None, DESCRIPTIONS, AsciiDescription)
CHECKSUMS = {
    "none": None,
    "xor": {"kind": "xor", "form": "decimal", "prefix": "*"},
    "sum without a prefix": {"kind": "sum", "form": "hex", "skip": 1},
    "crc16": {"kind": "crc16", "form": "hex", "prefix": "~", "polynomial": 0x8005, "initial": 0xFFFF},
}
# the second one looks like a number of errors, and has a group of its own
ERRORS = {
    "unknown command": "the drive does not know it",
    r"-(1|2)(\.0)?": "a number that means an error",
    "^1e2$": "an expression that says where the line ends",
}


def language_of(checksum):
    return Language(
        AsciiDescription.model_validate(
            ODRIVE.model_dump(exclude_unset=True) | {"checksum": CHECKSUMS[checksum], "error_replies": ERRORS}
        ),
        "0",
    )


LANGUAGES = {name: language_of(name) for name in CHECKSUMS}
words = st.sampled_from(
    [b"-1", b"-1.0", b"-1.5", b"8", b"8d", b"1e2", b"1e999", b" ", b"  ", b"*", b"~", b"unknown command"]
)
lines = st.lists(words | st.binary(max_size=3), max_size=5).map(b"".join)


@given(st.sampled_from(sorted(CHECKSUMS)), lines, st.booleans())
def test_at_once_is_read_what_is_read_step_by_step(checksum, text, is_sealed):
    language = LANGUAGES[checksum]
    line = sealer(language.checker, b"")(text) if is_sealed else text
    for message in language.messages:
        for form in message.replies:
            try:
                bare = line if language.checker is None else language.checker.remove(line)
            except ValueError:
                bare = None
            try:
                expected = None if bare is None or language.meaning(bare) is not None else form.read(bare)
            except ValueError as error:
                with pytest.raises(ValueError, match=f"^{error}$"):
                    reader(form, language)(line + language.reply_end)
            else:
                read = reader(form, language)(line + language.reply_end + b"8")
                assert read == (None if expected is None else (expected, len(line) + len(language.reply_end)))
                assert reader(form, language)(line) is None  # it may go on


@pytest.mark.parametrize("checksum", CHECKSUMS)
def test_an_error_that_looks_like_a_number_is_no_number(checksum):
    language = LANGUAGES[checksum]
    (state,) = (message for message in language.messages if message.reads == ("torque",))
    read = reader(state.replies[0], language)
    line = language.seal_reply(b"-1.5")
    assert read(line) == ([-1.5], len(line))
    for error in (b"-1.0", b"1e2"):
        assert read(language.seal_reply(error)) is None
        assert read(language.seal_reply(error) + b"8") is None


@given(st.lists(st.binary(max_size=LONGEST_LINE + 40), max_size=3), st.integers(1, 400))
def test_lines_are_taken_one_by_one_however_they_come(pieces, size):
    """None is lost, invented or joined to another; what never ends is refused."""
    data, received, taken = b"\r\n".join(pieces) + b"\r\n", bytearray(), []
    is_refused = False
    for start in range(0, len(data), size):
        received += data[start : start + size]
        try:
            while (line := take_line(received, b"\r\n")) is not None:
                taken.append(line)
        except ValueError:
            assert not received
            is_refused = True
        assert len(received) < LONGEST_LINE + size + 2
    whole = [line for each in data.split(b"\r\n") if (line := each.strip(b"\r\n\0"))]
    if not is_refused:
        assert taken == whole
    assert is_refused or all(len(line) <= LONGEST_LINE + 1 for line in whole)
