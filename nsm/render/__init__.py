"""Pictures and films: ``python -m nsm.render``."""
