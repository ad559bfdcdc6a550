"""The library for users: `morph` trains on two shapes, `load_morph` reads a checkpoint, both give a `TrainedMorph`."""

from nsm.library.trained import TrainedMorph, load_morph, load_official
from nsm.library.training import morph

__all__ = ["TrainedMorph", "load_morph", "load_official", "morph"]
