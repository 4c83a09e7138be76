"""Error of a frame that was not sent. On its own, because `frames` needs libraries that take long to import."""

from friction_hil.errors import BusError


class QueueFullError(BusError):
    """A frame was not sent: the interface's send queue is full. The next cycle may try again."""
