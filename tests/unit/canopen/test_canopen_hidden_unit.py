"""A drive that has a unit of velocity, and does not show it: nobody guesses which one it is."""

import struct
import tempfile

import can
import pytest

from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven

NOT_NOW, GENERAL, NO_OBJECT = 0x08000022, 0x08000000, 0x06020000


class Hiding(BenchBus):
    """A drive that aborts a read of 60A9h."""

    def __init__(self, code):
        super().__init__(Bench())
        self.code = code

    def send(self, msg, timeout=None):
        data = bytes(msg.data)
        if msg.arbitration_id == 0x600 + NODE and data[:3] == b"\x40\xa9\x60":
            answer = b"\x80" + data[1:4] + struct.pack("<I", self.code)
            self.answers.put(can.Message(arbitration_id=0x580 + NODE, data=answer, is_extended_id=False))
            return
        super().send(msg)


def connect(code, tmp_path, monkeypatch, **keys):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Driven(bus=Hiding(code), **keys) as driven:
        return driven.facts


def test_for_velocity_targets_the_unit_must_be_known(tmp_path, monkeypatch):
    with pytest.raises(DriveError, match=r"60A9h.*08000022.*velocity_unit.*FH-214"):
        connect(NOT_NOW, tmp_path, monkeypatch, mode="csv")


@pytest.mark.parametrize(
    ("code", "keys"),
    [
        (NOT_NOW, {"mode": "csp"}),
        (NOT_NOW, {"mode": "cst"}),
        (NOT_NOW, {"mode": "csv", "velocity_unit": "counts/s"}),
        (GENERAL, {"mode": "csv"}),
        (NO_OBJECT, {"mode": "csv"}),
    ],
)
def test_otherwise_it_is_told_where_the_unit_comes_from(code, keys, tmp_path, monkeypatch):
    facts = connect(code, tmp_path, monkeypatch, **keys)
    [row] = [row for row in facts.units if row.quantity == "velocity"]
    if "velocity_unit" in keys:
        assert row.source == "velocity_unit"
    elif code == NOT_NOW:
        assert row.source.startswith("the assumption counts/s, as 60A9h was not read (")
        assert "0x08000022" in row.source
    else:
        assert row.source == "the assumption counts/s, as there is no 60A9h"
    is_noted = any("60A9h" in note and "taken as absent" in note for note in facts.notes)
    assert is_noted is (code != NO_OBJECT)
