"""The errors this package raises on purpose."""


class InputError(ValueError):
    """
    Something given to the package cannot be used.

    The message names the field, what was found and what is wanted, so that it can be shown to
    a person as it is: the command line prints it without a traceback, a node logs it.
    """
