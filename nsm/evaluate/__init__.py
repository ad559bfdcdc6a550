"""Measurements of trained morphs: ``python -m nsm.evaluate``."""
