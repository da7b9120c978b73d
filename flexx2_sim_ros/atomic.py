"""
Atomic output: a file is written completely or not at all.

Files are written into a hidden scratch folder beside the target and moved to their place when they
are complete. A process locks its scratch folder. The folder of a killed process has no lock, and
the next run that writes beside it removes it.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import errno
import json
import os
from pathlib import Path
import secrets
import shutil
import sqlite3
import stat
import sys
import tempfile
from typing import Any

from flexx2_sim_ros.errors import InputError, MachineError, shown_path
from flexx2_sim_ros.signals import before_leaving

if sys.platform != 'win32':  # On Windows, leftovers are not removed.
    import fcntl

_PREFIX, _SUFFIX = '.flexx2-', '.part'
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
_SQLITE_FULL = 'database or disk is full'
# The scratch folders of this process, each with the file descriptor that locks it.
_scratch: dict[Path, int | None] = {}


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """
    Yield a scratch path for a file or folder; it gets its name when the block ends without error.

    A file of the target's name is replaced; a symbolic link is followed. The scratch path has the
    same file name. The block creates it in the usual way, so that the umask sets its permissions.
    Raises InputError when the target cannot be written, and for every `OSError` and
    `sqlite3.Error` in the block. An existing file is then unchanged.
    """
    target = checked_target(path)
    with named(path), scratch_folder(target.parent) as folder:
        part = folder / target.name
        yield part
        part.replace(target)


@contextmanager
def whole_files(folder: str | Path) -> Iterator[Path]:
    """
    Yield a scratch folder; its files move to their place when the block ends without error.

    That is an existing folder; files of the same names in it are replaced. Links are followed.
    Raises InputError as `whole`.
    """
    folder = Path(folder)
    with named(folder), scratch_folder(folder) as part:
        yield part
        for file in part.iterdir():
            checked_target(folder / file.name)
        for file in part.iterdir():
            with whole(folder / file.name) as moved:
                shutil.move(file, moved)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all; see `whole`."""
    with whole(path) as part:
        part.write_text(text, encoding='utf-8', errors='backslashreplace')


def write_texts(folder: str | Path, texts: Mapping[str, str]) -> None:
    """Write text files by name into a folder, made if missing, all of them or none."""
    with whole_files(output_folder(folder)) as part:
        for name, text in texts.items():
            write_text(part / name, text)


def as_json(table: Mapping[str, Any]) -> str:
    """Return the content of a JSON file."""
    return json.dumps(table, indent=2, allow_nan=False) + '\n'


def checked_target(path: str | Path) -> Path:
    """
    Return the path to write to, with links resolved.

    Commands call this before a long computation, so that they fail early. Raises InputError when
    the path is a folder, a device, a pipe or a link to itself, its name is too long, or its folder
    is missing or read-only.
    """
    with named(path):
        with suppress(FileNotFoundError):
            mode = Path(path).stat().st_mode  # Complains about loops and long names.
            if not stat.S_ISREG(mode):
                kind = 'a folder' if stat.S_ISDIR(mode) else 'a device or pipe'
                raise InputError(
                    f'{shown_path(path)}: cannot be written: must be a file, got {kind}'
                )
        target = Path(os.path.realpath(path))
        if not target.parent.is_dir():
            there = shown_path(target.parent)
            raise InputError(f'{shown_path(path)}: cannot be written: there is no folder {there}')
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise InputError(f'{shown_path(path)}: cannot be written: the folder is read-only')
    return target


def check_no_overwrite(option: str, files: Iterable[Path], force: bool) -> None:
    """
    Raise InputError when a file is there that a command would write over, unless it is forced to.

    ``option`` is the one that names the file, ``force`` whether ``--force`` is given.
    """
    there = [file for file in files if file.exists()]
    if there and not force:
        raise InputError(
            f'{option}: must not be there already, or --force must be given, got '
            f'{shown_path(there[0])}'
        )


def check_distinct(source: str | Path, target: str | Path) -> None:
    """Raise `InputError` when the target is the source, also by another path."""
    with suppress(OSError):
        if Path(source).samefile(target):
            raise InputError(f'{target}: must be another file than the input, got the same')


