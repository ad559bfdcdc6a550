"""Interactive viewer in the browser: ``python -m nsm.view``."""
