"""The conditions of a campaign, the names of its recordings, and its checklist for a person."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
import re

from flexx2_sim_ros.errors import InputError, shown_path
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording.opening import BAG_FILES

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

    Raises InputError when the name states a reflectivity that no board has.
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


_NODE = '/pmd_royale_ros_camera_node'  # of the real driver (pmd-royale-ros)
_INTRODUCTION = """\
# Measuring the noise of a {model}

{count} recordings of {frames} frames, {setups} set-ups of the board.

You need: the camera on a tripod, warm (switched on for 20 minutes), a tape, a protractor, and
{boards}, about 1.2 x 0.9 m, with its left and right edges upright. Daylight kept
out, nothing else near the board, and a wall or a screen behind it, at least 0.5 m away and within
the mode's range, so that its edges are seen.

For every set-up:
1. Put the board's middle in the middle of the image, at the distance given, measured along the
   optical axis from the camera's front (to 1 cm).
2. Turn it about the vertical by the angle given; 0 degrees faces the camera.
3. Leave the room to itself, switch the mode, record, next mode. Each recording has the name
   given, all in one folder. With the driver of the Flexx2, pmd-royale-ros:

       ros2 param set {node} usecase {usecase}
       ros2 bag record -s mcap -o {name} \\
         {node}/depth_image_0 \\
         {node}/camera_info \\
         {node}/gray_image_0

   {seconds} s or more give {frames} frames. `{node}` is what pmd-royale-ros
   calls itself; `ros2 node list` says what yours is called. With another camera, record with its
   own driver or SDK, and convert each recording:

       flexx2 convert RECORDING FOLDER/{name}.npz --usecase {usecase}

Then: `flexx2 characterize fit FOLDER`
"""


def checklist(wanted: Sequence[Condition], profile: Profile, frames: int) -> str:
    """
    Return the checklist, in Markdown, of at least one condition, from `capture.conditions`.

    Raises InputError for no frames.
    """
    if frames < 1:
        raise InputError(f'--frames: must be at least 1, got {frames}')
    slowest = min(profile.mode(condition.usecase).rate_hz for condition in wanted)
    setups = [
        (place, list(same))
        for place, same in groupby(wanted, key=lambda c: (c.distance, c.angle_deg, c.percent))
    ]
    lines = [
        _INTRODUCTION.format(
            model=profile.model,
            count=len(wanted),
            frames=frames,
            setups=len(setups),
            usecase=wanted[0].usecase,
            name=wanted[0].name,
            boards=_boards(wanted),
            node=_NODE,
            seconds=round(frames / slowest + 1),
        )
    ]
    for (distance, angle, percent), same in setups:
        board = '' if percent is None else f', board of {percent:g} %'
        lines.append(f'\n## {distance:g} m, {angle:g} degrees{board}\n\n')
        lines += [f'- [ ] `{condition.name}`\n' for condition in same]
    return ''.join(lines)


def _boards(wanted: Sequence[Condition]) -> str:
    percents = sorted({c.percent for c in wanted if c.percent is not None}, reverse=True)
    if not percents:
        return 'a white, matt, flat board'
    return (
        f'a matt, flat board of each reflectivity ({", ".join(f"{p:g} %" for p in percents)} at '
        "the camera's wavelength, by the board's data sheet)"
    )
