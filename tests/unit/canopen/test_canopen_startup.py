"""Reading a configuration does not wait for the libraries that only an open bus needs."""

import subprocess
import sys

CODE = """
import sys
sys.path[:0] = {path!r}
from friction_hil_drivers.canopen import CanopenDrives
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives
print(CanopenDrives.Options.__name__, SimulatedCanopenDrives.Options.__name__)
print(*sorted(name for name in ("can", "canopen", "msgpack") if name in sys.modules))
"""


def test_the_drivers_options_need_no_bus_library() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(path=sys.path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["CanopenOptions SimulationOptions", ""]
