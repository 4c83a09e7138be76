"""Tuning: an axis learns its friction on its own drive, and shows what knowing it is worth."""

from friction_hil.tuning.trial import Trial
from friction_hil.tuning.tune import AxisTuning, Candidate, Settings, Tuning, tune

__all__ = ["AxisTuning", "Candidate", "Settings", "Trial", "Tuning", "tune"]
