"""Find the package's data files and executables, in a checkout and in every install."""

from functools import lru_cache
import os
from pathlib import Path
import sys

from flexx2_sim_ros.errors import InputError

_MARKER = 'modes.yaml'


@lru_cache(maxsize=1)
def config_dir() -> Path:
    """
    Return the folder that holds the package's configuration files.

    In a checkout (or an editable or symlinked install) it is ``config/`` beside the package; in
    an installed one it is ``share/flexx2_sim_ros/config`` under the prefix, the place that
    ``colcon build``, Debian packages and ``pip install`` all put it. Raises InputError when the
    installation is incomplete and no such folder exists.
    """
    package = Path(__file__).resolve().parent
    candidates = [package.parent / 'config']
    candidates += [up / 'share' / 'flexx2_sim_ros' / 'config' for up in package.parents]
    for candidate in candidates:
        if (candidate / _MARKER).is_file():
            return candidate
    raise InputError(
        'config folder: must be config/ in a checkout or share/flexx2_sim_ros/config in an '
        f'install, got no {_MARKER} near {package}. Reinstall the package.'
    )


def checkout() -> Path | None:
    """Return the folder of the checkout that has this package, None where it is installed."""
    folder = Path(__file__).resolve().parents[1]
    return folder if (folder / 'study' / 'benchmark').is_dir() else None


def executable(name: str) -> Path:
    """
    Return the path of ``flexx2``, ``flexx2_camera`` or ``go1_cameras``.

    It is in ``lib/flexx2_sim_ros`` under the prefix, where ``colcon build`` puts it, else in
    ``bin/`` beside this Python, where ``pip install`` does, else in a workspace that was sourced:
    ``colcon test`` runs the sources, and not what was built from them. Raises InputError when it
    is in none of them.
    """
    package = Path(__file__).resolve().parent
    candidates = [up / 'lib' / 'flexx2_sim_ros' / name for up in package.parents]
    candidates.append(Path(sys.executable).parent / name)
    sourced = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    candidates += [Path(prefix, 'lib/flexx2_sim_ros', name) for prefix in sourced if prefix]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise InputError(
        f'{name}: must be an installed executable, got none near {package} or '
        f'{sys.executable}. Reinstall the package.'
    )
