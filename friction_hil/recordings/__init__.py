"""Recordings: logs of an axis, read from and written to files.

>>> import os, tempfile
>>> import friction_hil as fh
>>> path = os.path.join(tempfile.mkdtemp(), "bench.csv")
>>> with open(path, "w") as file:
...     _ = file.write("t,position,effort\\n0.0,0.1,2.0\\n0.001,0.3,4.0\\n")
>>> recording = fh.recordings.read(path, columns={"time_s": "t", "torque": "effort"}, scale={"torque": 0.5})
>>> recording["torque"], recording.period_s
(array([1., 2.]), 0.001)
"""

from friction_hil.recordings.files import formats, read, read_all, write
from friction_hil.recordings.recording import Event, Recording
from friction_hil.recordings.table import from_table

__all__ = ["Event", "Recording", "formats", "from_table", "read", "read_all", "write"]
