"""`flexx2 gap truth`: ground truth for recordings of a real camera."""

import argparse
from collections.abc import Iterator
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.errors import each_once, InputError, shown

# Options and those that they are given with: where the camera is, how poses were measured, and how
# accurate the room and the lens are.
_TOLD = 'trajectory', 'odometry', 'tf'
_MEASURED = 'camera_in_body', 'clock_offset', 'relative', 'pose_accuracy'
_ONLY_WITH = (
    (('pose', 'up', *_TOLD, *_MEASURED), ('scan', 'scene')),
    (_MEASURED, _TOLD),
    (('room_error',), ('scan', 'scene', 'planes')),
    (('scale_error',), ('scan', 'scene')),
    (('lens_error', 'wall'), ('board',)),
)
_UPS = '+x', '-x', '+y', '-y', '+z', '-z'


def _seconds_or_auto(text: str) -> float | None:
    return None if text == 'auto' else number(-1e10, 1e10)(text)


OPTIONS = """
Register each RECORDING (.npz, a bag, or a folder of them) to a room, a printed board or planes,
and write it to DIR with clean_depth and its accuracy. Writes truth.yaml and truth.html as well. An
interrupted run resumes. See docs/truth.md.

recordings RECORDING: .npz file, bag, or folder of these
! --scan MESH: the room as a triangle mesh in metres: .ply, .obj, .glb or .stl
! --scene FILE: the room as a MuJoCo model: MJCF (.xml) or .urdf
! --board FILE: a printed board that the gray images show: target.yaml of flexx2 gap target, the
    file of a target of Kalibr, chessboard:9x6:0.03 (inner corners, metres),
    charuco:5x7:0.04:0.03:DICT_5X5_100, circles:7x6:0.03:0.015 or, with every second row shifted,
    acircles:4x11:0.02:0.015 (distance, diameter)
! --planes FILE: planes of the room, with distances and angles that were measured (planes.yaml)
--out
--pose X,Y,Z,QX,QY,QZ,QW: rough pose of the camera in the room in the first frame (optical frame,
    metres), within 0.3 m and 20 degrees; once for all recordings or once for each (default:
    searched in the whole room). If the first number is negative, write --pose=-1,...
/ --trajectory FILE: rough poses with stamps, as of motion capture: text (lines t x y z qx qy qz
    qw, TUM) or .csv with these columns; seconds, metres, in the room. A .csv that also has the
    columns sx sy sz (metres) srx sry srz (radians) says how accurate they are, as --pose-accuracy
    does. A folder has a file for each recording, of the same name
/ --odometry TOPIC: rough poses from the bags: nav_msgs/Odometry, or geometry_msgs/PoseStamped or
    PoseWithCovarianceStamped
/ --tf PARENT,CHILD: rough poses from the bags' TF: the room's frame and the body's
--camera-in-body X,Y,Z,QX,QY,QZ,QW: pose of the camera (optical frame) in the frame of the tracked
    body (default: the poses are those of the camera)
--pose-accuracy METRES,DEGREES: standard deviations of these poses, such as 0.002,0.2 of motion
    capture: they are used as they are, and not fitted (default: they are rough, unless their .csv
    says it). recorded: the covariances of the messages of --odometry. Needs --clock-offset
--clock-offset SECONDS: how far the clock of the recording is ahead of that of these poses; 0 for
    one clock. What the motion shows beyond it is the latency of the images (default: auto, found
    from the motion, latency included)
--relative: use only the motions, because the poses are in another frame than the room, as those of
    odometry
--up AXIS: the room's axis that points up, for finding poses: +z, or +y for .glb (default)
--camera NAME: the camera of a bag that has several
--profile
--motion auto|still|moving: whether the camera moved (default: auto, detected)
--room-error METRES: standard deviation of the room's surfaces; depth errors below twice this value
    are no gap (default: how far recordings and room differ where surfaces are smooth, 0.001 to
    0.003; 0 with --planes)
--scale-error FRACTION: standard deviation of the room's scale, such as 0.001 where a length was
    measured (default: unknown)
--lens-error FRACTION: standard deviation of the focal length, with --board (default 0.003)
--wall: the sheet of --board is glued flat to a wall, the rest of which is known as well
--uptime SECONDS: time from power-on to the first frame of the earliest recording; the others
    follow from their stamps (default: counted from the earliest recording)
--jobs
--scheduler

example: flexx2 gap truth bags/ --scan room.ply --out campaign/
"""
VALUES = {
    'recordings': {'nargs': '+'},
    'pose': {'action': 'append', 'default': []},
    'clock_offset': _seconds_or_auto,
    'up': {'choices': _UPS},
    'motion': 'auto',
    'room_error': number(0, 1),
    'scale_error': number(0, 0.1),
    'lens_error': number(0, 0.1),
    'uptime': number(0, 1e6),
}


