"""Read logs of raw CAN frames; the drivers of a configuration decode them."""

from friction_hil.config.drivers import load_driver
from friction_hil.errors import UsageError
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source


def read(source: Source) -> list[Recording]:
    """Decode the axes of the configuration; see the driver's ``read_bus_log``.

    Raises `RecordingError`: the log has no frame of any axis; `UsageError`: there is no configuration, or none of its
    drivers decodes logs; `OSError`: the file cannot be opened.
    """
    configuration = source.configuration
    if configuration is None:
        raise UsageError(f"{source.path}: raw CAN frames need the configuration of the machine: --config machine.yaml")
    recordings: list[Recording] = []
    for driver in dict.fromkeys(axis.driver for axis in configuration.axes.values()):
        own = {name: axis for name, axis in configuration.axes.items() if axis.driver == driver}
        recordings += load_driver(driver).read_bus_log(source.path, own)
    if not recordings:
        raise UsageError(f"{source.path}: no driver of the configuration decodes CAN logs")
    names = source.select([recording.axis for recording in recordings])
    return [recording for recording in recordings if recording.axis in names]
