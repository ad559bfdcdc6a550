"""The one error that people see without a traceback."""


class InputError(ValueError):
    """What was given cannot be used; the message is one sentence: what came, why it fails, what to type instead."""
