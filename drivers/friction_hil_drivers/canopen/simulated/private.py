"""A configuration moved to a bus of its own, with simulated drives in place of the real ones."""

import math
import secrets
import socket
from collections import Counter
from typing import TYPE_CHECKING, Any

from friction_hil.config import BusConfig
from friction_hil.errors import UsageError
from friction_hil_drivers.canopen.options import canopen_options
from friction_hil_drivers.canopen.simulated.options import SimulationOptions
from friction_hil_drivers.canopen.wire.interfaces import bus_name

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration


def private_configuration(configuration: "Configuration") -> tuple["Configuration", str]:
    """Return the configuration on a multicast bus that nothing else uses, and the name of the bus that it replaces.

    A simulated drive is the one that the configuration expects, where `simulation` does not say otherwise: its
    identity, EDS, units and kind of axis.

    Raises `UsageError`: a node has several axes, which simulated drives do not have.
    """
    bus = configuration.bus
    assert bus is not None  # the driver's options have checked it
    nodes = Counter(canopen_options(axis).node for axis in configuration.axes.values())
    node, count = nodes.most_common(1)[0]
    if count > 1:
        raise UsageError(f"node {node} has {count} axes; a simulated drive has one: give each axis a node of its own")
    private = BusConfig(
        interface="udp_multicast",
        channel=f"239.74.163.{2 + secrets.randbelow(253)}",
        port=_free_port(),
        hop_limit=0,
        role=bus.role,
        sync_cob_id=bus.sync_cob_id,
    )
    axes = {name: _with_drive(axis) for name, axis in configuration.axes.items()}
    return configuration.model_copy(update={"bus": private, "axes": axes}), bus_name(bus)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port


def _with_drive(axis: "AxisConfig") -> "AxisConfig":
    """Return an axis whose simulated drive is the one that its options expect."""
    options, kind = canopen_options(axis), axis.model.axis
    given = axis.simulation or SimulationOptions()
    assert isinstance(given, SimulationOptions)
    turn = math.tau if kind == "rotary" else 1.0
    counts = None if options.counts_per_unit is None else round(options.counts_per_unit * turn, 6)
    simulation = given.model_copy(
        update={
            "mechanics": _filled(given.mechanics, axis=kind),
            "encoder": _filled(given.encoder, counts=counts),
            "motor": _filled(given.motor, rated_torque=options.rated_torque),
            "canopen": _filled(
                given.canopen,
                vendor_id=options.identity.vendor_id,
                product_code=options.identity.product_code,
                eds=options.eds,
                velocity_unit=options.velocity_unit,
            ),
        }
    )
    return axis.model_copy(update={"simulation": simulation})


def _filled(part: Any, **values: Any) -> Any:
    """Return a section with ``values`` that are not None in place of those that the user has not given, or as null."""
    given = {name for name in part.model_fields_set if getattr(part, name) is not None}
    new = {name: value for name, value in values.items() if value is not None and name not in given}
    return part.model_copy(update=new)
