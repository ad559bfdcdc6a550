"""Export of morphs to files for other programs: ``python -m nsm.export``."""