def check_folder(path: str | Path) -> None:
    """Raise `InputError` where `output_folder` would, without making a folder."""
    path = Path(path)
    with named(path):
        with suppress(FileNotFoundError):
            path.stat()  # Complains about loops, long names and files on the way.
        there = next(above for above in (path, *path.absolute().parents) if above.exists())
        if not there.is_dir():
            raise InputError(
                f'{shown_path(path)}: cannot be written: must be a folder, got a file'
            )
        if not os.access(there, os.W_OK | os.X_OK):
            raise InputError(f'{shown_path(path)}: cannot be written: the folder is read-only')


def check_outputs(option: str, folder: str | Path, names: Iterable[str]) -> None:
    """
    Check that files can be written to a folder, before a long computation.

    The folder need not exist; ``option`` is the one that names it. Raises InputError where
    `output_folder` or `whole_files` would.
    """
    try:
        check_folder(folder)
        if Path(folder).exists():
            for name in names:
                checked_target(Path(folder) / name)
    except InputError as error:
        raise InputError(f'{option}: {error}') from error


def output_folder(path: str | Path) -> Path:
    """
    Make a folder for results and its parents, unless it exists.

    Raises InputError when it cannot be made, is a file, or is read-only.
    """
    check_folder(path)
    with named(path):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)


@contextmanager
def named(path: str | Path) -> Iterator[None]:
    """Turn errors of writing in the block into an `InputError` that names the path."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        kind = MachineError if _is_full(error) else InputError
        raise kind(f'{shown_path(path)}: {reason(error)}') from error


def _is_full(error: OSError | sqlite3.Error) -> bool:
    # Whether the device has no space left.
    if isinstance(error, OSError):
        return error.errno in _NO_SPACE
    return _SQLITE_FULL in str(error)


def reason(error: OSError | sqlite3.Error) -> str:
    """Return why something cannot be written, as a clause without a name."""
    if _is_full(error):
        return 'no space left on the device'
    if isinstance(error, OSError):
        text = os.strerror(error.errno) if error.errno else str(error)
        return f'cannot be written: {text[:1].lower()}{text[1:]}'
    return f'cannot be written: {error}'


@contextmanager
def scratch_folder(parent: str | Path | None = None) -> Iterator[Path]:
    """
    Yield a new hidden folder that is removed when the block ends, also after an error.

    It is made in the system's folder for temporary files when ``parent`` is left out.
    """
    parent = Path(tempfile.gettempdir() if parent is None else parent)
    _remove_leftovers(parent)
    folder = _make(parent)
    try:
        yield folder
    finally:
        _discard(folder)


def discard_scratch() -> None:
    """Remove all scratch folders of this process before it ends."""
    for folder in list(_scratch):
        _discard(folder)


before_leaving(discard_scratch)


def _make(parent: Path) -> Path:
    while True:
        folder = parent / f'{_PREFIX}{secrets.token_hex(8)}{_SUFFIX}'
        # Registered first, because a signal may arrive at any time.
        _scratch[folder] = None
        try:
            folder.mkdir(mode=0o700)
            _scratch[folder] = _lock(folder, wait=True)
        except FileNotFoundError:
            del _scratch[folder]
            if not parent.is_dir():
                raise
            continue
        except OSError:
            del _scratch[folder]
            raise
        # Another process may have removed it as a leftover before it was locked.
        if folder.is_dir():
            return folder
        _discard(folder)


def _discard(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    lock = _scratch.pop(folder, None)
    if lock is not None:
        os.close(lock)


def _remove_leftovers(parent: Path) -> None:
    for folder in parent.glob(f'{_PREFIX}*{_SUFFIX}'):
        with suppress(OSError):
            lock = _lock(folder, wait=False)
            if lock is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(lock)


def _lock(folder: Path, wait: bool) -> int | None:
    # A lock that the system releases when the process ends. None if such locks do not exist.
    if sys.platform == 'win32':
        return None
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        if not wait:
            raise
        return None
    return descriptor
