"""Quality figures of a morph; everything takes the `Morph` protocol and nothing else."""

from nsm.metrics.evaluation import Evaluation, evaluate_morph, table
from nsm.metrics.volume_curve import VolumeCurve, even_times, volume_curve

__all__ = ["Evaluation", "VolumeCurve", "evaluate_morph", "even_times", "table", "volume_curve"]
