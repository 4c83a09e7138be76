"""Mailbox in shared memory: one message at a time from the process of the control socket to the loop, and its answer.

The loop compares one number a cycle. A message counts only as a whole: the sequence number is odd while it is written
and the same before and after it was read, and the digest fits. Whatever else is found there is refused, once, and the
loop goes on. The loop never waits, and writes nothing but its answer. The memory has no name: it ends with its users.
"""

import hashlib
import mmap
import os
import struct
import time

_MAGIC_NUMBER = 0x314C49414D4C4946  # changes with the layout
_MAGIC, _SEQUENCE, _LENGTH, _ANSWERED, _STATUS, _CYCLE = range(6)  # words of the header, each 8 bytes
_DIGEST_AT, _DIGEST_BYTES = 64, 16
_REASON_AT, _REASON_BYTES = 128, 384
_MESSAGE_AT = 512
_LEAST_BYTES = 4096
_REST_CYCLES = 100  # after a message that was refused, so that a mailbox full of garbage costs the loop nothing
_LOOK_S = 2e-3

ACCEPTED, REFUSED = 1, 2


class _Mailbox:
    """Shared memory with a view of its header."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        # populated at once: a page fault in the loop could cost a period
        flags = mmap.MAP_SHARED | mmap.MAP_POPULATE
        self._memory = mmap.mmap(descriptor, os.fstat(descriptor).st_size, flags=flags)
        self._words = memoryview(self._memory)[:_DIGEST_AT].cast("q")
        self.capacity = len(self._memory) - _MESSAGE_AT


class MailboxReader(_Mailbox):
    """End of the loop; creates the memory. ``capacity``: longest message, bytes."""

    def __init__(self, capacity: int) -> None:
        descriptor = os.memfd_create("friction_hil-mailbox")
        os.ftruncate(descriptor, max(_LEAST_BYTES, _MESSAGE_AT + capacity))
        super().__init__(descriptor)
        self._words[_MAGIC] = _MAGIC_NUMBER
        self._seen = 0
        self._rests_until = 0
        self.garbage = ""  # what was wrong with the message that `take` has just refused; empty otherwise

    @property
    def has_news(self) -> bool:
        """True if something has been written since the last message that was taken."""
        return self._words[_SEQUENCE] != self._seen

    def take(self, cycle: int) -> bytes | None:
        """Return the new message, None if there is no whole one; after garbage, the mailbox rests for some cycles."""
        self.garbage = ""
        sequence = self._words[_SEQUENCE]
        if sequence & 1 or cycle < self._rests_until:
            return None
        length, message = self._words[_LENGTH], None
        if 0 < length <= self.capacity:
            message = self._memory[_MESSAGE_AT : _MESSAGE_AT + length]
            digest = self._memory[_DIGEST_AT : _DIGEST_AT + _DIGEST_BYTES]
            if self._words[_SEQUENCE] != sequence:
                return None
            if _digest(sequence, message) != digest:
                message = None
        self._seen = sequence
        if message is None:
            self._rests_until = cycle + _REST_CYCLES
            self.garbage = "its checksum is wrong" if 0 < length <= self.capacity else "its length is wrong"
        return message

    def answer(self, number: int, cycle: int, refusal: str = "") -> None:
        """Answer a message: it is applied in ``cycle``, or refused for a reason."""
        reason = refusal.encode()[:_REASON_BYTES].ljust(_REASON_BYTES, b"\0")
        self._memory[_REASON_AT : _REASON_AT + _REASON_BYTES] = reason
        self._words[_STATUS] = REFUSED if refusal else ACCEPTED
        self._words[_CYCLE] = cycle
        self._words[_ANSWERED] = number


class MailboxWriter(_Mailbox):
    """End of the process that serves the control socket; a `ValueError`: the memory is no mailbox of this version."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor)
        if self._words[_MAGIC] != _MAGIC_NUMBER:
            raise ValueError("the shared memory is not a mailbox of this version")

    def post(self, message: bytes) -> None:
        """Write a message for the loop; a `ValueError`: it is longer than the mailbox."""
        if not 0 < len(message) <= self.capacity:
            raise ValueError(f"a message of {len(message)} bytes does not fit into {self.capacity}")
        sequence = (self._words[_SEQUENCE] | 1) & 0x7FFFFFFFFFFFFFF
        self._words[_SEQUENCE] = sequence
        self._memory[_MESSAGE_AT : _MESSAGE_AT + len(message)] = message
        self._words[_LENGTH] = len(message)
        self._memory[_DIGEST_AT : _DIGEST_AT + _DIGEST_BYTES] = _digest(sequence + 1, message)
        self._words[_SEQUENCE] = sequence + 1

    def withdraw(self) -> None:
        """Take back the message; the loop does not take it any more, unless it is doing so at this moment."""
        self._words[_SEQUENCE] = (self._words[_SEQUENCE] | 1) & 0x7FFFFFFFFFFFFFFF

    @property
    def answered(self) -> int:
        """Number of the message that was answered last."""
        return int(self._words[_ANSWERED])

    def wait(self, number: int, timeout_s: float) -> tuple[int, str] | None:
        """Wait for the answer to a message.

        Returns the cycle in which it was applied, and the reason if it was refused; None if no answer came in time.
        """
        end_s = time.monotonic() + timeout_s
        while self._words[_ANSWERED] != number:
            if time.monotonic() > end_s:
                return None
            time.sleep(_LOOK_S)
        reason = self._memory[_REASON_AT : _REASON_AT + _REASON_BYTES].rstrip(b"\0").decode("utf-8", "replace")
        return int(self._words[_CYCLE]), reason if self._words[_STATUS] != ACCEPTED else ""


def _digest(sequence: int, message: bytes) -> bytes:
    return hashlib.blake2b(struct.pack("<q", sequence) + message, digest_size=_DIGEST_BYTES).digest()
