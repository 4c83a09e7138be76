"""Configuration of live data over the network."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from pydantic import model_validator

from friction_hil.checked_yaml.messages import Mistake, refuse
from friction_hil.checked_yaml.section import Section, key

HOST = "127.0.0.1"
_MOST_PORT = 65535
_HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


class LiveConfig(Section):
    """Server of live data that ``run`` starts beside the loop."""

    dashboard: int | None = key(
        "port of the page for a browser, which serves /metrics too; null: no page", default=None, ge=1, le=_MOST_PORT
    )
    foxglove: int | None = key(
        "port of the Foxglove WebSocket, on loopback alone; null: none", default=None, ge=1, le=_MOST_PORT
    )
    host: str = key(
        "address at which the page is served; beyond loopback, reading needs the token too", default=HOST, min_length=1
    )
    allow_hosts: list[str] = key(
        "further names by which browsers may call page and WebSocket, and whose pages may use the WebSocket", default=[]
    )
    token_file: Path | None = key(
        "file with the token that changes need, relative to the directory in which 'run' starts; made if it is not "
        "there; null: a random token at each start, which is printed",
        default=None,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, _mistakes(self))
        return self


def _mistakes(live: LiveConfig) -> Iterator[Mistake]:
    for k, name in enumerate(live.allow_hosts):
        if not _HOST_NAME.fullmatch(name):
            yield ("allow_hosts", k), f"must be the name of a machine, e.g. mill.example, not {name!r}"
    if live.dashboard is None and live.foxglove is None:
        yield ("dashboard",), "is needed, or foxglove: the port at which data are served, e.g. 8080"
    elif live.dashboard == live.foxglove:
        yield ("foxglove",), f"must be another port than that of dashboard, {live.dashboard}"
