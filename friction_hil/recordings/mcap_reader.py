"""Read recordings from MCAP: those of friction_hil, other flat float64 messages of ROS 2, and joint states."""

from collections.abc import Callable

import numpy as np
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.recordings import mcap_format as layout
from friction_hil.recordings.bounds import MOST_AXES, check_columns
from friction_hil.recordings.columns import CYCLE
from friction_hil.recordings.joint_table import TYPES, JointTable
from friction_hil.recordings.mcap_chunks import ChannelRows, McapContent
from friction_hil.recordings.recording import Array, Event, Recording
from friction_hil.recordings.source import Source

_NAMED_CHANNELS = 20


def read(source: Source) -> list[Recording]:
    """Read axes of an MCAP file.

    A file that was cut off is read up to its last whole chunk, and damaged chunks are left out; ``problems`` names the
    rows that are lost. Raises `RecordingError`: the file is not MCAP, or no channel has rows that can be read;
    `OSError`: the file cannot be opened.
    """

    known: dict[int, list[str] | None] = {}  # fields by schema, which many channels may share

    def choose(channel: Channel, schema: Schema | None) -> ChannelRows | None:
        fields = _fields(channel, schema, known)
        if fields is None:
            return None
        check_columns(source.path, fields)
        is_other = source.axis is not None and _axis(channel) != source.axis
        wanted = [] if is_other else [i for i, name in enumerate(fields) if source.wants(name)]
        return ChannelRows(len(fields), wanted, source.memory)

    content = McapContent(source.path, choose, source.memory)
    axes = _axes(content, known)
    if not axes and (joints := _joint_states(source, content)) is not None:
        return joints
    if not axes:
        raise RecordingError(f"{source.path}: no channel holds flat float64 ROS 2 messages; {_what_is_there(content)}")
    chosen = _select(content, list(axes), source.select)
    if len(chosen) > MOST_AXES:
        raise RecordingError(
            f"{source.path} has {len(chosen)} axes; at most {MOST_AXES} are read at once: choose one with --axis; "
            f"{choices('', chosen)}"
        )
    numbers = _numbers(content)
    events = _events(content, numbers)
    recordings = []
    for axis in chosen:
        channel, fields = axes[axis]
        problems = list(content.problems)
        recording = Recording(str(source.path), axis, {}, dict(content.metadata), problems, events=events)
        names, recording.others = source.split(fields)
        recording.columns = _columns(content, channel, names, recording.problems)
        recording.restarts = _restarts(content, numbers, channel, recording)
        recordings.append(recording)
    return recordings


def _joint_states(source: Source, content: McapContent) -> list[Recording] | None:
    """Return the joints of a file of ROS 2, each as an axis; None if no channel holds joint states."""
    channels = [
        channel
        for channel in content.channels.values()
        if (schema := content.schemas.get(channel.schema_id)) is not None
        and schema.name in TYPES
        and channel.message_encoding == MessageEncoding.CDR
    ]
    if not channels:
        return None
    table = JointTable(source.path, source.memory)
    for channel in channels:
        for message in content.odd.pop(channel.id, []):
            table.add(channel.topic, message, is_ros2=True)
        for run in content.runs.pop(channel.id, []):
            for row in run:
                table.add(channel.topic, layout.CDR_LITTLE_ENDIAN + row.tobytes(), is_ros2=True)
    recordings = table.selected(lambda names: _select(content, names, source.select))
    for recording in recordings:
        recording.problems += content.problems
    return recordings


def _axis(channel: Channel) -> str:
    return str(channel.topic).strip("/")


def _fields(channel: Channel, schema: Schema | None, known: dict[int, list[str] | None]) -> list[str] | None:
    """Return the fields of the rows on a channel; None if it carries other messages."""
    if schema is None or schema.encoding != SchemaEncoding.ROS2 or channel.message_encoding != MessageEncoding.CDR:
        return None
    if schema.id not in known:
        fields = layout.row_fields(schema.data.decode("utf-8", "replace"))
        known[schema.id] = fields if fields and len(set(fields)) == len(fields) else None
    return known[schema.id]


def _axes(content: McapContent, known: dict[int, list[str] | None]) -> dict[str, tuple[Channel, list[str]]]:
    """Return channel and fields of each axis by name."""
    axes = {}
    for channel in content.channels.values():
        fields = _fields(channel, content.schemas.get(channel.schema_id), known)
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


def _restarts(
    content: McapContent, numbers: dict[tuple[str, str], list[int]], channel: Channel, recording: Recording
) -> list[tuple[int, Array]]:
    own = numbers.get((channel.topic + layout.STATE_SUFFIX, layout.STATE_SCHEMA), [])
    runs = [run for number in own for run in content.runs.get(number, []) if run.shape[1] > 2]
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


def _events(content: McapContent, numbers: dict[tuple[str, str], list[int]]) -> list[Event]:
    messages = []
    for number in numbers.get((layout.EVENT_TOPIC, layout.EVENT_SCHEMA), []):
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


def _numbers(content: McapContent) -> dict[tuple[str, str], list[int]]:
    """Return the numbers of the channels by topic and name of the schema."""
    numbers: dict[tuple[str, str], list[int]] = {}
    for channel in content.channels.values():
        if channel.schema_id in content.schemas:
            name = content.schemas[channel.schema_id].name
            numbers.setdefault((channel.topic, name), []).append(channel.id)
    return numbers


def _what_is_there(content: McapContent) -> str:
    if not content.channels:
        return "; ".join(["there is no channel in it", *content.problems])
    kinds = []
    for channel in list(content.channels.values())[:_NAMED_CHANNELS]:
        schema = content.schemas.get(channel.schema_id)
        name = schema.name if schema else "no schema"
        kinds.append(f"{channel.topic} ({name}, {channel.message_encoding})")
    more = len(content.channels) - len(kinds)
    return f"there are: {', '.join(kinds)}{f' and {more} more' if more else ''}"
