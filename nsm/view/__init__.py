"""Morphs on a page in the browser: ``python -m nsm.view``."""
