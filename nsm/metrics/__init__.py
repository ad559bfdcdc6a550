"""Figures of merit of a morph. Everything here takes a `Morph` and nothing else."""

from nsm.metrics.evaluation import Evaluation, evaluate_morph
from nsm.metrics.figures import all_metrics, find_metric
from nsm.metrics.measurements import STAGES, Measurements
from nsm.metrics.metric import AT, EndMetric, Metric, MorphMetric, Section
from nsm.metrics.protocol import Protocol
from nsm.metrics.volume_curve import VolumeCurve, even_times, volume_beyond, volume_curve

__all__ = [
    "AT",
    "STAGES",
    "EndMetric",
    "Evaluation",
    "Measurements",
    "Metric",
    "MorphMetric",
    "Protocol",
    "Section",
    "VolumeCurve",
    "all_metrics",
    "evaluate_morph",
    "even_times",
    "find_metric",
    "volume_beyond",
    "volume_curve",
]
