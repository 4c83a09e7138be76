"""friction_hil: real-time friction compensation for servo axes.

The public Python interface is ``friction_hil.models``, ``friction_hil.recordings``, ``friction_hil.export``,
``friction_hil.health`` and ``friction_hil.dynamics``; they are imported when first used, so that
``import friction_hil`` costs nothing.
"""

import importlib
from types import ModuleType

__version__ = "0.3.0.dev0"
__all__ = ["dynamics", "export", "health", "models", "recordings"]


def __getattr__(name: str) -> ModuleType:
    if name in __all__:
        return importlib.import_module(f"friction_hil.{name}")
    raise AttributeError(f"module 'friction_hil' has no attribute {name!r}; it has {', '.join(__all__)}")
