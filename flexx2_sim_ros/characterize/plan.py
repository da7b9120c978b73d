"""The campaign as a checklist for a person with a camera, a tape and a board."""

from collections.abc import Sequence
from itertools import groupby

from flexx2_sim_ros.characterize.conditions import Condition
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import Profile

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
    Return the checklist, in Markdown.

    Parameters
    ----------
    wanted : sequence of Condition
        From `campaign.conditions`, at least one.
    profile : Profile
        The camera.
    frames : int
        Frames a condition.

    Raises
    ------
    InputError
        For no frames.

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
