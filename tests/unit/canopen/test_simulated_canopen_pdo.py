"""PDOs of a simulated drive: mapping through SDO, transmission types, inhibit times, event timers."""

import struct

import pytest

from tests.canopen_bench import Bench

CONTROLWORD, TARGET_POSITION, TARGET_TORQUE, TORQUE_OFFSET = 0x60400010, 0x607A0020, 0x60710010, 0x60B20010
STATUSWORD, POSITION, TORQUE = 0x60410010, 0x60640020, 0x60770010
READ_ONLY_STATE = 0x06010000
NOT_MAPPABLE, TOO_LONG = 0x06040041, 0x06040042


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_enabled_pdo_keeps_its_mapping(bench: Bench) -> None:
    for mapping in (0x1600, 0x1A00):
        assert bench.try_write(mapping, 0, "B", 0) == READ_ONLY_STATE
        assert bench.try_write(mapping, 1, "I", CONTROLWORD) == READ_ONLY_STATE
    assert bench.try_write(0x1400, 1, "I", 0x207) == READ_ONLY_STATE
    assert bench.try_write(0x1400, 1, "I", 0x205) == 0, "the same identifier is no change"
    assert bench.try_write(0x1800, 3, "H", 5) == READ_ONLY_STATE


@pytest.mark.parametrize(
    ("mapping", "word"),
    [
        (0x1600, 0x12340010),  # no such object
        (0x1600, 0x60400110),  # no such sub-index
        (0x1600, 0x60400020),  # wrong width
        (0x1600, STATUSWORD),  # read-only in an RPDO
        (0x1600, 0x60850020),  # not mappable
        (0x1600, 0x00010001),  # dummy of one bit
        (0x1A00, 0x00060010),  # dummy in a TPDO
        (0x1A00, 0x60770020),  # wrong width
        (0x1A00, 0x10080000),  # a text
    ],
)
def test_what_cannot_be_mapped(bench: Bench, mapping: int, word: int) -> None:
    bench.write(0x1400, 1, "I", 0x80000205)
    bench.write(0x1800, 1, "I", 0x80000185)
    bench.write(mapping, 0, "B", 0)
    assert bench.try_write(mapping, 1, "I", word) == NOT_MAPPABLE


def test_mapping_is_changed_with_a_count_of_zero_and_holds_eight_bytes(bench: Bench) -> None:
    bench.write(0x1400, 1, "I", 0x80000205)
    assert bench.try_write(0x1600, 1, "I", TARGET_TORQUE) == READ_ONLY_STATE
    bench.write(0x1600, 0, "B", 0)
    for position, word in enumerate((TARGET_POSITION, 0x60FF0020, CONTROLWORD), 1):
        bench.write(0x1600, position, "I", word)
    assert bench.try_write(0x1600, 0, "B", 3) == TOO_LONG
    assert bench.try_write(0x1600, 0, "B", 9) == 0x06090031
    bench.write(0x1600, 0, "B", 2)
    assert bench.try_write(0x1600, 0, "B", 4) == NOT_MAPPABLE, "the fourth entry is empty"


@pytest.mark.parametrize("cob_id", [0x000, 0x07F, 0x101, 0x180, 0x585, 0x605, 0x6E0, 0x705, 0x7FF, 0x20000205, 0x805])
def test_reserved_identifiers_are_refused(bench: Bench, cob_id: int) -> None:
    bench.write(0x1401, 1, "I", 0x80000000 | 0x305)
    assert bench.try_write(0x1401, 1, "I", cob_id) == 0x06090030


@pytest.mark.parametrize(
    ("kind", "abort"), [(0, 0), (240, 0), (254, 0), (255, 0), (241, 0x06090030), (252, 0x06090030)]
)
def test_transmission_types(bench: Bench, kind: int, abort: int) -> None:
    assert bench.try_write(0x1400, 2, "B", kind) == abort
    assert bench.try_write(0x1800, 2, "B", kind) == abort


