"""Training tasks: the signed distance of a shape, or a morph."""

from nsm.train.tasks.base import Collapse, FieldTask
from nsm.train.tasks.data import FieldData
from nsm.train.tasks.fit import SdfFit, draw_pools
from nsm.train.tasks.keys import Keys, prepare_keys, starting_network
from nsm.train.tasks.morph import MorphTask
from nsm.train.tasks.schedule import constant, warmup_cosine
from nsm.train.tasks.sdf import SdfTask

__all__ = [
    "Collapse",
    "FieldData",
    "FieldTask",
    "Keys",
    "MorphTask",
    "SdfFit",
    "SdfTask",
    "constant",
    "draw_pools",
    "prepare_keys",
    "starting_network",
    "warmup_cosine",
]
