"""The configuration and the model file: YAML, checked as a whole, every mistake with its line.

>>> import friction_hil.config
>>> friction_hil.config.model_from_argument("coulomb:coulomb=0.08,viscous=2e-3").friction.parameters
{'coulomb': 0.08, 'static': 0.08, 'viscous': 0.002}
"""

from friction_hil.config.json_schema import json_schema
from friction_hil.config.load import (
    file_problems,
    from_dict,
    load,
    load_model_file,
    located,
    model_from_argument,
    read_section,
    self_contained,
)
from friction_hil.config.model_file import Friction, Gravity, Mechanics, ModelFile
from friction_hil.config.schema import (
    AxisConfig,
    AxisExperiment,
    BusConfig,
    Circle,
    Compensation,
    Configuration,
    Controller,
    Experiment,
    ExperimentBounds,
    Hold,
    Limits,
    NoTrajectory,
    Realtime,
    RecordingConfig,
    Shadow,
    Sine,
    Trajectory,
    Triangle,
)
from friction_hil.config.yaml_text import dump

__all__ = [
    "AxisConfig",
    "AxisExperiment",
    "BusConfig",
    "Circle",
    "Compensation",
    "Configuration",
    "Controller",
    "Experiment",
    "ExperimentBounds",
    "Friction",
    "Gravity",
    "Hold",
    "Limits",
    "Mechanics",
    "ModelFile",
    "NoTrajectory",
    "Realtime",
    "RecordingConfig",
    "Shadow",
    "Sine",
    "Trajectory",
    "Triangle",
    "dump",
    "file_problems",
    "from_dict",
    "json_schema",
    "load",
    "load_model_file",
    "located",
    "model_from_argument",
    "read_section",
    "self_contained",
]
