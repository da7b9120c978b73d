"""The conditions of a campaign, and how its recordings are called."""

from dataclasses import dataclass
from pathlib import Path
import re

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.recording.folders import BAG_FILES

LEAST_PERCENT = 1  # of a board's reflectivity
_NAME = re.compile(
    r'(?P<usecase>.+?)_(?P<distance>\d+(?:\.\d+)?)m_(?P<angle>\d+(?:\.\d+)?)deg'
    r'(?:_(?P<percent>\d+(?:\.\d+)?)pct)?'
)


@dataclass(frozen=True)
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
    percent : float or None
        The board's reflectivity at the camera's wavelength; None: not stated.

    """

    usecase: str
    distance: float
    angle_deg: float
    percent: float | None = None

    @property
    def name(self) -> str:
        """Return the recording's name, e.g. ``Mode_9_30fps_1.00m_15deg_50pct``."""
        board = '' if self.percent is None else f'_{self.percent:g}pct'
        return f'{self.usecase}_{self.distance:.2f}m_{self.angle_deg:g}deg{board}'

    @property
    def reflectivity(self) -> float:
        """Return the board's reflectivity, 0..1; 1 where it is not stated."""
        return 1.0 if self.percent is None else self.percent / 100


def parse_name(path: Path) -> Condition | None:
    """
    Return the condition that a recording's name states, None where it states none.

    Raises
    ------
    InputError
        When the name states a reflectivity that no board has.

    """
    match = _NAME.fullmatch(path.stem if path.suffix in ('.npz', *BAG_FILES) else path.name)
    if match is None:
        return None
    percent = None if match['percent'] is None else float(match['percent'])
    if percent is not None and not LEAST_PERCENT <= percent <= 100:
        raise InputError(
            f'{shown_path(path)}: reflectivity: must be {LEAST_PERCENT} to 100 pct in the name, '
            f'got {percent:g}'
        )
    return Condition(match['usecase'], float(match['distance']), float(match['angle']), percent)
