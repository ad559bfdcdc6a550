"""Figures of merit of a morph. Everything here takes a `Morph` and nothing else."""

from nsm.metrics.evaluation import Evaluation, evaluate_morph
from nsm.metrics.figures import all_metrics, find_metric
from nsm.metrics.measurements import Measurements, stages
from nsm.metrics.metric import AT, KeyMetric, Metric, MorphMetric, Section
from nsm.metrics.protocol import Protocol
from nsm.metrics.volume_curve import VolumeCurve, even_times, times_through, volume_beyond, volume_curve, with_key_times

__all__ = [
    "AT",
    "Evaluation",
    "KeyMetric",
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
    "stages",
    "times_through",
    "volume_beyond",
    "volume_curve",
    "with_key_times",
]
