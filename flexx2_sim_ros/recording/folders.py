"""Folders of recordings."""

from pathlib import Path

from flexx2_sim_ros.errors import InputError

_ROS2_FILES = ('.mcap', '.db3')
BAG_FILES = (*_ROS2_FILES, '.bag')


def find_recordings(folder: str | Path) -> list[Path]:
    """
    List the recordings in a folder: ``.npz`` files and bags (folders, or files of bags).

    Files of bags end in ``.mcap``, ``.db3`` or ``.bag``. Recordings are sorted by name; at least
    one. Unreadable folders are included, so that opening them gives the reason; hidden files are
    not. Raises InputError when there is no such folder or no recording in it, or it cannot be
    read.
    """
    folder = Path(folder)
    try:
        if not folder.is_dir():
            got = 'a file' if folder.exists() else 'none'
            raise InputError(
                f'{folder}: must be a folder with recordings (.npz or bags), got {got}'
            )
        found = sorted(
            path
            for path in folder.iterdir()
            if not path.name.startswith('.')
            and (path.suffix in ('.npz', *BAG_FILES) or is_bag(path))
        )
    except OSError as error:
        raise InputError(f'{folder}: cannot be read: {error}') from error
    if not found:
        raise InputError(f'{folder}: must have recordings (.npz files or bags), got none')
    return found


def has_bag_files(folder: Path) -> bool:
    """Return whether a folder has files of a rosbag2 bag, also compressed ones."""
    return any(file.name.removesuffix('.zstd').endswith(_ROS2_FILES) for file in folder.iterdir())


def is_bag(path: Path) -> bool:
    """Return whether a path is a folder that is a rosbag2 bag or cannot be read."""
    if not path.is_dir():
        return False
    try:
        return any(p.suffix in _ROS2_FILES or p.name == 'metadata.yaml' for p in path.iterdir())
    except OSError:
        return True
