"""Training of friction networks by Levenberg-Marquardt. Pure: no files, no clock."""

from friction_hil.training.layout import Samples
from friction_hil.training.task import TrainingTask, task_of_model, task_of_recordings
from friction_hil.training.train import Errors, Options, Progress, TrainingResult, train
from friction_hil.training.trained_model import NetworkSpec, TrainedModel, train_task

__all__ = [
    "Errors",
    "NetworkSpec",
    "Options",
    "Progress",
    "Samples",
    "TrainedModel",
    "TrainingResult",
    "TrainingTask",
    "task_of_model",
    "task_of_recordings",
    "train",
    "train_task",
]
