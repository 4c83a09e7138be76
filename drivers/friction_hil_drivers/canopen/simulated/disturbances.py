"""Disturbances of a simulated node on their way to the bus: of its encoder, its statusword and its frames."""

import random
from collections import deque
from collections.abc import Callable, Sequence

from friction_hil_drivers.canopen.simulated.scenario import Event
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary
from friction_hil_drivers.cia402.units import wrap

_MS, _NS = 1_000_000, 1_000_000_000
_ENCODER = ("freeze_encoder", "jump_encoder")


class ShownValues:
    """6041h and 6064h as the bus sees them.

    To be made before any PDO maps them; entries that no event concerns are left alone.
    """

    def __init__(self, dictionary: Dictionary, events: Sequence[Event]) -> None:
        self._active: list[Event] = []
        self._held: int | None = None
        kinds = {event.do for event in events}
        position, statusword = dictionary.entries(objects.POSITION_ACTUAL, objects.STATUSWORD)
        self._position, self._statusword = position.reader(), statusword.reader()
        if kinds & set(_ENCODER):
            position.on_read = self._shown_position
        if "statusword" in kinds:
            statusword.on_read = self._shown_statusword

    def change(self, event: Event, *, begins: bool) -> None:
        """Begin or end an event of these values."""
        if event.do == "freeze_encoder":
            self._held = int(self._position()) if begins else None
        elif begins:
            self._active.append(event)
        else:
            self._active.remove(event)

    def _shown_position(self) -> int:
        position = int(self._position()) if self._held is None else self._held
        return wrap(position + sum(event.counts or 0 for event in self._active))

    def _shown_statusword(self) -> int:
        word = int(self._statusword())
        for event in self._active:
            word = (word | (event.set or 0)) & ~(event.clear or 0)
        return word


class DisturbedWire:
    """The node's way to the bus.

    ``send``: sends a frame. ``number_of``: returns the number of the TPDO with an identifier, None for other frames.
    """

    def __init__(self, send: Callable[[int, bytes], None], number_of: Callable[[int], int | None]) -> None:
        self._send = send
        self._number_of = number_of
        self._active: list[Event] = []
        self._late: deque[tuple[int, int, bytes]] = deque()  # due at, identifier, data
        self._random = random.Random(301)
        self._babbled_ns = 0
        self.now_ns = 0
        self.is_mute = False

    def change(self, event: Event, *, begins: bool) -> None:
        """Begin or end an event of the wire."""
        if begins:
            self._active.append(event)
            self._babbled_ns = self.now_ns
        else:
            self._active.remove(event)

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame as the events in force let it."""
        if self.is_mute:
            return
        number = self._number_of(can_id)
        if number is None:
            self._send(can_id, data)
            return
        due_ns = self.now_ns
        for event in self._active:
            if event.tpdo not in (None, number):
                continue
            if event.do == "stop_tpdo" or (event.do == "lose_tpdo" and self._random.random() < (event.share or 0.0)):
                return
            if event.do == "cut_tpdo":
                data = data[: event.length]
            elif event.do == "late_tpdo":
                due_ns += round((event.by_s or 0.0) * _NS)
        if due_ns > self.now_ns:
            self._late.append((due_ns, can_id, data))
        else:
            self._send(can_id, data)

    def pass_time(self, now_ns: int) -> None:
        """Send what was late and is due, and what a babbling node sends."""
        self.now_ns = now_ns
        while self._late and self._late[0][0] <= now_ns:
            _, can_id, data = self._late.popleft()
            if not self.is_mute:
                self._send(can_id, data)
        babbling = [event for event in self._active if event.do == "babble"]
        while babbling and not self.is_mute and now_ns - self._babbled_ns >= _MS:
            self._babbled_ns += _MS
            for event in babbling:
                for _ in range(event.per_ms or 1):
                    self._send(event.can_id or 0, bytes.fromhex(event.data or ""))

    @property
    def is_due(self) -> bool:
        """True if frames wait for their time."""
        return bool(self._late)
