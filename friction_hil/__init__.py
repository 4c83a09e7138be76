"""friction_hil: real-time friction compensation for servo axes.

What is in ``__all__`` is the public Python interface. It is imported when first used, so that ``import friction_hil``
costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from friction_hil import dynamics, errors, export, health, models, recordings
    from friction_hil.api.comparison import Comparison, Verified, compare, verify
    from friction_hil.api.identification import Identified, identify
    from friction_hil.api.joints import IdentifiedJoints, identify_joints
    from friction_hil.api.training import Trained, train
    from friction_hil.api.tuning import Tuned, tune
    from friction_hil.fleets import Fleet, fleet
    from friction_hil.models import library
    from friction_hil.own_loop import Compensator

__version__ = "0.3.0.dev0"
__all__ = [
    "Comparison",
    "Compensator",
    "Fleet",
    "Identified",
    "IdentifiedJoints",
    "Trained",
    "Tuned",
    "Verified",
    "compare",
    "dynamics",
    "errors",
    "export",
    "fleet",
    "health",
    "identify",
    "identify_joints",
    "library",
    "models",
    "recordings",
    "train",
    "tune",
    "verify",
]
_MODULES = {  # where the other names are, which are no modules of this package
    "Comparison": "api.comparison",
    "Compensator": "own_loop",
    "Fleet": "fleets",
    "Identified": "api.identification",
    "IdentifiedJoints": "api.joints",
    "Trained": "api.training",
    "Tuned": "api.tuning",
    "Verified": "api.comparison",
    "compare": "api.comparison",
    "fleet": "fleets",
    "identify": "api.identification",
    "identify_joints": "api.joints",
    "library": "models",
    "train": "api.training",
    "tune": "api.tuning",
    "verify": "api.comparison",
}

if not TYPE_CHECKING:  # by it, every name would be known to a type checker

    def __getattr__(name: str) -> Any:
        if name in __all__:
            module = importlib.import_module(f"friction_hil.{_MODULES.get(name, name)}")
            return getattr(module, name) if name in _MODULES else module
        raise AttributeError(f"module 'friction_hil' has no attribute {name!r}; it has {', '.join(__all__)}")
