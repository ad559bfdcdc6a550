"""Training: ``python -m nsm.train``."""
