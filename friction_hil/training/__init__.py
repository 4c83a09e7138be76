"""Training of friction networks by Levenberg-Marquardt. Pure: no files, no clock."""

from friction_hil.training.contenders import Contender
from friction_hil.training.layout import Samples
from friction_hil.training.selection import Selection, residual_model_file, select
from friction_hil.training.task import TrainingTask, task_of_model, task_of_recordings
from friction_hil.training.train import Errors, Options, Progress, TrainingResult, train
from friction_hil.training.trained_model import NetworkSpec, TrainedModel, train_task

__all__ = [
    "Contender",
    "Errors",
    "NetworkSpec",
    "Options",
    "Progress",
    "Samples",
    "Selection",
    "TrainedModel",
    "TrainingResult",
    "TrainingTask",
    "residual_model_file",
    "select",
    "task_of_model",
    "task_of_recordings",
    "train",
    "train_task",
]
