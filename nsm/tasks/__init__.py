"""Training: a still shape, or a morph."""

from nsm.tasks.base import Collapse, FieldTask
from nsm.tasks.data import FieldData
from nsm.tasks.ends import Ends, prepare_ends, starting_network
from nsm.tasks.fit import SdfFit, draw_pools
from nsm.tasks.morph import MorphTask
from nsm.tasks.schedule import constant, warmup_cosine
from nsm.tasks.sdf import SdfTask

__all__ = [
    "Collapse",
    "Ends",
    "FieldData",
    "FieldTask",
    "MorphTask",
    "SdfFit",
    "SdfTask",
    "constant",
    "draw_pools",
    "prepare_ends",
    "starting_network",
    "warmup_cosine",
]
