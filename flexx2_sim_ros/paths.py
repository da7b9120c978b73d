"""Where the package's data files (``config/``) are, in a checkout and in every kind of install."""

from functools import lru_cache
from pathlib import Path

from flexx2_sim_ros.errors import InputError

_MARKER = 'modes.yaml'


@lru_cache(maxsize=1)
def config_dir() -> Path:
    """
    Return the folder that holds the package's configuration files.

    In a checkout (or an editable or symlinked install) it is ``config/`` beside the package; in
    an installed one it is ``share/flexx2_sim_ros/config`` under the prefix, the place that
    ``colcon build``, Debian packages and ``pip install`` all put it.

    Returns
    -------
    pathlib.Path
        An existing folder.

    Raises
    ------
    InputError
        When the installation is incomplete and no such folder exists.

    """
    package = Path(__file__).resolve().parent
    candidates = [package.parent / 'config']
    candidates += [up / 'share' / 'flexx2_sim_ros' / 'config' for up in package.parents]
    for candidate in candidates:
        if (candidate / _MARKER).is_file():
            return candidate
    raise InputError(
        f'config folder: no {_MARKER} found near {package}; wanted config/ in a checkout or '
        'share/flexx2_sim_ros/config in an install. Reinstall the package.')
