"""Distribution of messages to the pages that are open. One that cannot follow is dropped, and comes back by itself."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any, TypeAlias

_MOST_CLIENTS = 16
_MOST_WAITING = 60  # messages for one client
_ALIVE_S = 1.0  # after which something is sent in any case
_Queue: TypeAlias = "asyncio.Queue[tuple[int, bytes] | None]"  # None: the client is dropped

_ALIVE = b'{"kind": "alive"}\n'


class Hub:
    """Takes messages from the thread that reads the daemon, and hands them to clients in the server's event loop.

    ``greeting`` is called in a thread for each client; it returns the messages with which it begins, and the number of
    the last message that they contain.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, greeting: Callable[[], tuple[list[dict[str, Any]], int]]
    ) -> None:
        self._loop, self._greeting = loop, greeting
        self._clients: set[_Queue] = set()

    @property
    def is_wanted(self) -> bool:
        """True if anybody listens."""
        return bool(self._clients)

    def publish(self, number: int, message: dict[str, Any]) -> None:
        """Send a message to all clients; called by any thread, with rising numbers."""
        if self._clients and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._deliver, number, encoded(message))

    def _deliver(self, number: int, line: bytes) -> None:
        for queue in list(self._clients):
            if queue.full():
                self._drop(queue)
            else:
                queue.put_nowait((number, line))

    def _drop(self, queue: "_Queue") -> None:
        self._clients.discard(queue)
        while not queue.empty():
            queue.get_nowait()
        queue.put_nowait(None)

    def close(self) -> None:
        """Let all clients take what waits for them, and end."""
        for queue in list(self._clients):
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(None)

    def stream(self) -> AsyncIterator[bytes] | None:
        """Return the lines for one client; None if there are too many clients."""
        if len(self._clients) >= _MOST_CLIENTS:
            return None
        queue: _Queue = asyncio.Queue(_MOST_WAITING)
        self._clients.add(queue)  # from here on nothing is missed
        return self._lines(queue)

    async def _lines(self, queue: "_Queue") -> AsyncIterator[bytes]:
        try:
            messages, begun = await asyncio.to_thread(self._greeting)
            yield b"".join(map(encoded, messages))
            while True:
                try:
                    item = await asyncio.wait_for(queue.get(), _ALIVE_S)
                except TimeoutError:
                    yield _ALIVE
                    continue
                if item is None:
                    return
                number, line = item
                if number > begun:
                    yield line
        finally:
            self._clients.discard(queue)


def encoded(message: dict[str, Any]) -> bytes:
    """Return a message as a line of JSON."""
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"
