"""Configuration of a machine: declaration of all keys, loading and checking, JSON Schema for editors."""

from friction_hil.config.axis import AxisConfig, AxisLimits, Compensation, Controller, Shadow
from friction_hil.config.bus import BusConfig
from friction_hil.config.json_schema import json_schema
from friction_hil.config.load import file_problems, from_dict, load, located, missing_models, self_contained
from friction_hil.config.recording import RecordingConfig
from friction_hil.config.schema import Configuration, Realtime
from friction_hil.config.trajectories import (
    AxisExperiment,
    Circle,
    Experiment,
    ExperimentBounds,
    Hold,
    MotionSequence,
    Multisine,
    NoTrajectory,
    SequencePart,
    Sine,
    Strokes,
    Trajectory,
    Triangle,
)

__all__ = [
    "AxisConfig",
    "AxisExperiment",
    "AxisLimits",
    "BusConfig",
    "Circle",
    "Compensation",
    "Configuration",
    "Controller",
    "Experiment",
    "ExperimentBounds",
    "Hold",
    "MotionSequence",
    "Multisine",
    "NoTrajectory",
    "Realtime",
    "RecordingConfig",
    "SequencePart",
    "Shadow",
    "Sine",
    "Strokes",
    "Trajectory",
    "Triangle",
    "file_problems",
    "from_dict",
    "json_schema",
    "load",
    "located",
    "missing_models",
    "self_contained",
]
