"""Quicker imports of third-party packages, in processes of the command line alone.

``import can`` of python-can imports its logger of MF4 files, and that imports asammdf and pandas wherever they are
installed, which takes several times as long as all the rest. No command uses this logger: `friction_hil.recordings`
reads and writes MF4 itself. In a program that imports ``friction_hil`` as a library nothing is changed.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType

_LOGGER, _PACKAGE = "can.io.mf4", "asammdf"


class _Loader(SourceFileLoader):
    """Loads the logger as where asammdf is not installed: it then refuses MF4 files with a message."""

    def exec_module(self, module: ModuleType) -> None:
        """Run the code of the module; what is imported already stays."""
        if _PACKAGE in sys.modules:
            super().exec_module(module)
            return
        sys.modules[_PACKAGE] = None  # type: ignore[assignment]  # documented: the import then fails
        try:
            super().exec_module(module)
        finally:
            del sys.modules[_PACKAGE]


class _Finder:
    """Finds the logger, and leaves every other module to the finders after it."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the specification of the logger with a loader that keeps asammdf out."""
        if name != _LOGGER:
            return None
        found = PathFinder.find_spec(name, path, target)
        if found is not None and type(found.loader) is SourceFileLoader:
            found.loader = _Loader(name, found.loader.path)
        return found


def keep_asammdf_out_of_can() -> None:
    """Let ``import can`` pass over asammdf, if it has not been imported yet."""
    if _Finder not in sys.meta_path:
        sys.meta_path.insert(0, _Finder)
