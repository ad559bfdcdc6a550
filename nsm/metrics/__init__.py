"""Quality figures of a morph; everything takes the `Morph` protocol and nothing else."""

from nsm.metrics.evaluation import STAGES, Evaluation, Protocol, evaluate_morph
from nsm.metrics.figures import MEANINGS, markdown_table, meaning, table
from nsm.metrics.volume_curve import VolumeCurve, even_times, volume_beyond, volume_curve

__all__ = [
    "MEANINGS",
    "STAGES",
    "Evaluation",
    "Protocol",
    "VolumeCurve",
    "evaluate_morph",
    "even_times",
    "markdown_table",
    "meaning",
    "table",
    "volume_beyond",
    "volume_curve",
]
