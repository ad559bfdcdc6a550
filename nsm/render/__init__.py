"""Pictures and films of morphs: ``python -m nsm.render``."""
