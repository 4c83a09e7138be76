"""Ring in shared memory that carries rows and events from the loop to the companion process.

One process writes, one reads. The writer never waits and never fails: a reader that is too slow loses rows, and
counts them. The memory has no name, so a process that dies leaves nothing behind; the child gets its file descriptor.

Every slot has the number of its row before and after the values. The writer sets the number before, copies the row,
sets the number after and then the count. The reader takes a row if both numbers are right, and the one before is still
right after the copy. This relies on stores becoming visible in order, as on x86-64; on other processors a row that is
being overwritten at that moment could pass unnoticed.
"""

import mmap
import os
import struct
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]

# Words of the header, each 8 bytes.
_MAGIC, _WIDTH, _CAPACITY, _CLOSED, _ROWS, _ROWS_DONE, _LOST, _EVENTS, _EVENTS_DONE, _EVENTS_LOST = range(10)
_HEADER_BYTES = 4096
_MAGIC_NUMBER = 0x31474E4952484946  # changes with the layout

EVENT_SLOTS = 256
_EVENT_BYTES = 256
_EVENT_HEAD = struct.Struct("<qdHH")  # number of the event, cycle, lengths of its two texts
_EVENT_TEXT_BYTES = _EVENT_BYTES - _EVENT_HEAD.size
_NAME_BYTES = 40


