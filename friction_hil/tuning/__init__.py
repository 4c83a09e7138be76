"""Tuning: an axis moves, its friction is identified, and models of it are tried on the machine."""

from friction_hil.tuning.choice import AxisTuning, TriedModel
from friction_hil.tuning.outcome import Tuning
from friction_hil.tuning.settings import Dialog, TuneSettings
from friction_hil.tuning.trial import Trial
from friction_hil.tuning.tune import tune

__all__ = ["AxisTuning", "Dialog", "Trial", "TriedModel", "TuneSettings", "Tuning", "tune"]
