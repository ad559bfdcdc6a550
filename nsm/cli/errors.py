"""The error that users see without a traceback."""


class InputError(ValueError):
    """Input that cannot be used.

    The message is complete for the user: "`name` must be …, got …. Try `…`."
    """
