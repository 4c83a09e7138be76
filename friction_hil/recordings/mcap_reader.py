"""Read recordings from MCAP: those of friction_hil, and any flat float64 ROS 2 messages."""

from collections.abc import Callable

import numpy as np
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import mcap_format as layout
from friction_hil.recordings.columns import CYCLE
from friction_hil.recordings.mcap_chunks import ChannelRows, McapContent
from friction_hil.recordings.recording import Array, Event, Recording
from friction_hil.recordings.source import Source


def read(source: Source) -> list[Recording]:
    """Read axes of an MCAP file.

    A file that was cut off is read up to its last whole chunk, and damaged chunks are left out; ``problems`` names the
    rows that are lost.

    Raises
    ------
    RecordingError
        The file is not MCAP, or no channel has rows that can be read.
    OSError
        The file cannot be opened.
    """

    def choose(channel: Channel, schema: Schema | None) -> ChannelRows | None:
        fields = _fields(channel, schema)
        if fields is None:
            return None
        is_other = source.axis is not None and _axis(channel) != source.axis
        return ChannelRows(len(fields), [] if is_other else [i for i, name in enumerate(fields) if source.wants(name)])

    content = McapContent(source.path, choose)
    axes = _axes(content)
    if not axes:
        raise RecordingError(f"{source.path}: no channel holds flat float64 ROS 2 messages; {_what_is_there(content)}")
    events = _events(content)
    recordings = []
    for axis in _select(content, list(axes), source.select):
        channel, fields = axes[axis]
        problems = list(content.problems)
        recording = Recording(str(source.path), axis, {}, dict(content.metadata), problems, events=events)
        names, recording.others = source.split(fields)
        recording.columns = _columns(content, channel, names, recording.problems)
        recording.restarts = _restarts(content, channel, recording)
        recordings.append(recording)
    return recordings


def _axis(channel: Channel) -> str:
    return str(channel.topic).strip("/")


def _fields(channel: Channel, schema: Schema | None) -> list[str] | None:
    """Return the fields of the rows on a channel; None if it carries other messages."""
    if schema is None or schema.encoding != SchemaEncoding.ROS2 or channel.message_encoding != MessageEncoding.CDR:
        return None
    fields = layout.row_fields(schema.data.decode("utf-8", "replace"))
    return fields if fields and len(set(fields)) == len(fields) else None


def _axes(content: McapContent) -> dict[str, tuple[Channel, list[str]]]:
    """Return channel and fields of each axis by name."""
    axes = {}
    for channel in content.channels.values():
        fields = _fields(channel, content.schemas.get(channel.schema_id))
        if fields is not None:
            axes[_axis(channel)] = channel, fields
    return axes


def _select(content: McapContent, names: list[str], select: Callable[[list[str]], list[str]]) -> list[str]:
    try:
        return select(names)
    except UsageError as error:
        if not content.problems:
            raise
        raise RecordingError(f"{error}; {'; '.join(content.problems)}") from None


def _columns(content: McapContent, channel: Channel, names: list[str], problems: list[str]) -> dict[str, Array]:
    rows = content.rows.get(channel.id)
    others = len(content.odd.get(channel.id, [])) + (0 if rows is None else rows.others)
    if others:
        problems.append(f"{others} rows of {channel.topic} have another size than its schema says: left out")
    if rows is None:
        return {name: np.empty(0) for name in names}
    return dict(zip(names, rows.columns, strict=True))


def _restarts(content: McapContent, channel: Channel, recording: Recording) -> list[tuple[int, Array]]:
    topic = channel.topic + layout.STATE_SUFFIX
    numbers = _numbers(content, topic, layout.STATE_SCHEMA)
    runs = [run for number in numbers for run in content.runs.get(number, []) if run.shape[1] > 2]
    messages = [message for run in runs for message in run]
    if not messages or CYCLE not in recording.columns:
        return []
    cycles = recording.columns[CYCLE]
    if not np.all(np.diff(cycles) > 0.0):
        recording.problems.append("the cycles are not in order: the restart points cannot be placed")
        return []
    restarts = []
    for cycle, _, *state in messages:
        row = int(np.searchsorted(cycles, cycle))
        if row < len(cycles) and cycles[row] == cycle:
            restarts.append((row, np.array(state)))
    return sorted(restarts, key=lambda restart: restart[0])


def _events(content: McapContent) -> list[Event]:
    messages = []
    for number in _numbers(content, layout.EVENT_TOPIC, layout.EVENT_SCHEMA):
        messages += content.odd.get(number, [])
        # An event whose size happens to be a multiple of 8 bytes is among the runs.
        whole = [message for run in content.runs.get(number, []) for message in run]
        messages += [layout.CDR_LITTLE_ENDIAN + message.tobytes() for message in whole]
    events = []
    for message in messages:
        try:
            events.append(Event(*layout.read_event(message)))
        except ValueError as error:
            content.problems.append(f"an event is damaged ({error}): left out")
    return sorted(events, key=lambda event: event.cycle)


def _numbers(content: McapContent, topic: str, schema: str) -> list[int]:
    """Return the numbers of the channels of a topic whose messages have this ``schema``."""
    return [
        channel.id
        for channel in content.channels.values()
        if channel.topic == topic
        and channel.schema_id in content.schemas
        and content.schemas[channel.schema_id].name == schema
    ]


def _what_is_there(content: McapContent) -> str:
    if not content.channels:
        return "; ".join(["there is no channel in it", *content.problems])
    kinds = []
    for channel in content.channels.values():
        schema = content.schemas.get(channel.schema_id)
        name = schema.name if schema else "no schema"
        kinds.append(f"{channel.topic} ({name}, {channel.message_encoding})")
    return f"there are: {', '.join(kinds)}"