class _Ring:
    """Shared memory with views of its header and rows."""

    def __init__(self, descriptor: int, *, is_written: bool = True) -> None:
        self.descriptor = descriptor
        size = os.fstat(descriptor).st_size
        if size < _HEADER_BYTES:
            raise ValueError("the shared memory is no ring")
        if is_written:  # populated at once: a page fault in the loop could cost a period
            self._memory = mmap.mmap(descriptor, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE)
        else:
            self._memory = mmap.mmap(descriptor, size, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        self._header = memoryview(self._memory)[:_HEADER_BYTES].cast("q")
        if self._header[_MAGIC] != _MAGIC_NUMBER:
            raise ValueError("the shared memory is not a ring of this version")
        self.width = self._header[_WIDTH]
        self.capacity = self._header[_CAPACITY]
        values = np.frombuffer(self._memory, np.float64, offset=_HEADER_BYTES + EVENT_SLOTS * _EVENT_BYTES)
        size = self.capacity * (self.width + 2)
        self._rows = values[:size].reshape(self.capacity, self.width + 2)
        self.tail = values[size:]  # behind the rows, which the ring does not look at
        self._numbers = self._rows.view(np.int64)

    @property
    def rows_kept(self) -> int:
        """Number of rows that a reader has taken and released as safe."""
        return self._header[_ROWS_DONE] - self._header[_LOST]

    @property
    def rows_done(self) -> int:
        """Number of rows that are safe or lost: no reader needs them any more."""
        return self._header[_ROWS_DONE]

    @property
    def rows_lost(self) -> int:
        """Number of rows that readers have counted as lost."""
        return self._header[_LOST]

    @property
    def is_closed(self) -> bool:
        """True once the writer has closed the ring."""
        return bool(self._header[_CLOSED])

    def _event(self, number: int) -> tuple[float, str, str] | None:
        """Return cycle, name and text of an event, counted from 0; None if it has been overwritten."""
        at = _HEADER_BYTES + number % EVENT_SLOTS * _EVENT_BYTES
        record = self._memory[at : at + _EVENT_BYTES]
        first, cycle, name_size, text_size = _EVENT_HEAD.unpack_from(record)
        (last,) = struct.unpack_from("<q", record, _EVENT_BYTES - 8)
        if not (first == last == number + 1 and self._memory[at : at + 8] == record[:8]):
            return None
        text_at = _EVENT_HEAD.size + name_size
        return cycle, record[_EVENT_HEAD.size : text_at].decode(), record[text_at : text_at + text_size].decode()

    def close_writing(self) -> None:
        """Mark the end of writing; called by the writer, or by whoever notices its death."""
        self._header[_CLOSED] = 1


class RingWriter(_Ring):
    """Writing end, used by the loop; creates the memory of ``capacity`` rows of ``width`` values, and ``tail`` more."""

    def __init__(self, width: int, capacity: int, tail: int = 0) -> None:
        if width < 1 or capacity < 1:
            raise ValueError(f"a ring has at least one row of one value, not {capacity} of {width}")
        descriptor = os.memfd_create("friction_hil-ring")
        os.fchmod(descriptor, 0o400)  # whoever gets a descriptor for reading cannot open it again for writing
        os.ftruncate(descriptor, _HEADER_BYTES + EVENT_SLOTS * _EVENT_BYTES + (capacity * (width + 2) + tail) * 8)
        os.pwrite(descriptor, struct.pack("<3q", _MAGIC_NUMBER, width, capacity), 0)
        super().__init__(descriptor)
        # Views are made once: slicing in the loop would cost more than the copy.
        self._slots = [row[1:-1] for row in self._rows]
        self._flat_numbers = memoryview(self._memory)[_HEADER_BYTES + EVENT_SLOTS * _EVENT_BYTES :].cast("q")
        self._stride = width + 2
        self._count = 0
        self._event_count = 0

    def push(self, row: Array) -> None:
        """Append a row, shape (width,); never waits."""
        count = self._count
        slot = count % self.capacity
        first = slot * self._stride
        count += 1
        self._flat_numbers[first] = count
        self._slots[slot][:] = row
        self._flat_numbers[first + self._stride - 1] = count
        self._header[_ROWS] = self._count = count

    def push_event(self, cycle: float, name: str, text: str) -> None:
        """Append an event; texts beyond 40 bytes (name) and 188 bytes of UTF-8 in all are cut off."""
        name_bytes = _cut(name, _NAME_BYTES)
        text_bytes = _cut(text, _EVENT_TEXT_BYTES - 8 - len(name_bytes))
        at = _HEADER_BYTES + self._event_count % EVENT_SLOTS * _EVENT_BYTES
        self._event_count += 1
        end = at + _EVENT_BYTES
        head = _EVENT_HEAD.pack(self._event_count, cycle, len(name_bytes), len(text_bytes))
        body = (name_bytes + text_bytes).ljust(_EVENT_TEXT_BYTES - 8, b"\0")
        self._memory[at : at + 8] = head[:8]
        self._memory[at + 8 : end] = head[8:] + body + head[:8]
        self._header[_EVENTS] = self._event_count

    @property
    def rows_pushed(self) -> int:
        """Number of rows written so far."""
        return self._count

    def free_slots(self) -> int:
        """Return the number of rows that can be pushed without overwriting one that the reader still needs."""
        return max(0, self.capacity - (self._count - self._header[_ROWS_DONE]))


class _Cursor:
    """Progress of the reader in rows or events: taken, released, lost.

    The numbers of released and lost entries are in the shared header, so that a reader that takes over from a dead
    one neither skips, repeats nor counts anything twice.
    """

    def __init__(self, header: memoryview, written: int, done: int, lost: int) -> None:
        self._header, self._written, self._done, self._lost = header, written, done, lost
        self.next: int = header[done]
        self._held = np.empty(0, np.int64)  # numbers of what was taken and not released

    def available(self, slots: int) -> tuple[int, int]:
        """Return the index of the first entry that can be taken, and of the last one plus 1."""
        count: int = self._header[self._written]
        return max(self.next, count - slots), count

    def take(self, numbers: NDArray[np.int64], end: int) -> None:
        self._held = np.concatenate([self._held, numbers])
        self.next = end

    def discard(self) -> None:
        self._held = self._held[:0]
        self.release(0)

    def release(self, count: int) -> None:
        done = int(self._held[count - 1]) if count else self._header[self._done]
        self._held = self._held[count:]
        if not self._held.size:
            done = self.next
        self._header[self._lost] += done - self._header[self._done] - count
        self._header[self._done] = done

    @property
    def lost(self) -> int:
        return int(self._header[self._lost] + self.next - self._header[self._done] - self._held.size)


class RingReader(_Ring):
    """Reading end, used by the companion. The successor of a dead reader begins after what that one released."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor)
        self._row_cursor = _Cursor(self._header, _ROWS, _ROWS_DONE, _LOST)
        self._event_cursor = _Cursor(self._header, _EVENTS, _EVENTS_DONE, _EVENTS_LOST)

    def drain(self) -> Array:
        """Take all rows present as a copy, shape (n, width). Rows overwritten meanwhile are lost."""
        start, end = self._row_cursor.available(self.capacity)
        slots = np.arange(start, end) % self.capacity
        rows = self._numbers[slots]
        wanted = np.arange(start + 1, end + 1)
        whole = (rows[:, -1] == wanted) & (self._numbers[slots, 0] == wanted)
        whole[whole] = self._accepts(wanted[whole])
        self._row_cursor.take(wanted[whole], end)
        return rows[whole, 1:-1].view(np.float64)

    def _accepts(self, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which rows that are whole are taken, by their numbers; the others count as lost."""
        return np.ones(len(numbers), np.bool_)

    def drain_events(self) -> list[tuple[float, str, str]]:
        """Take all events present: cycle, name, text."""
        start, end = self._event_cursor.available(EVENT_SLOTS)
        events, numbers = [], []
        for number in range(start, end):
            event = self._event(number)
            if event is not None:
                events.append(event)
                numbers.append(number + 1)
        self._event_cursor.take(np.array(numbers, np.int64), end)
        return events

    def release(self, rows: int, events: int) -> None:
        """Release the oldest ``rows`` and ``events`` that were drained: they are safe.

        The writer may reuse their slots, and a reader that takes over does not see them again.
        """
        self._row_cursor.release(rows)
        self._event_cursor.release(events)

    def discard(self) -> None:
        """Count what was drained and not released as lost."""
        self._row_cursor.discard()
        self._event_cursor.discard()

    @property
    def is_drained(self) -> bool:
        """True if nothing is left to take."""
        return self._row_cursor.next == self._header[_ROWS] and self._event_cursor.next == self._header[_EVENTS]

    @property
    def lost(self) -> int:
        """Number of rows overwritten before a reader took them."""
        return self._row_cursor.lost

    @property
    def events_lost(self) -> int:
        """Number of events overwritten before a reader took them."""
        return self._event_cursor.lost


class RingObserver(_Ring):
    """An end that only looks: it takes nothing from the reader, and releases nothing. It cannot write."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, is_written=False)
        self._events_seen = 0
        self._rows_seen: int | None = None
        self.rows_missed = 0  # rows that `new_rows` has not returned, because they were overwritten

    @property
    def rows_written(self) -> int:
        """Number of rows that were written so far."""
        return self._header[_ROWS]

    def newest(self, most: int) -> Array:
        """Return up to ``most`` of the newest rows as a copy, oldest first, shape (n, width)."""
        end = self._header[_ROWS]
        return self._copy(self._oldest(end, most), end, np.arange(self.width))

    def new_rows(self, wanted: NDArray[np.intp]) -> Array:
        """Return the rows since the last call as a copy, oldest first, shape (n, m); the first call, those there are.

        ``wanted``: (m,) values of each row that are copied; a row is mostly states of compensators.
        """
        end = self._header[_ROWS]
        oldest = self._oldest(end, self.capacity)
        if self._rows_seen is None:
            self._rows_seen = oldest
        rows = self._copy(max(self._rows_seen, oldest), end, wanted)
        self.rows_missed += end - self._rows_seen - len(rows)
        self._rows_seen = end
        return rows

    def _oldest(self, end: int, most: int) -> int:
        """Return the first of the newest rows that can be copied: not the oldest, which may be being overwritten."""
        return max(0, end - min(most, self.capacity // 2))

    def _copy(self, first: int, end: int, values: NDArray[np.intp]) -> Array:
        """Return some values of the rows ``first`` to ``end`` that are whole."""
        slots = np.arange(first, end) % self.capacity
        before = self._numbers[slots, -1]
        rows = self._rows[np.ix_(slots, values + 1)]
        wanted = np.arange(first + 1, end + 1)
        whole = (before == wanted) & (self._numbers[slots, -1] == wanted) & (self._numbers[slots, 0] == wanted)
        copied: Array = rows[whole]
        return copied

    def new_events(self) -> list[tuple[float, str, str]]:
        """Return the events since the last call that are still there: cycle, name, text."""
        end: int = self._header[_EVENTS]
        found = [self._event(number) for number in range(max(self._events_seen, end - EVENT_SLOTS), end)]
        self._events_seen = end
        return [event for event in found if event is not None]


def _cut(text: str, size: int) -> bytes:
    """Return at most ``size`` bytes of ``text`` in UTF-8, without cutting a character."""
    return text.encode("utf-8", "replace")[:size].decode("utf-8", "ignore").encode()