def run(arguments: argparse.Namespace) -> int:
    """Make ground truth with a progress bar, and print the verdicts."""
    from flexx2_sim_ros.truth import asked_for, make_truth

    request = _request(arguments)
    console = common.messages()
    if asked := asked_for(request):  # Before the work: it can still be measured.
        common.print_lines(console, [asked])
    with common.progress_bar(console) as progress:
        table = make_truth(request, progress)
    notes = [(row['source'], note) for row in table['recordings'] for note in row.get('notes', ())]
    common.print_lines(console, each_once(notes), 'yellow')
    common.print_lines(console, _lines(table, arguments.out))
    console.print(f'{arguments.out}: truth.yaml, truth.html')
    return 0


def _lines(table: dict[str, Any], out: str) -> Iterator[str]:
    for row in table['recordings']:
        reasons = f': {"; ".join(row["reasons"])}' if row['reasons'] else ''
        yield f'{row["name"]}: {row["verdict"]}{reasons}'
    for row in table['cannot_decide']:
        yield f'cannot decide {row["effect"]}: {row["reason"]}'
    if 'room_rough_mm' in table:
        yield _room_words(table)
    if clock := table.get('clock_offset'):
        yield _clock_words(clock)
    for name, found in table.get('shared', {}).items():
        if found['verdict'] == 'found':
            yield f'{name}: {found["reason"]}'
    for name in table.get('not_given', []):
        yield f'{table["planes"]}: {name} is not among the recordings, and is ignored'
    for name in table.get('not_of_this_run', []):
        yield (
            f'{name}: is in {out}, but not of this run; a diagnosis reads it, so '
            'remove it if you removed its recording'
        )


def _room_words(table: dict[str, Any]) -> str:
    error, rough = table['room_error_mm'], f'{table["room_rough_mm"]:.1f}'
    source = '' if table['room_error'] == 'given' else f' ({table["room_error"]})'
    apart = 'by no more than noise' if rough == '0.0' else f'by {rough} mm beyond noise'
    return (
        f'--room-error: {error:g} mm{source}, so that depth errors below {2 * error:g} mm do not '
        f'count as a gap; within flat patches, recordings and room differ {apart}'
    )


def _clock_words(clock: dict[str, Any]) -> str:
    if clock['verdict'] != 'found':
        return f'clock offset: not found: {clock["reason"]}'
    spread = clock['standard_deviation'] * 1e3
    words = f'clock offset: {clock["seconds"]:.4f} s, standard deviation {spread:.1f} ms'
    if 'latency' in clock:
        words += f'; images are late by {clock["latency"] * 1e3:.1f} ms'
    return words


