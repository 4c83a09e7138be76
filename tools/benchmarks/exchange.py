"""What one cycle costs for one CANopen axis, bus and drive's own time left out.

The real loop, driver and compensator run the shipped demo's first axis at its period, against a simulated drive
in this process: it works while the loop sleeps, and its answers lie ready when the loop asks. What is measured is
what the loop itself records as ``exchange_us``: SYNC, TPDOs, decoding, compensator and model, encoding, RPDO.
"""

import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
import numpy as np

from friction_hil.axis import AxisLoop
from friction_hil.config import load_configuration
from friction_hil.jit import Array
from friction_hil.loop import Loop, LoopSettings, StopRequest
from friction_hil.realtime import RealClock, punctuality
from friction_hil.recordings import columns
from friction_hil.safety import LoopState
from friction_hil.servo.trajectory import PathTime
from friction_hil_drivers.canopen import CanopenDrives, objects
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives
from tools.benchmarks.report import Row, against, note

if TYPE_CHECKING:
    from friction_hil.config import Configuration
