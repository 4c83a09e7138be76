"""The frame recorder finds what it is made to find, and has nothing to say about a correct run."""

import struct

import pytest

from tools.campaigns.frame_recorder import Frame, Recorder

NODE = 5


class Bus:
    """A correct cycle by hand, to be spoilt."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self._time_s = 0.0

    def add(self, can_id: int, data: bytes | str = b"", after_s: float = 1e-4, *, is_remote: bool = False) -> None:
        self._time_s += after_s
        content = bytes.fromhex(data) if isinstance(data, str) else data
        self.frames.append(Frame(self._time_s, can_id, content, is_remote))

    def write(self, index: int, subindex: int, code: str, value: int) -> None:
        data = struct.pack("<" + code, value)
        head = struct.pack("<HB", index, subindex)
        self.add(0x600 + NODE, bytes([0x23 | (4 - len(data)) << 2]) + head + data.ljust(4, b"\0"))
        self.add(0x580 + NODE, b"\x60" + head + bytes(4))

    def configure(self) -> "Bus":
        for index, cob_id, words in ((0x1400, 0x205, (0x60400010, 0x60710010)), (0x1800, 0x185, (0x60410010,))):
            self.write(index, 1, "I", 0x80000000 | cob_id)
            self.write(index + 0x200, 0, "B", 0)
            for position, word in enumerate(words, 1):
                self.write(index + 0x200, position, "I", word)
            self.write(index + 0x200, 0, "B", len(words))
            self.write(index, 2, "B", 1)
            self.write(index, 1, "I", cob_id)
        self.add(0x000, bytes([1, NODE]))
        return self

    def cycle(self, status: int, control: int) -> None:
        self.add(0x080)
        self.add(0x180 + NODE, struct.pack("<H", status))
        self.add(0x200 + NODE, struct.pack("<Hh", control, 0))

    @property
    def rules(self) -> list[str]:
        return [each.rule for each in Recorder().take_all(self.frames).violations]


def running() -> Bus:
    bus = Bus().configure()
    for status, control in ((0x240, 0x06), (0x231, 0x07), (0x233, 0x0F), (0x237, 0x0F)):
        bus.cycle(status, control)
    return bus


def test_a_correct_run_has_no_violation() -> None:
    bus = running()
    bus.cycle(0x1237, 0x07)
    bus.cycle(0x233, 0x06)
    bus.cycle(0x231, 0x00)
    bus.add(0x000, bytes([0x80, NODE]))
    bus.add(0x700 + NODE, b"\x7f")
    bus.add(0x700 + NODE, is_remote=True)
    assert bus.rules == []


@pytest.mark.parametrize(
    ("rule", "frames"),
    [
        ("identifier", [(0x101, "")]),
        ("identifier", [(0x305, "")]),  # RPDO 2, once it is switched off below
        ("length", [(0x080, ""), (0x185, "3702"), (0x205, "0f00")]),
        ("length", [(0x080, ""), (0x185, "370200")]),
        ("length", [(0x085, "0000")]),
        ("sync", [(0x080, "01")]),
        ("order", [(0x080, ""), (0x205, "0f000000")]),
        ("order", [(0x080, ""), (0x185, "3702"), (0x185, "3706")]),
        ("order", [(0x080, ""), (0x185, "3702"), (0x205, "0f000000"), (0x205, "0f000100")]),
        ("nmt", [(0x000, "8005"), (0x080, ""), (0x080, ""), (0x080, ""), (0x185, "3702")]),
        ("nmt", [(0x705, "00"), (0x080, ""), (0x080, ""), (0x080, ""), (0x205, "00000000")]),
        ("nmt", [(0x000, "0305")]),
        ("control", [(0x080, ""), (0x185, "4002"), (0x205, "0f000000")]),
        ("control", [(0x080, ""), (0x185, "4002"), (0x205, "07000000")]),
        ("control", [(0x080, ""), (0x185, "3102"), (0x205, "0f000000")]),
        ("sdo", [(0x585, "4b41600037020000")]),
        ("sdo", [(0x605, "4041600000000000"), (0x605, "4064600000000000"), (0x585, "4364600000000000")]),
        ("sdo", [(0x605, "4041600000000000"), (0x585, "8064600000000206")]),
        ("sdo", [(0x605, "4008100000000000"), (0x585, "4108100009000000"), (0x605, "7000000000000000")]),
    ],
)
def test_each_rule_can_be_broken(rule: str, frames: list[tuple[int, str]]) -> None:
    bus = running()
    bus.write(0x1401, 1, "I", 0x80000305)
    assert bus.rules == []
    for can_id, data in frames:
        bus.add(can_id, data)
    assert set(bus.rules) == {rule}


def test_a_sync_counter_is_followed() -> None:
    bus = running()
    bus.write(0x1019, 0, "B", 4)
    for count in (1, 2, 3, 4, 1, 2):
        bus.add(0x080, bytes([count]))
    assert bus.rules == []
    bus.add(0x080, bytes([4]))
    bus.add(0x080)
    assert bus.rules == ["sync", "sync"]


def test_a_late_heartbeat_is_noticed() -> None:
    bus = running()
    bus.write(0x1017, 0, "H", 100)
    for after_s in (0.02, 0.1, 0.11, 0.1):
        bus.add(0x705, "05", after_s)
    assert bus.rules == []
    bus.add(0x705, "05", 0.2)
    assert bus.rules == ["heartbeat"]


def test_a_segmented_upload_is_well_formed() -> None:
    bus = running()
    for data in ("4008100000000000", "6000000000000000", "7000000000000000"):
        bus.add(0x605, data)
        bus.add(0x585, {"40": "4108100009000000", "60": "0041424344454647", "70": "1b48490000000000"}[data[:2]])
    assert bus.rules == []
