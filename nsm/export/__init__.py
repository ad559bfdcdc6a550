"""Files for other programs: ``python -m nsm.export``."""
