"""The conditions of a campaign, and how its recordings are called."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import re

from flexx2_sim_ros.errors import InputError

_NAME = re.compile(r'(?P<usecase>.+?)_(?P<distance>\d+(?:\.\d+)?)m_(?P<angle>\d+(?:\.\d+)?)deg')
_BAGS = ('.mcap', '.db3')


@dataclass(frozen=True, order=True)
class Condition:
    """
    One set-up of camera and board.

    Attributes
    ----------
    usecase : str
        The camera's mode.
    distance : float
        From the camera to the board along the optical axis, by tape, metres.
    angle_deg : float
        Between the optical axis and the board's normal.

    """

    usecase: str
    distance: float
    angle_deg: float

    @property
    def name(self) -> str:
        """Return the recording's name, e.g. ``Mode_9_30fps_1.00m_15deg``."""
        return f'{self.usecase}_{self.distance:.2f}m_{self.angle_deg:g}deg'


def parse_name(path: Path) -> Condition | None:
    """Return the condition that a recording's name states, None where it states none."""
    match = _NAME.fullmatch(path.stem if path.suffix in ('.npz', *_BAGS) else path.name)
    if match is None:
        return None
    return Condition(match['usecase'], float(match['distance']), float(match['angle']))


def find_recordings(folder: Path) -> list[Path]:
    """
    List the recordings in a folder.

    Parameters
    ----------
    folder : pathlib.Path
        With ``.npz`` files and bags (folders, ``.mcap`` or ``.db3`` files).

    Returns
    -------
    list of pathlib.Path
        In the order of their names; at least one.

    Raises
    ------
    InputError
        When there is no such folder or no recording in it.

    """
    if not folder.is_dir():
        raise InputError(f'{folder}: not a folder, wanted one with recordings')
    found = sorted(_candidates(folder))
    if not found:
        raise InputError(f'{folder}: no recording in it, wanted .npz files or bags')
    return found


def _candidates(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        bag = path.is_dir() and any(file.suffix in _BAGS or file.name == 'metadata.yaml'
                                    for file in path.iterdir())
        if not path.name.startswith('.') and (bag or path.suffix in ('.npz', *_BAGS)):
            yield path
