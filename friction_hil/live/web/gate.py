"""Who may ask what of the page's server: judged by the head of a request, before anything of it is read. Pure.

A page elsewhere can make the user's browser send requests here. It can neither set the header ``Authorization`` nor
choose ``Host`` and ``Origin``, which is what these rules rely on:

- ``Host`` is an address, ``localhost`` or a name that was allowed, so that a name that somebody else's DNS server
  resolves to this machine is refused (DNS rebinding).
- ``Origin``, where a browser sends it, is this server, and data are not sent across sites.
- What changes anything is a POST of JSON with the token; beyond loopback the token is needed to read data, too.
"""

import hmac
import ipaddress
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

MOST_BODY = 1 << 16  # bytes
DATA = ("/api/", "/metrics")  # paths of data; the others are the page itself, which holds none
_READING = ("GET", "HEAD")
_OWN_SITE = ("same-origin", "none")


@dataclass(frozen=True, slots=True)
class Refusal:
    """An answer in the place of the one that was asked for: HTTP status, and the reason in words."""

    status: int
    reason: str


@dataclass(frozen=True, slots=True)
class Gate:
    """Rules of one server."""

    token: str  # needed for what changes anything
    names: Collection[str]  # of hosts, in lower case, by which it may be called besides addresses and ``localhost``
    is_reading_free: bool  # data may be read without the token: only this machine can connect

    def refusal(self, method: str, path: str, headers: Iterable[tuple[bytes, bytes]]) -> Refusal | None:
        """Return why a request is refused; None if it is not.

        ``headers``: all fields, names in lower case; one that is repeated is refused where it matters.
        """
        given: dict[str, str] = {}
        for key, value in headers:
            name = key.decode("latin-1")
            if name in given and name in ("host", "origin", "authorization", "content-type", "content-length"):
                return Refusal(400, f"the header {name} is there twice")
            given[name] = value.decode("latin-1")
        refusal = self._host(given) or self._origin(given, path)
        if refusal is not None:
            return refusal
        if method not in (*_READING, "POST"):
            return Refusal(405, f"{method} is not used here; use GET to read and POST to change")
        if method == "POST":
            return self._token(given) or _form(given)
        return None if self.is_reading_free or not _is_data(path) else self._token(given)

    def _host(self, given: Mapping[str, str]) -> Refusal | None:
        name = host_name(given.get("host", ""))
        if name is not None and (name == "localhost" or name in self.names or _is_address(name)):
            return None
        text = f"this server does not answer to the name {given.get('host', '')!r}"
        return Refusal(403, f"{text}; call it by its address, or start it with --allow-host NAME")

    def _origin(self, given: Mapping[str, str], path: str) -> Refusal | None:
        origin, host = given.get("origin"), given["host"]
        if origin is not None and origin.lower() not in (f"http://{host}".lower(), f"https://{host}".lower()):
            return Refusal(403, f"a page of {origin} may not use this server")
        if _is_data(path) and given.get("sec-fetch-site", "none") not in _OWN_SITE:
            return Refusal(403, "a page of another site may not use this server")
        return None

    def _token(self, given: Mapping[str, str]) -> Refusal | None:
        kind, _, token = given.get("authorization", "").partition(" ")
        is_right = hmac.compare_digest(token.strip().encode("latin-1"), self.token.encode())  # in constant time
        if kind.lower() == "bearer" and is_right:
            return None
        what = "the token is wrong" if given.get("authorization") else "this needs the token"
        return Refusal(401, f"{what}: use the address that friction-hil has printed, or Authorization: Bearer TOKEN")


def host_name(host: str) -> str | None:
    """Return the name in a Host header, without port, brackets and capitals; None if there is none."""
    name, colon, port = host.rpartition(":")
    if not colon or "]" in port:  # no port, or the colon belongs to an IPv6 address
        name, port = host, "0"
    if name.startswith("[") and name.endswith("]"):
        name = name[1:-1]
    elif ":" in name:
        return None
    return name.lower().removesuffix(".") if name and port.isascii() and port.isdecimal() else None


def is_loopback(host: str) -> bool:
    """Return True for an address that only this machine can reach."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _is_data(path: str) -> bool:
    return path.startswith(DATA)


def _form(given: Mapping[str, str]) -> Refusal | None:
    """Return why the body of a change is refused."""
    if given.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        return Refusal(415, "a change is JSON: Content-Type: application/json")
    length = given.get("content-length", "")
    if not (length.isascii() and length.isdecimal()):
        return Refusal(411, "the length of a change is needed: Content-Length")
    if len(length) > 9 or int(length) > MOST_BODY:
        return Refusal(413, f"a change has at most {MOST_BODY} bytes")
    return None
