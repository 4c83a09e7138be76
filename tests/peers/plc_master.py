"""A master that stands in for a PLC, on the canopen library: it moves one drive in csp, by SYNC or by events.

Nothing of the product is used. It maps statusword and position into TPDO 1, controlword and target into RPDO 1,
enables the drive and lets it follow a sine. What it gets back is kept, so that a test can see whether somebody else
has disturbed it.

As a process: ``python -m tests.peers.plc_master --port 41234 --node 1``; it says "moving" and ends when stdin closes.
"""

import argparse
import math
import struct
import sys
import threading
import time
from typing import Any

import canopen

from tests.peers.own_group import keep_to_own_group

EVENT_DRIVEN, SYNCHRONOUS = 255, 1
_OPERATION_ENABLED = 0x27
_STEPS = {0x40: 0x06, 0x60: 0x06, 0x21: 0x07, 0x23: 0x0F, 0x27: 0x0F}  # controlword by state bits
_PATIENCE_S = 20.0


class PlcMaster:
    """Master of one drive.

    Parameters
    ----------
    bus : dict
        Arguments of python-can.
    node : int
    is_event_driven : bool
        RPDO 1 and TPDO 1 of type 255 and no SYNC; otherwise type 1.
    period_s, amplitude_counts, frequency : float
        Of the set-points.
    """

    def __init__(
        self,
        bus: dict[str, Any],
        node: int,
        *,
        is_event_driven: bool = False,
        period_s: float = 0.01,
        amplitude_counts: int = 3000,
        frequency: float = 1.0,
    ) -> None:
        self._node, self._is_event_driven, self._period_s = node, is_event_driven, period_s
        self._amplitude, self._frequency = amplitude_counts, frequency
        self.feedback: list[tuple[float, int, int]] = []  # time, statusword, position in counts
        self._network: Any = canopen.Network()
        self._network.connect(**bus)
        keep_to_own_group(self._network.bus)
        self._sdo = self._network.add_node(node, object_dictionary=None).sdo
        self._sdo.RESPONSE_TIMEOUT = 2.0
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "PlcMaster":
        try:
            self._configure()
            self._thread.start()
            self._await(lambda: self._is_moving)
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    @property
    def is_in_command(self) -> bool:
        """The latest feedback is younger than ten periods, and shows Operation Enabled."""
        age = time.monotonic() - self.feedback[-1][0]
        return age < 10 * self._period_s and self.feedback[-1][1] & 0x6F == _OPERATION_ENABLED

    def dictionary(self) -> dict[tuple[int, int], bytes | None]:
        """Read the configuration of the drive: PDOs, watchdogs, modes and options; None: it has no such object."""
        found = {}
        entries = [(index, 0) for index in (0x1017, 0x6007, 0x605A, 0x6060)]
        entries += [(0x1016, 1), (0x60C2, 1), (0x60C2, 2)]
        for number in range(4):
            for base in (0x1400, 0x1800):
                entries += [(base + number, subindex) for subindex in (1, 2, 5)]
                entries += [(base + 0x200 + number, subindex) for subindex in range(4)]
        for index, subindex in entries:
            try:
                found[index, subindex] = bytes(self._sdo.upload(index, subindex))
            except canopen.SdoAbortedError:
                found[index, subindex] = None
        return found

    def _configure(self) -> None:
        self._network.nmt.send_command(0x80)
        kind = EVENT_DRIVEN if self._is_event_driven else SYNCHRONOUS
        self.map(0x1400, 0x200, kind, (0x60400010, 0x607A0020))
        self.map(0x1800, 0x180, kind, (0x60410010, 0x60640020))
        if self._is_event_driven:
            self._write(0x1800, 5, "H", 10)  # ms, event timer
        self._write(0x60C2, 1, "B", round(self._period_s * 1e3))
        self._write(0x60C2, 2, "b", -3)
        self._write(0x6060, 0, "b", 8)
        self._network.subscribe(0x180 + self._node, self._take)
        self._network.nmt.send_command(0x01)

    def map(self, record: int, base: int, kind: int, words: tuple[int, ...]) -> None:
        cob_id = base + self._node
        self._write(record, 1, "I", 0x80000000 | cob_id)
        self._write(record + 0x200, 0, "B", 0)
        for number, word in enumerate(words, 1):
            self._write(record + 0x200, number, "I", word)
        self._write(record + 0x200, 0, "B", len(words))
        self._write(record, 2, "B", kind)
        self._write(record, 1, "I", cob_id)

    def _write(self, index: int, subindex: int, code: str, value: int) -> None:
        self._sdo.download(index, subindex, struct.pack(f"<{code}", value))

    def _take(self, _can_id: int, data: bytes, _stamp: float) -> None:
        if len(data) == 6:
            status, position = struct.unpack("<Hi", data)
            self.feedback.append((time.monotonic(), status, position))

    @property
    def _is_moving(self) -> bool:
        return len({position for _, _, position in self.feedback[-50:]}) > 5

    def _run(self) -> None:
        """Send a set-point each period, by the state that the drive reported last."""
        began, base, due = None, 0, time.monotonic()
        while not self._is_over.is_set():
            due += self._period_s
            time.sleep(max(0.0, due - time.monotonic()))
            if not self._is_event_driven:
                self._network.send_message(0x080, b"")
            status, position = self.feedback[-1][1:] if self.feedback else (0x40, 0)
            is_enabled = status & 0x6F == _OPERATION_ENABLED
            if is_enabled and began is None:
                began, base = due, position
            phase = 0.0 if began is None else 2.0 * math.pi * self._frequency * (due - began)
            target = base + round(self._amplitude * (1.0 - math.cos(phase))) if is_enabled else position
            word = _STEPS.get(status & 0x6F, 0x00)
            self._network.send_message(0x200 + self._node, struct.pack("<Hi", word, target))

    def _await(self, is_done: Any) -> None:
        end = time.monotonic() + _PATIENCE_S
        while not is_done():
            if time.monotonic() > end:
                raise AssertionError(f"the drive does not follow: {self.feedback[-3:]}")
            time.sleep(0.02)

    def _stop(self) -> None:
        self._is_over.set()
        if self._thread.is_alive():
            self._thread.join()
        self._write(0x6040, 0, "H", 0)
        self._network.disconnect()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--group", default="239.74.163.2")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--node", type=int, required=True)
    parser.add_argument("--event-driven", action="store_true")
    options = parser.parse_args()
    bus = {"interface": "udp_multicast", "channel": options.group, "port": options.port, "hop_limit": 0}
    with PlcMaster(bus, options.node, is_event_driven=options.event_driven):
        print("moving", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
