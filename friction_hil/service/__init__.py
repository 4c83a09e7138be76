"""Installation of the daemon as a service of systemd."""

from friction_hil.service.install import Installation, install, remove
from friction_hil.service.state import ServiceState, service_state

__all__ = ["Installation", "ServiceState", "install", "remove", "service_state"]
