"""The page's server: routes, and the gate before all of them."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from importlib.resources import files
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from friction_hil.live.web.gate import MOST_BODY, Gate, Refusal

_STATIC = {
    "index.html": "text/html",
    "page.css": "text/css",
    "page.js": "text/javascript",
    "charts.js": "text/javascript",
    "scope.js": "text/javascript",
    "server.js": "text/javascript",
    "icon.svg": "image/svg+xml",
    "uPlot.iife.min.js": "text/javascript",
    "uPlot.min.css": "text/css",
    "uPlot.LICENSE": "text/plain",
}
# the page loads nothing from elsewhere, and no other page can frame it, read it or keep it
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_MOST_SEND_S = 5.0  # that a client may take for a part of the stream
_METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Board(Protocol):
    """What the server shows and passes on."""

    def stream(self) -> AsyncIterator[bytes] | None:
        """Return the lines for one client; None if there are too many clients."""
        ...

    def metrics(self) -> str:
        """Return the metrics in Prometheus's text format."""
        ...

    def act(self, what: str, content: Mapping[str, Any]) -> dict[str, Any]:
        """Pass a request on to the daemon and return its answer; takes as long as the daemon."""
        ...


def make_app(board: Board, gate: Gate) -> ASGIApp:
    """Return the application that a server runs."""

    async def stream(request: Request) -> Response:
        lines = board.stream()
        if lines is None:
            return _refused(Refusal(503, "too many pages are open already"))
        return _Lines(lines)

    async def metrics(request: Request) -> Response:
        return Response(await run_in_threadpool(board.metrics), media_type=_METRICS_TYPE)

    async def act(request: Request) -> Response:
        try:
            content = await _content(request)
        except ValueError as error:
            return _refused(Refusal(400, str(error)))
        except ClientDisconnect:
            return Response(status_code=400)
        answer = await run_in_threadpool(board.act, request.url.path.rpartition("/")[2], content)
        return JSONResponse(answer, status_code=200 if answer["ok"] else 409)

    routes = [Route("/", _static("index.html"))]
    routes += [Route(f"/{name}", _static(name)) for name in _STATIC if name != "index.html"]
    routes += [Route("/api/stream", stream), Route("/metrics", metrics)]
    routes += [Route(f"/api/{name}", act, methods=["POST"]) for name in ("set", "reset", "start", "stop")]
    return _Gated(Starlette(routes=routes), gate)


class _Lines(Response):
    """Lines without an end, to a client that takes them; one that does not is left."""

    media_type = "application/x-ndjson"

    def __init__(self, lines: AsyncIterator[bytes]) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._lines = lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def hang_up() -> None:
            while (await receive())["type"] != "http.disconnect":
                pass

        gone = asyncio.ensure_future(hang_up())
        try:
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            async for line in self._lines:
                if gone.done():
                    return
                async with asyncio.timeout(_MOST_SEND_S):
                    await send({"type": "http.response.body", "body": line, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
        except TimeoutError:
            return  # the server closes the connection, because the answer is not complete
        finally:
            gone.cancel()
            await self._lines.aclose()  # type: ignore[attr-defined]


class _Gated:
    """Application behind the gate; every answer has the headers above."""

    def __init__(self, app: ASGIApp, gate: Gate) -> None:
        self._app, self._gate = app, gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close"})
            return
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                extra = [(key.encode(), value.encode()) for key, value in _HEADERS.items()]
                message = {**message, "headers": [*message.get("headers", ()), *extra]}
            await send(message)

        refusal = self._gate.refusal(scope["method"], scope["path"], scope["headers"])
        app = self._app if refusal is None else _refused(refusal)
        await app(scope, receive, send_guarded)


def _refused(refusal: Refusal) -> Response:
    headers = {"www-authenticate": "Bearer"} if refusal.status == 401 else None
    return JSONResponse({"ok": False, "problems": [refusal.reason]}, status_code=refusal.status, headers=headers)


async def _content(request: Request) -> dict[str, Any]:
    """Return the JSON object in the body of a request; a `ValueError`: it is none, or too long."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY:
            raise ValueError(f"a change has at most {MOST_BODY} bytes")
    try:
        content = json.loads(body or b"{}", parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise ValueError('a change is one JSON object, e.g. {"values": {"x.gain": 0.8}}') from None
    if not isinstance(content, dict):
        raise ValueError('a change is one JSON object, e.g. {"values": {"x.gain": 0.8}}')
    return content


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number")


def _static(name: str) -> Callable[[Request], Any]:
    content = (files("friction_hil.live.web") / "static" / name).read_bytes()

    async def serve(request: Request) -> Response:
        return Response(content, media_type=_STATIC[name])

    return serve
