"""Training of friction networks by Levenberg-Marquardt. Pure: no files, no clock."""

from friction_hil.training.layout import Samples
from friction_hil.training.task import Candidate, Task, Wanted, task_of_model, task_of_recordings, train_task
from friction_hil.training.train import Errors, Options, Progress, Trained, train

__all__ = [
    "Candidate",
    "Errors",
    "Options",
    "Progress",
    "Samples",
    "Task",
    "Trained",
    "Wanted",
    "task_of_model",
    "task_of_recordings",
    "train",
    "train_task",
]
