"""Live data of a running daemon, for those who look: monitor, dashboard, metrics.

`attach` finds a daemon by its name and gives a `Live`, `Watch` waits for one;
`Live.read` returns what has happened since the last call;
`LiveFigures` computes rolling figures from that. Nothing here writes to the daemon, and its loop never waits for it.
"""

from friction_hil.live.attachment import Live, Watch, attach
from friction_hil.live.figures import LiveFigures
from friction_hil.live.reading import AxisSettings, LiveEvent, LiveFacts, Reading, Rows, Settings
from friction_hil.live.snapshot import AxisSnapshot, Snapshot

__all__ = [
    "AxisSettings",
    "AxisSnapshot",
    "Live",
    "LiveEvent",
    "LiveFacts",
    "LiveFigures",
    "Reading",
    "Rows",
    "Settings",
    "Snapshot",
    "Watch",
    "attach",
]
