"""The conditions of a campaign, and how its recordings are called."""

from dataclasses import dataclass
from pathlib import Path
import re

from flexx2_sim_ros.recording.folders import BAG_FILES

_NAME = re.compile(r'(?P<usecase>.+?)_(?P<distance>\d+(?:\.\d+)?)m_(?P<angle>\d+(?:\.\d+)?)deg')


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
    match = _NAME.fullmatch(path.stem if path.suffix in ('.npz', *BAG_FILES) else path.name)
    if match is None:
        return None
    return Condition(match['usecase'], float(match['distance']), float(match['angle']))
