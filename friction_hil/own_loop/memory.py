"""The recording of a loop in memory: of the last cycles, made into the daemon's own file when it is asked for."""

import itertools
import json
import math
import time
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.compensator import INPUTS, STATE
from friction_hil.config import self_contained
from friction_hil.daemon.companion.own_rows import daemon_rows
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array
from friction_hil.own_loop.joints import Joints
from friction_hil.own_loop.kernel import RESULTS
from friction_hil.recordings import columns
from friction_hil.recordings.fingerprint import fingerprint
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.recordings.recording import CHANGE
from friction_hil.recordings.source import new_file

COLUMNS = (*INPUTS, *RESULTS)  # of a recorded row of a joint
STATE_S = 1.0  # between two states from which a replay can start
_MOST_EVENTS = 1000
_ROWS_AT_ONCE = 5000
WIDTH = STATE.itemsize // 8


class Memory:
    """Rows of the last cycles, and the events of the loop.

    ``duration_s``: of the rows that are kept; 0 for none.
    """

    def __init__(self, joints: Joints, duration_s: float) -> None:
        period_s, n = joints.configuration.period_s, len(joints.names)
        every = max(round(STATE_S / period_s), 1)
        places = math.ceil(duration_s / period_s / every) + (
            duration_s > 0.0
        )  # the oldest are dropped a second at once
        self._joints, self._every = joints, every
        # filled, so that no page of it is first touched in the loop
        self.rows: Array = np.full((places * every, n, len(COLUMNS)), math.nan)
        self.states: Array = np.full((places, n, WIDTH), math.nan)
        joints.loop["rows_between_states"] = every
        self._events: deque[tuple[float, str, str]] = deque(maxlen=_MOST_EVENTS)
        self._changes: list[tuple[float, float, dict[str, Any]]] = []  # rows before it, cycle, entry
        self._started_ns = 0

    def begin(self) -> None:
        """Note the wall-clock time of the first cycle."""
        self._started_ns = time.time_ns()

    def note(self, name: str, text: str) -> None:
        """Keep an event of the present cycle: ``fault`` or ``notice``."""
        self._events.append((self._joints.loop["cycle"].item(), name, text))

    def note_change(self, entry: dict[str, Any]) -> None:
        """Keep the settings after a change as long as a row in memory was computed with them, or with its model."""
        rows, cycle = self._joints.loop["rows"].item(), self._joints.loop["cycle"].item()
        changes = [*self._changes, (rows, cycle, entry)]
        oldest = rows - len(self.rows) - self._every
        is_used = [after[0] >= oldest for after in changes[1:]] + [True]
        used = itertools.compress(changes, is_used)
        models = {axis["model_of"] for _, _, each in used for axis in each["axes"].values()}
        self._changes = [
            each for each, is_kept in zip(changes, is_used, strict=True) if is_kept or each[2]["number"] in models
        ]

    def close(self) -> list[str]:
        """Do nothing; what is in memory can still be saved."""
        return []

    def save(self, path: Path, *, overwrite: bool) -> tuple[int, int]:
        """Write what is in memory; return the rows written and those before them that were dropped."""
        capacity, every = len(self.rows), self._every
        if not capacity:
            raise UsageError("nothing was recorded: record_s is 0")
        end = round(self._joints.loop["rows"].item())
        kept, states, events, changes = self.rows.copy(), self.states.copy(), list(self._events), self._changes
        now = round(self._joints.loop["rows"].item())  # the loop may be another thread's
        first = max(0, -(-(now + 1 - capacity) // every) * every)
        if end <= first:
            raise UsageError("nothing was recorded: no cycle had the positions of all joints")
        with new_file(path, overwrite=overwrite) as part:
            writer = McapWriter(
                part,
                self._joints.names,
                columns.NAMES,
                state_width=WIDTH,
                started_unix_ns=self._started_ns,
                metadata=metadata(self._joints),
                overwrite=True,
            )
            try:
                for _, cycle, entry in changes:  # rows from before it are computed with what it has of the start
                    writer.write_event(cycle, CHANGE, json.dumps(entry))
                for begin in range(first, end, _ROWS_AT_ONCE):
                    numbers = np.arange(begin, min(begin + _ROWS_AT_ONCE, end))
                    has_state = numbers % every == 0
                    known = states[numbers // every % len(states)]
                    writer.write(self._table(kept[numbers % capacity], known), has_state)
                for event in events:
                    writer.write_event(*event)
            finally:
                writer.close()
        return end - first, first

    def _table(self, rows: Array, states: Array) -> Array:
        """Return rows as the daemon has them: (m, n * (columns + width))."""
        values = daemon_rows(rows, COLUMNS, self._joints.configuration.period_s)
        return np.concatenate([values, states], axis=2).reshape(len(rows), -1)


def metadata(joints: Joints) -> dict[str, Any]:
    """Return what a replay of a recording of these joints has to know."""
    made = zip(joints.facts, joints.compensators, strict=True)
    return {
        "configuration": self_contained(joints.configuration),
        "facts": [{**asdict(fact), "lead_s": one.settings.lead_s} for fact, one in made],
        "fingerprint": fingerprint(),
    }
