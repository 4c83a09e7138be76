"""Compilation of the numeric kernels with numba, cached on disk.

Every kernel is compiled through this module, which sets the floating-point rules. Fused multiply-adds and
re-association stay off (numba's default), so that a kernel gives the same bits whether it runs alone, in the loop or
inlined into another kernel.
"""

import contextlib
import hashlib
import importlib
import os
import re
import shutil
import threading
import time
from collections.abc import Callable
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from friction_hil.numerics import compiling

Array = NDArray[np.float64]
StructuredArray = NDArray[np.void]  # of length 1: kernels read and change its fields by name
Function = TypeVar("Function", bound=Callable[..., object])

_PACKAGE = Path(__file__).parents[1]
_KEPT_DAYS = 14
# Kernels are called from Python and from other kernels, not from C: a wrapper for C would only take time to compile.
OPTIONS: Any = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INNER = {"no_cpython_wrapper": True}  # what only kernels call needs none for Python either
_ABOVE = ("cli", "demo")  # they only speak of numba: a change of their words is to compile nothing again
_HAS_KERNELS = re.compile(rb"@(compiled|inlined|inner|inserted)|numba")


def kernel_sources() -> list[Path]:
    """Return the source files of the package that contain kernels, sorted; the rooms above all kernels have none."""
    below = (path for path in _PACKAGE.rglob("*.py") if path.relative_to(_PACKAGE).parts[0] not in _ABOVE)
    return sorted(path for path in below if _HAS_KERNELS.search(path.read_bytes()))


@cache
def cache_folder() -> str | None:
    """Return the folder for compiled code, or None if none can be written.

    numba notices a change in the file of a kernel, but not in the files of the kernels that it calls; the name of the
    folder is therefore a digest of all sources with kernels.
    """
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "friction_hil"
        folder = base / digest.hexdigest()[:16]
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)  # another process may create it at the same time
            _remove_stale(base)
    except (OSError, RuntimeError):  # a user unknown to the system has no home
        return None
    return str(folder) if os.access(folder, os.W_OK) else None


def _remove_stale(base: Path) -> None:
    for folder in base.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another process may remove it at the same time
            if folder.is_dir() and time.time() - folder.stat().st_mtime > _KEPT_DAYS * 86400:
                shutil.rmtree(folder, ignore_errors=True)


class Kernel:
    """A function that numba compiles when Python or another kernel first calls it; it has the dispatcher's attributes.

    Until then numba is not even imported: whoever reads a configuration or lists models does not wait for it.
    """

    def __init__(self, function: Callable[..., object], **options: Any) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, options
        self.run: Callable[..., Any] = self._first_call  # for callers in a loop: it saves a Python call

    def __call__(self, *arguments: Any) -> Any:
        """Run the compiled function."""
        return self.run(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> str:
        return self.__qualname__  # type: ignore[no-any-return]

    @cached_property
    def dispatcher(self) -> Any:
        """Dispatcher of numba, for other kernels; Python may call it unless it has no wrapper for it."""
        with _LOCK:
            return _dispatcher(self._function, self._options)

    @cached_property
    def called(self) -> Any:
        """Dispatcher that Python may call."""
        if not self._options.keys() & _INNER:
            return self.dispatcher
        with _LOCK:
            return _dispatcher(self._function, {"nogil": True}, "called")

    def _first_call(self, *arguments: Any) -> Any:
        self.run = self.called
        return self.run(*arguments)


def ready(function: Function) -> Function:
    """Return the dispatcher of a kernel, for callers that call it in each cycle: it saves a Python call."""
    return cast(Function, cast(Kernel, function).called)


def compiled(function: Function) -> Function:
    """Compile ``function`` in numba's nopython mode; division by zero gives infinity or NaN, as in C."""
    return cast(Function, Kernel(function, nogil=True))


def inlined(function: Function) -> Function:
    """Compile ``function`` into each compiled function that calls it, where constant arguments are folded."""
    return cast(Function, Kernel(function, nogil=True, forceinline=True, **_INNER))


def inner(function: Function) -> Function:
    """Compile ``function`` for calls from other kernels: it takes half as long as for calls from Python."""
    return cast(Function, Kernel(function, nogil=True, **_INNER))


def inserted(function: Function) -> Function:
    """Insert ``function`` into each compiled function that calls it, before that is compiled.

    For large functions with few callers: unlike what is `inlined`, it is not optimised and translated by itself first.
    """
    return cast(Function, Kernel(function, nogil=True, inline="always"))


def compiled_for_one_sample(function: Function) -> Function:
    """Compile ``function`` for calls shorter than it takes to release Python's global lock."""
    return cast(Function, Kernel(function))


class Deferred:
    """A module that is imported when it is first needed."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self._name), name)


_LOCK = threading.RLock()
_waiting: list[Callable[[], None]] = []  # for numba


def once_compiling(action: Callable[[], None]) -> None:
    """Tell numba something, as soon as there is something to compile."""
    if _numba.cache_info().currsize:
        action()
    else:
        _waiting.append(action)


@cache
def _numba() -> Any:
    """Import numba, and tell it what it has to know of kernels and their types."""
    import numba  # imported here: a command that compiles nothing must not wait for it
    from numba.core import event
    from numba.extending import typeof_impl

    class Said(event.Listener):
        def on_start(self, event: object) -> None:
            for each in compiling.listeners:
                each()

        def on_end(self, event: object) -> None:
            pass

    register: Any = event.register  # it has no types
    register("numba:compile", Said())
    typeof_impl.register(Kernel)(lambda kernel, context: typeof_impl(kernel.dispatcher, context))
    return numba


def _dispatcher(function: Callable[..., object], options: Any, *part: str) -> Any:
    numba = _numba()
    while _waiting:
        _waiting.pop(0)()
    folder = cache_folder()
    settings: Any = numba.config
    before = settings.CACHE_DIR
    if folder is not None:
        settings.CACHE_DIR = os.path.join(folder, *part)
    try:
        return numba.njit(function, cache=folder is not None, **OPTIONS, **options)
    finally:
        settings.CACHE_DIR = before
