"""Recordings: logs of an axis, read from and written to files.

>>> import friction_hil as fh
>>> recording = fh.recordings.read("run.mcap", axis="x")                      # doctest: +SKIP
>>> recording["position"]                                                     # doctest: +SKIP
array([...])
"""

from friction_hil.recordings.files import formats, read, read_all, write
from friction_hil.recordings.recording import Event, Recording

__all__ = ["Event", "Recording", "formats", "read", "read_all", "write"]