def _request(arguments: argparse.Namespace) -> Any:
    from flexx2_sim_ros.truth import BoardRequest, PlaneRequest, RoomRequest

    for name in ('scan', 'scene', 'board', 'planes', *_TOLD):
        if getattr(arguments, name) == '':
            raise InputError(f"--{name}: must not be empty, got ''")
    if arguments.scan or arguments.scene:
        _check_suffix(Path(arguments.scan or arguments.scene), arguments.scan is not None)
    for names, others in _ONLY_WITH:
        _check_unused(arguments, names, others)
    own: dict[str, Any] = {
        'recordings': tuple(map(Path, arguments.recordings)),
        'out': Path(arguments.out),
        'command': common.command_line('gap', 'truth'),
    }
    if arguments.board:
        return common.call(BoardRequest, arguments, **own)
    if arguments.planes:
        return common.call(PlaneRequest, arguments, **own, planes=Path(arguments.planes))
    room = Path(arguments.scan or arguments.scene)
    return common.call(
        RoomRequest,
        arguments,
        **own,
        room=room,
        poses=tuple(_pose('--pose', text) for text in arguments.pose),
        told=_told(arguments),
        up=arguments.up or ('+y' if room.suffix.lower() == '.glb' else '+z'),
    )


def _check_unused(
    arguments: argparse.Namespace, names: tuple[str, ...], others: tuple[str, ...]
) -> None:
    if any(getattr(arguments, one) for one in others):
        return
    *first, last = (f'--{one}' for one in others)
    fitting = f'{", ".join(first)} or {last}' if first else last
    for name in names:
        value = getattr(arguments, name)
        # 0 is a value, but equals False.
        if not (value is None or value is False or value == []):
            option = f'--{name.replace("_", "-")}'
            raise InputError(f'{option}: must be given with {fitting} only')


def _told(arguments: argparse.Namespace) -> Any:
    from flexx2_sim_ros.truth import PoseSource

    if not any(getattr(arguments, name) for name in _TOLD):
        return None
    if arguments.pose and not arguments.relative:
        raise InputError(
            '--pose: must be given with --relative where there is --trajectory, --odometry or --tf'
        )
    frames = tuple(name.strip('/ ') for name in (arguments.tf or '').split(',') if name)
    if arguments.tf and len(frames) != 2:
        raise InputError(f'--tf: must be two frames, PARENT,CHILD, got {shown(arguments.tf)}')
    body, recorded = arguments.camera_in_body, arguments.pose_accuracy == 'recorded'
    if recorded and not arguments.odometry:
        raise InputError(
            '--pose-accuracy: must be METRES,DEGREES without --odometry, got recorded'
        )
    return PoseSource(
        Path(arguments.trajectory) if arguments.trajectory else None,
        arguments.odometry or '',
        frames,
        _pose('--camera-in-body', body) if body else PoseSource.camera_in_body,
        arguments.clock_offset,
        arguments.relative,
        None if recorded else _accuracy(arguments.pose_accuracy),
        recorded,
    )


def _accuracy(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    metres, degrees = _numbers(text, 2)
    if not (0 < metres < 1 and 0 < degrees < 90):
        raise InputError(
            f'--pose-accuracy: must be METRES,DEGREES, such as 0.002,0.2, got {shown(text)}'
        )
    return metres, degrees


def _check_suffix(room: Path, scan: bool) -> None:
    meshes = '.ply', '.obj', '.glb', '.stl'
    wanted = meshes if scan else ('.xml', '.mjcf', '.urdf')
    if room.suffix.lower() not in wanted:
        name = '--scan' if scan else '--scene'
        raise InputError(f'{name}: must be one of {", ".join(wanted)}, got {shown(room.name)}')


def _pose(option: str, text: str) -> tuple[float, ...]:
    numbers = _numbers(text, 7)
    if not all(abs(n) < 1e6 for n in numbers) or math.hypot(*numbers[3:]) < 1e-6:
        raise InputError(
            f'{option}: must be x,y,z,qx,qy,qz,qw: three metres and a quaternion, got '
            f'{shown(text)}'
        )
    return numbers


def _numbers(text: str, count: int) -> tuple[float, ...]:
    # So many numbers between commas; NaN for anything else.
    try:
        numbers = tuple(float(word) for word in text.split(','))
    except ValueError:
        numbers = ()
    return numbers if len(numbers) == count else (math.nan,) * count
