"""Callbacks of training: checkpoints, volume curves, meshes, pictures, progress, and signals."""

from nsm.train.callbacks.checkpoints import Checkpoints
from nsm.train.callbacks.clock import TrainingClock
from nsm.train.callbacks.csv_log import CsvLog
from nsm.train.callbacks.interruption import ExitOnSignal, StopOnSignal
from nsm.train.callbacks.mesh_snapshots import MeshSnapshots
from nsm.train.callbacks.progress import Progress
from nsm.train.callbacks.step_times import StepTimes, Unvalidated
from nsm.train.callbacks.strip import Strip
from nsm.train.callbacks.tensorboard import TensorBoardLog
from nsm.train.callbacks.tracker import Rewind, Tracker, Trackers, closing, opened
from nsm.train.callbacks.volume_curve import VolumeCurveLog
from nsm.train.callbacks.wandb_log import WandbLog
from nsm.train.callbacks.writer import MorphWriter

__all__ = [
    "Checkpoints",
    "CsvLog",
    "ExitOnSignal",
    "MeshSnapshots",
    "MorphWriter",
    "Progress",
    "Rewind",
    "StepTimes",
    "StopOnSignal",
    "Strip",
    "TensorBoardLog",
    "Tracker",
    "Trackers",
    "TrainingClock",
    "Unvalidated",
    "VolumeCurveLog",
    "WandbLog",
    "closing",
    "opened",
]
