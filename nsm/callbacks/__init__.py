"""What happens around training: curves, meshes, pictures, checkpoints, progress."""

from nsm.callbacks.checkpoints import Checkpoints
from nsm.callbacks.csv_log import CsvLog
from nsm.callbacks.interruption import ExitOnSignal, StopOnSignal
from nsm.callbacks.mesh_snapshots import MeshSnapshots
from nsm.callbacks.progress import Progress
from nsm.callbacks.step_times import StepTimes, Unvalidated
from nsm.callbacks.strip import Strip
from nsm.callbacks.volume_curve import VolumeCurveLog

__all__ = [
    "Checkpoints",
    "CsvLog",
    "ExitOnSignal",
    "MeshSnapshots",
    "Progress",
    "StepTimes",
    "StopOnSignal",
    "Strip",
    "Unvalidated",
    "VolumeCurveLog",
]
