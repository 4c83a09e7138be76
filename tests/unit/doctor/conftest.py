"""What all tests of doctor need."""

import pytest

from friction_hil.daemon import realtime
from friction_hil.drive import Finding


@pytest.fixture(autouse=True)
def unlocked(monkeypatch):
    """Leave the memory of pytest as it is; test_realtime locks that of other processes."""
    monkeypatch.setattr(realtime, "_lock_memory", lambda stack: Finding("memory", "pass", "memory is locked"))
