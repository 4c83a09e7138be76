"""Foxglove WebSocket: each cycle of each axis as in an MCAP recording, and events as log messages.

The protocol knows no token, so it is served on loopback alone, to those that `door.py` lets in, and nothing can be
changed through it. The library serves each client in threads of its own, and drops the oldest messages of one
that cannot follow.
"""

import math
from collections.abc import Collection

import numpy as np
from foxglove import Channel, Context, Schema, start_server
from foxglove.channels import LogChannel
from foxglove.messages import Log, LogLevel, Timestamp
from mcap.well_known import MessageEncoding, SchemaEncoding

from friction_hil.errors import UsageError
from friction_hil.live import LiveFacts, Reading
from friction_hil.live.web.door import Door, hidden_host
from friction_hil.live.web.gate import Gate
from friction_hil.recordings import mcap_format as layout
from friction_hil.recordings.columns import TIME

HOST = "127.0.0.1"
_MOST_RATE_HZ = 1000.0  # messages of an axis in a second; a faster loop is decimated
_BACKLOG = 8192  # messages that wait for a client
_LEVELS = {"fault": LogLevel.Error, "abandoned": LogLevel.Error, "warning": LogLevel.Warning}


class FoxgloveFeed:
    """Server of the Foxglove WebSocket protocol.

    ``port``: 0 for any that is free. ``names``: of hosts, by which it may be called, and whose pages may connect.
    Raises `UsageError`: the port cannot be used.
    """

    def __init__(self, port: int, names: Collection[str] = ()) -> None:
        self._context = Context()
        host = hidden_host()
        self._server = start_server(
            name="friction_hil", host=host, port=0, context=self._context, message_backlog_size=_BACKLOG
        )
        try:
            gate = Gate("", frozenset(name.lower() for name in names), is_reading_free=True)
            self._door = Door(HOST, port, (host, self._server.port), gate)
        except OSError as error:
            self._server.stop()
            text = f"the Foxglove WebSocket cannot be served at {HOST}:{port}: {error.strerror or error}"
            raise UsageError(text, "take another port with --foxglove") from None
        self.port = self._door.port
        self._channels: dict[str, Channel] = {}
        self._events: LogChannel | None = None
        self._stride = 1
        self._started_unix_ns = 0  # at time_s = 0

    def begin(self, facts: LiveFacts) -> None:
        """Offer the channels of a daemon in the place of those of the one before."""
        self.end()
        schema = Schema(
            name=layout.ROW_SCHEMA, encoding=SchemaEncoding.ROS2, data=layout.row_schema(facts.columns).encode()
        )
        self._channels = {
            axis: Channel(f"/{axis}", schema=schema, message_encoding=MessageEncoding.CDR, context=self._context)
            for axis in facts.axes
        }
        self._events = LogChannel(layout.EVENT_TOPIC, context=self._context)
        self._stride = max(1, math.ceil(1.0 / (facts.period_s * _MOST_RATE_HZ) - 1e-9))
        self._started_unix_ns = facts.started_unix_ns
        self._server.clear_session()

    def end(self) -> None:
        """Take back the channels: there is no daemon."""
        for channel in (*self._channels.values(), *(() if self._events is None else (self._events,))):
            channel.close()
        self._channels, self._events = {}, None

    def send(self, reading: Reading) -> None:
        """Send what was read to those who asked for it."""
        for axis, (row_axis, channel) in enumerate(self._channels.items()):
            if channel.has_sinks() and len(reading.rows):
                part = np.ascontiguousarray(reading.rows.values[:: self._stride, axis], dtype="<f8")
                times = reading.rows.of(row_axis, TIME)[:: self._stride].tolist()
                for time_s, row in zip(times, part, strict=True):
                    if math.isfinite(time_s):
                        channel.log(layout.CDR_LITTLE_ENDIAN + row.tobytes(), log_time=self._unix_ns(time_s))
        if self._events is not None:
            for event in reading.events:
                at_ns = self._unix_ns(event.time_s)
                stamp = Timestamp(sec=at_ns // 1_000_000_000, nsec=at_ns % 1_000_000_000)
                text = f"{event.text}\nRemedy: {event.remedy}" if event.remedy else event.text
                level = _LEVELS.get(event.name, LogLevel.Info)
                self._events.log(Log(timestamp=stamp, level=level, name=event.name, message=text), log_time=at_ns)

    def close(self) -> None:
        """End the server."""
        self._door.close()
        self._server.stop()

    def _unix_ns(self, time_s: float) -> int:
        return self._started_unix_ns + round(time_s * 1e9)