def test_pdos_live_in_operational_and_a_synchronous_rpdo_takes_effect_at_the_next_sync(bench: Bench) -> None:
    bench.map(0x1400, 0x1600, 0x205, 1, [TARGET_TORQUE, TORQUE_OFFSET])
    bench.map(0x1800, 0x1A00, 0x185, 1, [STATUSWORD])
    bench.send(0x205, struct.pack("<hh", 99, 99))
    assert bench.sync() == []
    bench.nmt(0x01)
    bench.send(0x205, struct.pack("<hh", 111, -7))
    assert bench.read(0x6071, 0, "h") == 0
    assert len(bench.sync()) == 1
    assert (bench.read(0x6071, 0, "h"), bench.read(0x60B2, 0, "h")) == (111, -7)
    bench.nmt(0x02)
    assert bench.sync() == []


def test_short_rpdo_is_reported_and_ignored_and_a_long_one_taken(bench: Bench) -> None:
    bench.map(0x1400, 0x1600, 0x205, 255, [CONTROLWORD, TARGET_TORQUE])
    bench.nmt(0x01)
    frames = bench.send(0x205, b"\x06\x00\x6f")
    assert frames == [(0x085, bytes.fromhex("10 82 11 00 00 00 00 00")), (0x185, b"\xd0\x02")]
    assert bench.send(0x205, b"\x06\x00\x6f") == [], "reported once"
    assert bench.read(0x6071, 0, "h") == 0
    assert bench.statusword & 0x80, "warning"
    assert bench.send(0x205, b"\x00\x00\x6f\x00\xff\xff") == [(0x085, bytes(8)), (0x185, b"\x50\x02")]
    assert bench.read(0x6071, 0, "h") == 0x6F
    assert not bench.statusword & 0x80


@pytest.mark.parametrize("kind", [0, 1, 2, 3, 240])
def test_tpdo_comes_with_every_nth_sync_or_when_its_content_changed(bench: Bench, kind: int) -> None:
    bench.map(0x1800, 0x1A00, 0x185, kind, [STATUSWORD])
    bench.nmt(0x01)
    answers = [len(bench.sync()) for _ in range(2 * kind or 3)]
    assert answers == ([*[0] * (kind - 1), 1] * 2 if kind else [1, 0, 0])
    bench.write(0x6040, 0, "H", 0x06)
    assert [bench.sync() for _ in range(kind or 1)][-1] == [(0x185, b"\x31\x02")]
    assert bench.sync() == [] or kind == 1


def test_inhibit_time_holds_changes_back() -> None:
    bench = Bench(is_paced_by_sync=False)
    for subindex, code, value in ((1, "I", 0x80000185), (3, "H", 50), (1, "I", 0x185)):  # 5 ms
        bench.write(0x1800, subindex, code, value)
    bench.nmt(0x01)
    sent = []
    for time in range(1, 21):
        bench.at(time)
        sent += [time] * (0x185 in dict(bench.send(0x205, struct.pack("<H", 0x06 if time % 2 else 0x00))))
    assert sent == [5, 10, 15, 20] or sent == [5, 11, 17], sent


def test_dummies_skip_bytes_and_a_refused_value_leaves_the_others(bench: Bench) -> None:
    bench.map(0x1400, 0x1600, 0x205, 255, [0x00050008, TARGET_TORQUE, 0x00070020])
    bench.nmt(0x01)
    bench.send(0x205, struct.pack("<BhI", 0xFF, -5, 0xFFFFFFFF))
    assert bench.read(0x6071, 0, "h") == -5
    bench.map(0x1400, 0x1600, 0x205, 255, [0x60600008, TARGET_TORQUE])
    bench.send(0x205, struct.pack("<bh", 8, 1))
    bench.send(0x205, struct.pack("<bh", 3, 2))  # profile velocity, which the drive lacks
    assert (bench.read(0x6060, 0, "b"), bench.read(0x6071, 0, "h")) == (8, 2)
