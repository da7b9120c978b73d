"""The errors this package raises on purpose, and text from outside that is safe to show."""


class InputError(ValueError):
    """
    Something given to the package cannot be used.

    The message names the field, what was found and what is wanted, so that it can be shown to
    a person as it is: the command line prints it without a traceback, a node logs it. What it
    repeats from a file or a message cannot control the terminal.
    """

    def __init__(self, message: str) -> None:
        """Make the message safe to show."""
        super().__init__(printable(message))


def printable(text: str) -> str:
    """
    Return text with terminal escapes and all that is not visible as escape sequences.

    Line ends and tabs stay. Names in files, notes and messages of others go through this before
    they are shown.
    """
    return ''.join(letter if letter.isprintable() or letter in '\n\t'
                   else letter.encode('unicode_escape', 'surrogatepass').decode()
                   for letter in text)
