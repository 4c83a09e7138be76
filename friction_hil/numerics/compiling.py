"""Who wants to know that numba begins to compile, which takes seconds, and happens once on a machine."""

from collections.abc import Callable

listeners: list[Callable[[], None]] = []
