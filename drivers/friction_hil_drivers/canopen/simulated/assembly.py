"""Simulated nodes, made from their configuration."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from friction_hil.drive import Mode
from friction_hil.errors import UsageError
from friction_hil.servo.servo import Servo
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO
from friction_hil_drivers.canopen.simulated.eds_dictionary import eds_dictionary
from friction_hil_drivers.canopen.simulated.node import SimulatedNode
from friction_hil_drivers.canopen.simulated.options import SimulationOptions
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary
from friction_hil_drivers.cia402.simulated.drive import SimulatedCia402Drive

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration


def make_node(
    configuration: "Configuration",
    axis: "AxisConfig",
    servo: Servo,
    send: Callable[[int, bytes], None],
    *,
    is_real: bool,
) -> SimulatedNode:
    """Make the node of an axis.

    ``configuration``: its period and the folder of its files. ``axis``: with its ``simulation``. ``servo``: compiled
    (`compile_servo`). ``send``: called with identifier and data of each frame that the node sends. ``is_real``: time is
    real and the node locks to SYNC; else it passes at SYNC only.

    Raises `UsageError`: an EDS is invalid, or the period is not a whole number of integration steps.
    """
    simulation = axis.simulation
    assert isinstance(simulation, SimulationOptions)
    number: int = getattr(axis.options, "node")  # noqa: B009 - the driver's options, known to it alone
    names = simulation.canopen.supported_modes
    modes = None if names is None else [Mode[name.upper()] for name in names]
    steps = _steps_per_period(configuration.period_s, servo)
    return SimulatedNode(
        number,
        _dictionary(configuration, number, simulation),
        lambda dictionary, emergencies: SimulatedCia402Drive(servo, dictionary, emergencies, modes, simulation.canopen),
        send,
        sync_steps=None if is_real else steps,
        lock_steps=steps if is_real else None,
        manners=simulation.canopen,
    )


def _dictionary(configuration: "Configuration", number: int, simulation: SimulationOptions) -> Dictionary:
    shown = simulation.canopen
    path = SIMULATED_SERVO
    if shown.eds is not None:
        source = configuration.source_path
        path = shown.eds if source is None else source.parent / shown.eds
    dictionary = eds_dictionary(path, number, shown.missing)
    for entry, value in (
        (objects.VENDOR_ID, shown.vendor_id),
        (objects.PRODUCT_CODE, shown.product_code),
        (objects.REVISION_NUMBER, shown.revision),
        (objects.SERIAL_NUMBER, number if shown.serial is None else shown.serial),
    ):
        if value is not None:
            dictionary.set_default(entry, value)
    if not dictionary.shows(objects.INTERPOLATION_PERIOD):
        _set_period(dictionary, configuration.period_s)
    return dictionary


def _set_period(dictionary: Dictionary, period_s: float) -> None:
    """Let a drive without 60C2h interpolate over the period of the configuration, as if it measured that of SYNC."""
    for exponent in range(0, -7, -1):
        mantissa = period_s / 10.0**exponent
        if 1 <= round(mantissa) <= 255 and abs(mantissa - round(mantissa)) < 1e-6:
            dictionary.set_default(objects.INTERPOLATION_PERIOD, round(mantissa))
            dictionary.set_default(objects.INTERPOLATION_EXPONENT, exponent)
            return


def _steps_per_period(period_s: float, servo: Servo) -> int:
    exact = period_s * servo.steps_per_second
    steps = round(exact)
    if steps < 1 or abs(exact - steps) > 1e-6:
        raise UsageError(
            f"the period must be a whole number of integration steps of the simulated servo; "
            f"{period_s:g} s is {exact:g} of them (integration_hz)"
        )
    return steps


def compile_servo(servo: Servo) -> None:
    """Let numba compile a servo like this one in each mode, before time counts; this one is used up."""
    for mode in Mode:
        servo.command(mode, 0.0)
        servo.advance(1)
    servo.quick_stop(1.0)
    servo.advance(1)
