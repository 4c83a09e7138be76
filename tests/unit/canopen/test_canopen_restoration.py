"""The order in which settings of a drive are restored, after CiA 301, and what other users' runs have kept."""

import json
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from friction_hil_drivers.canopen.connect.pdo_journal import CanopenJournal, restoration
from friction_hil_drivers.cia402.access import RefusedError
from friction_hil_drivers.cia402.journal import Found
from friction_hil_drivers.cia402.objects import DataType, Object


def found(index, subindex, data, kind=DataType.UNSIGNED32):
    return Found(Object(index, "", kind, subindex), None if data is None else bytes.fromhex(data))


def told(pairs):
    return [(f"{entry.index:X}:{entry.subindex}", data.hex()) for entry, data in pairs]


def test_a_mapping_is_restored_in_the_order_of_the_standard():
    groups = restoration(
        [
            found(0x1400, 1, "05020000"),
            found(0x1600, 0, "02", DataType.UNSIGNED8),
            found(0x1600, 1, "10004060"),
            found(0x1600, 2, "08006060"),
            found(0x1600, 3, "10007160"),  # behind the number of entries
            found(0x1400, 2, "ff", DataType.UNSIGNED8),
            found(0x605A, 0, "0200"),
            found(0x6007, 0, None),
        ]
    )
    assert [told(pairs) for pairs in groups] == [
        [("605A:0", "0200")],
        [
            ("1400:1", "05020080"),
            ("1600:0", "00"),
            ("1600:1", "10004060"),
            ("1600:2", "08006060"),
            ("1600:3", "10007160"),
            ("1600:0", "02"),
            ("1400:2", "ff"),
            ("1400:1", "05020000"),
        ],
    ]
    only_switched_off = restoration([found(0x1402, 1, "05040000")])
    assert [told(pairs) for pairs in only_switched_off] == [[("1402:1", "05040000")]]


KEPT = """{"version": 1, "entries": [
 {"index": 4118, "subindex": 1, "found": "00000000", "written": ["14007e00"]},
 {"index": 24668, "subindex": 0, "found": "0100", "written": ["0000"]},
 {"index": 24672, "subindex": 0, "found": "06", "written": ["08"]},
 {"index": 5120, "subindex": 1, "found": "05020000", "written": ["05020080", "05020000"]},
 {"index": 5632, "subindex": 0, "found": "01", "written": ["00", "02"]},
 {"index": 5632, "subindex": 1, "found": "10004060", "written": ["10004160"]},
 {"index": 4119, "subindex": 0, "found": "e803", "written": ["1400"]}]}"""  # as version 0.2 writes it


class Node:
    """A node that holds what a killed run has left, and takes everything but a heartbeat time."""

    axis, where = "x", "node 5 on can0"

    def __init__(self):
        self.taken = []
        entries = json.loads(KEPT)["entries"]
        self.values = {(each["index"], each["subindex"]): bytes.fromhex(each["written"][-1]) for each in entries}

    def peek(self, entry):
        return self.values.get(entry.address)

    def download(self, entry, data):
        if entry.index == 0x1017:
            raise RefusedError("refused")
        self.values[entry.address] = data
        self.taken.append((entry, data))


def test_what_an_older_version_has_kept_is_restored_in_order_and_named(tmp_path):
    path, node = tmp_path / "kept.json", Node()
    path.write_text(KEPT)
    journal = CanopenJournal(node, lambda _: path)
    journal.before(Object(0x605C, "disable operation option code", DataType.INTEGER16), b"\0\0")
    assert "7 objects" in journal.notes[0]
    assert journal.restore() == ["1017h producer heartbeat time was 03E8h and stays 0014h"]
    assert told(node.taken) == [
        ("1016:1", "00000000"),
        ("1400:1", "05020080"),
        ("1600:0", "00"),
        ("1600:1", "10004060"),
        ("1600:0", "01"),
        ("1400:1", "05020000"),
        ("6060:0", "06"),
        ("605C:0", "0100"),
    ]
    assert [each["index"] for each in json.loads(path.read_text())["entries"]] == [0x1017]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_what_another_users_killed_run_has_kept_shuts_out_nobody(request):
    folder = Path(tempfile.mkdtemp(dir="/tmp"))  # that of the test can be entered by nobody else
    request.addfinalizer(lambda: shutil.rmtree(folder))
    folder.chmod(0o1777)
    entry = Object(0x1017, "heartbeat", DataType.UNSIGNED16)

    def keep():
        journal = CanopenJournal(Node(), lambda identity: folder / f"can0-5-{identity}.json")
        journal.before(entry, b"\x08\0")
        return journal.notes

    pid = os.fork()
    if pid == 0:
        os.setuid(65534)
        keep()
        os._exit(0)
    assert os.waitpid(pid, 0)[1] == 0
    (theirs,) = folder.iterdir()
    (note,) = keep()
    assert note.startswith(f"a run of another user ended without restoring the drive's settings ({theirs})")
    (own,) = set(folder.iterdir()) - {theirs}
    assert keep() != [note]  # this user's own is taken over
    assert own.name.endswith("-0.json")
