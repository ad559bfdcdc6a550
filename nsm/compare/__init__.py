"""Many runs, compared: ``python -m nsm.compare``."""
