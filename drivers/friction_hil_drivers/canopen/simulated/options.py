"""Keys of an axis's ``simulation``: its simulated servo and drive."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from friction_hil.config.trajectories import Circle, Hold, Sine, Triangle
from friction_hil.servo.config import ServoConfig
from friction_hil_drivers.canopen.simulated.manners import Manners
from friction_hil_drivers.cia402.simulated.manners import Index, Unsigned32


class CanopenSimulation(Manners):
    """Identity, abilities and manners of the simulated drive on the bus."""

    eds: Path | None = Field(
        None, description="EDS that it follows, relative to the configuration file; its own when not given"
    )
    vendor_id: Unsigned32 | None = Field(None, description="1018h:01; as in the EDS when not given")
    product_code: Unsigned32 | None = Field(None, description="1018h:02; as in the EDS when not given")
    revision: Unsigned32 | None = Field(None, description="1018h:03; as in the EDS when not given")
    serial: Unsigned32 | None = Field(None, description="1018h:04; the node number when not given")
    missing: tuple[Index, ...] = Field((), description="indices of objects that it lacks, e.g. [0x60B2]")
    supported_modes: tuple[Literal["csp", "csv", "cst"], ...] | None = Field(
        None, description="modes of operation that it has; as in 6502h of the EDS, all three where that says nothing"
    )


class SimulationOptions(ServoConfig):
    """A simulated servo and its drive."""

    canopen: CanopenSimulation = CanopenSimulation()
    trajectory: Circle | Sine | Triangle | Hold | None = Field(
        None,
        discriminator="kind",
        description="motion that the stand-in master of 'simulate --master' gives the axis; by default it is held",
    )
