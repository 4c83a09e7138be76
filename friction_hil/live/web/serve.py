"""The server of live data: a thread that reads the daemon, and an event loop that serves the page."""

import asyncio
import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil.errors import UsageError
from friction_hil.live.web.feed import Feed
from friction_hil.printable import printable

_LOOK_S = 0.1
_MOST_CONNECTIONS = 64
_SEND_BUFFER = 16384  # bytes in the kernel, for each connection
_MOST_HEAD = 16384  # bytes of a request's head
_MOST_HEAD_S = 10.0  # until the first request of a connection is there
_END_S = 1  # for connections that are open when the server ends


@dataclass(frozen=True, slots=True)
class Serving:
    """What is served, and where."""

    name: str  # of the daemon
    port: int | None  # of the page; 0 for any that is free, None for none
    foxglove: int | None  # the same of the Foxglove WebSocket
    host: str  # address of the page
    # further names by which the page and the WebSocket may be called; the WebSocket by their pages too
    allow_hosts: tuple[str, ...]
    token: str
    token_file: Path | None = None  # in which the user finds the token; None: it is printed


def serve(serving: Serving, ending: threading.Event, report: Callable[[str], None]) -> None:
    """Serve until ``ending`` is set, or a signal comes; a `UsageError`: an address or a port cannot be used."""
    with contextlib.ExitStack() as stack:
        listening = None if serving.port is None else stack.enter_context(_listen(serving.host, serving.port))
        foxglove = None
        if serving.foxglove is not None:
            from friction_hil.live.web.foxglove_feed import HOST, FoxgloveFeed  # imported here: it is an extra

            foxglove = FoxgloveFeed(serving.foxglove, (*serving.allow_hosts, socket.gethostname()))
            stack.callback(foxglove.close)
        if listening is not None:
            _announce_page(serving, listening, report)
        if foxglove is not None:
            report(f"Foxglove WebSocket: ws://{HOST}:{foxglove.port}")
        feed = Feed(serving.name, foxglove, report)
        thread = _Reader(feed, ending)
        for number in (signal.SIGINT, signal.SIGTERM):
            stack.callback(signal.signal, number, signal.getsignal(number))
            signal.signal(number, lambda *_: ending.set())
        thread.start()
        if listening is None:
            while not ending.wait(_LOOK_S):  # a wait without an end would not let signals in
                pass
        else:
            asyncio.run(_serve_page(serving, listening, feed, thread, ending))
        thread.join(_END_S)
        if thread.failure is not None:
            raise thread.failure


class _Reader(threading.Thread):
    """Thread of the feed. If it fails nothing is served any more, because what pages show would not be live."""

    def __init__(self, feed: Feed, ending: threading.Event) -> None:
        super().__init__(daemon=True)
        self._feed, self._ending = feed, ending
        self.failure: BaseException | None = None

    def run(self) -> None:
        try:
            self._feed.run(self._ending)
        except BaseException as error:  # noqa: BLE001  `serve` raises it
            self.failure = error
        finally:
            self._ending.set()


async def _serve_page(
    serving: Serving, listening: socket.socket, feed: Feed, thread: threading.Thread, ending: threading.Event
) -> None:
    import uvicorn  # imported here: it is an extra
    from uvicorn.protocols.http.h11_impl import H11Protocol

    from friction_hil.live.web.app import make_app
    from friction_hil.live.web.gate import Gate, is_loopback
    from friction_hil.live.web.hub import Hub

    class Connection(H11Protocol):
        """Connection that gives its place to another one while it waits for its client: uvicorn would keep it."""

        cycle: Any  # None before the first request
        last_s = 0.0  # time of its begin, or of its last answer

        def order(self) -> tuple[bool, float]:
            """Return a key by which those come first that wait for their client, and among these the longest."""
            cycle = self.cycle  # a request, a part of it, or that the client reads its answer may be waited for
            waits = cycle is None or cycle.response_complete or cycle.more_body or self.flow.write_paused
            return not waits, self.last_s if waits else -self.last_s  # pages and what takes long stay

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            # small buffers: a page that reads nothing is noticed when they are full
            transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            super().connection_made(transport)
            transport.set_write_buffer_limits(high=0)
            self.last_s = self.loop.time()
            if len(self.connections) > _MOST_CONNECTIONS:
                others = [each for each in self.connections if isinstance(each, Connection) and each is not self]
                min(others, key=Connection.order).transport.abort()
            self.loop.call_later(_MOST_HEAD_S, self._expect_request)

        def on_response_complete(self) -> None:
            self.last_s = self.loop.time()
            super().on_response_complete()

        def _expect_request(self) -> None:
            if self.cycle is None:
                self.transport.abort()

    class Server(uvicorn.Server):
        @contextlib.contextmanager
        def capture_signals(self) -> Iterator[None]:
            yield  # `serve` takes them

    hub = Hub(asyncio.get_running_loop(), feed.greeting)
    feed.serve_pages(hub.publish, lambda: hub.is_wanted)
    names = frozenset(name.lower() for name in (*serving.allow_hosts, socket.gethostname()))
    gate = Gate(serving.token, names, is_reading_free=is_loopback(serving.host))
    config = uvicorn.Config(
        make_app(_Board(hub, feed), gate),
        http=Connection,
        ws="none",
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        h11_max_incomplete_event_size=_MOST_HEAD,
        timeout_graceful_shutdown=_END_S,
    )
    server = Server(config)

    async def end() -> None:
        while not ending.is_set():
            await asyncio.sleep(_LOOK_S)
        await asyncio.to_thread(thread.join, _END_S)  # it says last whether the daemon has ended
        await asyncio.sleep(0.0)
        hub.close()
        server.should_exit = True

    await asyncio.gather(server.serve(sockets=[listening]), end())


class _Board:
    """What the application shows: messages of the hub, and metrics and answers of the feed."""

    def __init__(self, hub: Any, feed: Feed) -> None:
        self.stream, self.metrics, self.act = hub.stream, feed.metrics, feed.act


def _listen(host: str, port: int) -> socket.socket:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        # asyncio's and socket's own words repeat the address
        reason = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        text = f"the page cannot be served at {host}:{port}: {reason}"
        raise UsageError(text, "take another --port or --host") from None


def _announce_page(serving: Serving, listening: socket.socket, report: Callable[[str], None]) -> None:
    from friction_hil.live.web.gate import is_loopback

    port = listening.getsockname()[1]
    host = socket.gethostname() if serving.host in ("0.0.0.0", "::", "") else serving.host
    host = f"[{host}]" if ":" in host else host
    if serving.token_file is None:
        report(f"page: http://{host}:{port}/#token={serving.token}")
    else:
        report(f"page: http://{host}:{port}/ (its token is in {printable(str(serving.token_file))})")
    if not is_loopback(serving.host):
        report(
            "note: it can be reached from other machines, and what is sent can be read on the way; safer is loopback "
            f"alone, and 'ssh -L {port}:localhost:{port} MACHINE'"
        )
