"""Layers of equal volume between nested surfaces: ``python -m nsm.layers``."""
