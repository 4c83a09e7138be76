"""A configuration moved to lines of its own, with simulated drives in place of the real ones."""

import socket
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil_drivers.serial_line.options import TCP, LineOptions, SerialOptions
from friction_hil_drivers.serial_line.simulated.options import SerialSimulation

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration


def private_configuration(configuration: "Configuration", folder: Path) -> tuple["Configuration", str]:
    """Return the configuration on pseudo-terminals in ``folder``, or TCP ports of this machine, and its former ports.

    Descriptions that are files get absolute paths, because the configuration may be written to another folder.
    """
    lines: dict[str, str] = {}
    for axis in configuration.axes.values():
        line = _options(axis).line
        lines.setdefault(line.port, _own_port(line, folder / f"line{len(lines) + 1}"))
    source = configuration.source_path
    axes = {}
    for name, axis in configuration.axes.items():
        options = _options(axis)
        description = options.description
        if source is not None and description.endswith((".yaml", ".yml")):
            description = str(source.parent / description)
        line = options.line.model_copy(update={"port": lines[options.line.port]})
        simulation = axis.simulation or SerialSimulation()
        assert isinstance(simulation, SerialSimulation)
        if "axis" not in simulation.mechanics.model_fields_set:
            mechanics = simulation.mechanics.model_copy(update={"axis": axis.model.axis})
            simulation = simulation.model_copy(update={"mechanics": mechanics})
        own = options.model_copy(update={"line": line, "description": description})
        axes[name] = axis.model_copy(update={"options": own, "simulation": simulation})
    return configuration.model_copy(update={"axes": axes}), ", ".join(lines)


def _options(axis: "AxisConfig") -> SerialOptions:
    assert isinstance(axis.options, SerialOptions)
    return axis.options


def _own_port(line: LineOptions, path: Path) -> str:
    if not line.is_tcp:
        return str(path)
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return f"{TCP}127.0.0.1:{probe.getsockname()[1]}"
