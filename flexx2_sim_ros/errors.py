"""The error for wrong input, and functions that make text from outside safe to show."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from os import PathLike
from typing import Any

_LONGEST_NAME = 100  # that is compared with others
# Import name: what pip installs. Not every command and node needs these.
_OPTIONAL = {
    'av': 'av',
    'cv2': 'opencv-python-headless',
    'embreex': 'embreex',
    'h5py': 'h5py',
    'matplotlib': 'matplotlib',
    'mujoco': '"mujoco>=3.5"',
    'PIL': 'pillow',
    'pyarrow': 'pyarrow',
    'rosbags': '"rosbags>=0.11"',
    'scipy': 'scipy',
    'sklearn': 'scikit-learn',
    'threadpoolctl': 'threadpoolctl',
    'trimesh': 'trimesh',
    'warp': 'warp-lang',
}


class InputError(ValueError):
    """
    Something given to the package cannot be used.

    The message names the field, what it must be and what it is, so that it can be shown to
    a person as it is: the command line prints it without a traceback, a node logs it. What it
    repeats from a file or a message cannot control the terminal.
    """

    def __init__(self, message: str) -> None:
        """Make the message safe to show."""
        super().__init__(printable(message))


@contextmanager
def one_sentence(problem: str) -> Iterator[None]:
    """
    Turn any error of a library that reads what came from outside into an `InputError`.

    ``problem`` begins the message; the reason of the library follows.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # Libraries raise errors of all kinds on damaged files.
        reason = ' '.join(str(error).split())
        raise InputError(f'{problem}: {unquoted(reason, 200) or type(error).__name__}') from error


class MachineError(InputError):
    """The machine ended the work, not what was given: no memory, no space, no scheduler left."""


def printable(text: str) -> str:
    """
    Return text with terminal escapes and other invisible characters as escape sequences.

    Line ends and tabs stay. Names in files, notes and messages of others go through this before
    they are shown.
    """
    return ''.join(
        letter
        if letter.isprintable() or letter in '\n\t'
        else letter.encode('unicode_escape', 'surrogatepass').decode()
        for letter in text
    )


def shown(value: Any, most: int = 80) -> str:
    """
    Return a value from outside as an error message shows it: short, and safe to print.

    A text gets quotes; control characters, terminal escapes and code points that are no characters
    are shown as escape sequences. The middle of a text of more than ``most`` characters is left
    out.
    """
    try:
        text = repr(value)
    except ValueError:  # Python does not print whole numbers of more than 4,300 digits.
        return 'a very large number'
    if len(text) <= most:
        return text
    end = (most - 3) // 2
    return f'{text[: most - 3 - end]}...{text[-end:]}'


def unquoted(text: Any, most: int = 80) -> str:
    """Return a name as an error message shows it: as `shown`, without quotes."""
    if not isinstance(text, str):
        return shown(text, most)
    return shown(text, most + 2)[1:-1]


def shown_path(path: str | PathLike[str]) -> str:
    """Return a path as an error message shows it: as `unquoted`, longer."""
    return unquoted(str(path), 160)


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return the hint ``, did you mean ...?`` with the most similar name, whatever its case."""
    known = {one.lower(): one for one in names}
    close = get_close_matches(name[:_LONGEST_NAME].strip().lower(), known, 1)
    return f', did you mean {known[close[0]]}?' if close else ''


def each_once(said: Iterable[tuple[str, str]]) -> list[str]:
    """
    Return sentences about several files, given as (name, sentence), each once.

    Those that differ only in the name of their file count as the same: the first is returned, with
    how many more files it is true of.
    """
    alike: dict[str, list[str]] = {}
    for name, sentence in said:
        alike.setdefault(sentence.replace(name, ''), []).append(sentence)
    return [
        first + (f' (the same for {len(others)} more)' if others else '')
        for first, *others in alike.values()
    ]


def missing_library(error: ModuleNotFoundError) -> InputError:
    """
    Return the error for a command that needs a library that is not installed.

    Raises the error given, when it is about anything else.
    """
    name = (error.name or '').partition('.')[0]
    if name not in _OPTIONAL:
        raise error
    return InputError(f'{name} is not installed, and this needs it: pip install {_OPTIONAL[name]}')
