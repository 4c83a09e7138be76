"""Door of the Foxglove WebSocket: who may connect is judged by the head of the request, by the rules of `gate.py`.

The library that speaks the protocol takes anybody. It listens at an address of this machine that nobody can guess, and
connections come to it through here. What a browser shows of the web needs an origin that was allowed; programs of this
machine that are no browser send no origin, or one that no page of the web has.
"""

import asyncio
import contextlib
import secrets
import socket
import threading

from friction_hil.live.web.gate import Gate, Refusal, host_name

_MOST_HEAD = 16384  # bytes
_MOST_HEAD_S = 10.0
_MOST_CLIENTS = 64
_PART = 1 << 16
_OF_THE_WEB = ("http", "https", "ws", "wss", "ftp", "blob", "data")
_REASONS = {400: "Bad Request", 401: "Unauthorized", 403: "Forbidden", 405: "Method Not Allowed", 503: "Busy"}


def hidden_host() -> str:
    """Return a random address of this machine."""
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


class Door:
    """Passes on connections whose head the gate accepts, in a thread of its own.

    ``port``: 0 for any that is free. ``target``: address of the library's server. Names that the gate allows are also
    those whose pages may connect. Raises `OSError`: the port cannot be used.
    """

    def __init__(self, host: str, port: int, target: tuple[str, int], gate: Gate) -> None:
        listening = socket.create_server((host, port))
        self.port: int = listening.getsockname()[1]
        self._target, self._gate = target, gate
        self._clients = 0
        self._loop = asyncio.new_event_loop()
        self._closing = asyncio.Event()
        self._thread = threading.Thread(target=self._run, args=(listening,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Let nobody in any more, and end the connections."""
        self._loop.call_soon_threadsafe(self._closing.set)
        self._thread.join()

    def _run(self, listening: socket.socket) -> None:
        self._loop.run_until_complete(self._let_in(listening))
        self._loop.close()

    async def _let_in(self, listening: socket.socket) -> None:
        server = await asyncio.start_server(self._serve, sock=listening, limit=_MOST_HEAD)
        await self._closing.wait()
        server.close()
        await _end_all()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients += 1
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _MOST_HEAD_S)
            refusal = self._refusal(head)
            if refusal is None:
                await self._pass_on(head, reader, writer)
            else:
                body = refusal.reason.encode() + b"\n"
                kind = f"HTTP/1.1 {refusal.status} {_REASONS.get(refusal.status, 'Refused')}"
                writer.write(f"{kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n".encode() + body)
                await writer.drain()
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # the client is gone, or speaks something else
        finally:
            self._clients -= 1
            writer.close()

    def _refusal(self, head: bytes) -> Refusal | None:
        if self._clients > _MOST_CLIENTS:
            return Refusal(503, "there are too many clients already")
        request, *lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
        words = request.decode("latin-1").split(" ")
        fields = [line.partition(b":") for line in lines]
        if len(words) != 3 or any(not colon or name != name.strip() for name, colon, _ in fields):
            return Refusal(400, "this is no request of HTTP")
        headers = [(name.lower(), value.strip()) for name, _, value in fields]
        others = [each for each in headers if each[0] != b"origin" or not self._is_guest(each[1].decode("latin-1"))]
        return self._gate.refusal(words[0], words[1], others)

    def _is_guest(self, origin: str) -> bool:
        """Return True for an origin that is no page of the web, or one whose name was allowed."""
        scheme, found, rest = origin.lower().partition("://")
        return bool(found) and (scheme not in _OF_THE_WEB or host_name(rest) in self._gate.names)

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        their_reader, their_writer = await asyncio.open_connection(*self._target)
        try:
            their_writer.write(head)
            ways = (_copy(reader, their_writer), _copy(their_reader, writer))
            tasks = [asyncio.ensure_future(way) for way in ways]
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
        finally:
            their_writer.close()


async def _end_all() -> None:
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while part := await reader.read(_PART):
            writer.write(part)
            await writer.drain()
