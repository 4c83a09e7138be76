"""All codes of messages: of the daemon, of `doctor`, and of the installed drivers."""

from friction_hil.config.drivers import driver_names, load_driver
from friction_hil.doctor.codes import CODES
from friction_hil.drive.codes import Explanation, FaultCode


def explanations() -> dict[str, Explanation]:
    """Return them by code, in the order of the codes; drivers have theirs in the attribute ``explanations``."""
    found = {str(code): code.explanation for code in FaultCode} | CODES
    for name in driver_names():
        found |= load_driver(name).explanations
    return dict(sorted(found.items()))
