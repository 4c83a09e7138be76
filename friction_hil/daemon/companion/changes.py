"""Changes of a run as events of its files: with the settings and models that a replay of their rows needs."""

import json

from friction_hil.daemon.control import journal

_NAME = "change"


class Changes:
    """Changes of the run, from the journal of the control socket.

    Parameters
    ----------
    descriptor : int
        Memory of the journal; -1 for none.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def earlier(self) -> list[tuple[float, str, str]]:
        """Return the changes so far, as the first events of a file that begins now: each file stands alone."""
        return [(0.0, _NAME, json.dumps(entry)) for entry in self._entries()]

    def whole(self, event: tuple[float, str, str]) -> tuple[float, str, str]:
        """Return an event as it is recorded: for a change, the ring has room for its number only."""
        cycle, name, text = event
        if name == _NAME:
            for entry in self._entries():
                if str(entry["number"]) == text:
                    return cycle, name, json.dumps(entry)
        return event

    def _entries(self) -> list[dict[str, object]]:
        return [] if self._descriptor < 0 else journal.entries(self._descriptor)
