"""The paper's campaign: which conditions, and their recordings from the simulated camera."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from flexx2_sim_ros.atomic import output_folder
from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.characterize.conditions import Condition, LEAST_PERCENT
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.npz_arrays import open_npz
from flexx2_sim_ros.physics.geometry import centred, Reprojection
from flexx2_sim_ros.processes import in_processes
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Mode, Profile
from flexx2_sim_ros.recording import open_recording, RecordingReader, RecordingWriter
import numpy as np

ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0)  # degrees, as in the paper
FRAMES = 300  # a condition, as in the paper
# The paper does not list its distances. By the mode's range, metres (design).
DISTANCES = {
    2.4: (0.3, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0),
    7.0: (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0),
}
_BOARD = 0.1, 10.0  # metres: where a board of 1.2 m is neither beyond the image nor a few pixels
_CHUNK = 30


def conditions(
    profile: Profile,
    usecases: Sequence[str] | None = None,
    distances: Sequence[float] | None = None,
    angles: Sequence[float] = ANGLES,
    percents: Sequence[float | None] = (None,),
) -> list[Condition]:
    """
    List a campaign's conditions in the order in which a person would set them up.

    That is board by board, all modes of one set-up together.

    Parameters
    ----------
    profile : Profile
        The camera.
    usecases : sequence of str, optional
        Modes; those whose noise was measured (all, if none was) when left out.
    distances : sequence of float, optional
        Metres; up to eight that suit each mode's range when left out.
    angles : sequence of float
        Degrees.
    percents : sequence of float or None
        Reflectivities of the boards; None: one white board.

    Raises
    ------
    InputError
        For an unknown mode, a distance outside a mode's range, an angle beyond 80 degrees, a
        reflectivity outside 1 to 100 %, or a range without a whole centimetre.

    """
    modes = (
        [mode for mode in profile.modes if mode.measured] or list(profile.modes)
        if usecases is None
        else [profile.mode(usecase) for usecase in usecases]
    )
    for angle in angles:
        if not 0 <= angle <= 80:
            raise InputError(f'--angles: must be 0 to 80 degrees, got {angle:g}')
    for percent in percents:
        if percent is not None and not LEAST_PERCENT <= percent <= 100:
            raise InputError(
                f'--reflectivities: must be {LEAST_PERCENT} to 100 %, got {percent:g}'
            )
    found = []
    for mode in modes:
        for asked in distances or _distances(mode):
            # To the centimetre, as by tape and in the recordings' names.
            distance = round(float(asked), 2)
            if not mode.range_min <= distance <= mode.range_max:
                raise InputError(
                    f'--distances: must be {mode.range_min:g} to {mode.range_max:g} m, the '
                    f'range of {mode.name}, to the centimetre, got {asked:g}'
                )
            found += [
                Condition(mode.name, distance, float(angle), percent)
                for angle in angles
                for percent in percents
            ]
    order = {mode.name: number for number, mode in enumerate(modes)}
    return sorted(
        set(found), key=lambda c: (c.distance, c.angle_deg, -c.reflectivity, order[c.usecase])
    )


def _distances(mode: Mode) -> tuple[float, ...]:
    near, far = mode.range_min, mode.range_max
    if near < _BOARD[1] and far > _BOARD[0]:
        near, far = max(near, _BOARD[0]), min(far, _BOARD[1])
    listed = DISTANCES.get(mode.range_max, ())
    if listed and 1.5 * near <= listed[0]:
        return listed
    # Off the range's ends, where noise is cut off, but no further in than a quarter of it.
    quarter = (far - near) / 4
    first = min(max(0.3, 1.5 * near), near + quarter)
    last = max(0.8 * far, far - quarter)
    spread = np.geomspace(first, last, 8).round(2).tolist()
    inside = tuple(distance for distance in spread if near <= distance <= far)
    if not inside:
        raise InputError(
            f'range_m of {mode.name}: must hold a whole centimetre, to which boards are placed, '
            f'got {mode.range_min:g} to {mode.range_max:g}'
        )
    return inside


@dataclass(frozen=True)
class _Task:
    path: Path
    condition: Condition
    profile: Profile
    clean: np.ndarray
    frames: int
    seed: int


def capture(
    folder: Path,
    wanted: Sequence[Condition],
    profile: Profile,
    *,
    frames: int = FRAMES,
    seed: int = 0,
    renderer: str = 'auto',
    workers: int = 1,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[tuple[Path, bool]]:
    """
    Record a campaign with the simulated camera.

    The scene `board` is rendered by MuJoCo once a set-up. An interrupted capture resumes:
    recordings that are there already are read, and kept if they are whole and what this capture
    would record. Others are recorded again.

    Parameters
    ----------
    folder : pathlib.Path
        Where the recordings go; made if it is not there.
    wanted : sequence of Condition
        From `conditions`.
    profile : Profile
        The camera.
    frames, seed : int
        Frames a condition; seed of the noise.
    renderer : str
        ``egl``, ``osmesa``, ``ray`` or ``auto``.
    workers : int
        Processes.
    say : callable
        Takes a sentence for each recording that is there and is recorded again: why.

    Yields
    ------
    tuple of pathlib.Path and bool
        Each recording as it is done, and whether it was recorded now.

    Raises
    ------
    InputError
        When a file is there that no capture made (it is not overwritten), the folder cannot
        be written, or a board would be nearer than 0.1 m or farther than 10 m.

    """
    if frames < 1:
        raise InputError(f'--frames: must be at least 1, got {frames}')
    output_folder(folder)
    scenes = _render(
        sorted({(c.distance, c.angle_deg) for c in wanted}), profile.intrinsics, renderer
    )
    tasks = []
    for condition in wanted:
        task = _Task(
            folder / f'{condition.name}.npz',
            condition,
            profile,
            scenes[condition.distance, condition.angle_deg],
            frames,
            seed,
        )
        reason = _why_not_recorded(task)
        if reason is None:
            yield task.path, False
            continue
        if reason:
            say(f'{task.path}: {reason}: recorded again')
        tasks.append(task)
    for path in in_processes(_record, tasks, workers):
        if isinstance(path, BaseException):
            raise path
        yield path, True


def _render(
    setups: Sequence[tuple[float, float]], camera: Intrinsics, renderer: str
) -> dict[tuple[float, float], np.ndarray]:
    # Imported here: planning and fitting need no MuJoCo.
    from flexx2_sim_ros.rendering.pinholes import board_model
    from flexx2_sim_ros.rendering.renderer import open_renderer
    from flexx2_sim_ros.rendering.scenes import BOARD_DISTANCES, place_board
    import mujoco

    near, far = BOARD_DISTANCES
    for distance, _ in setups:
        if not near <= distance <= far:
            raise InputError(
                f'--distances: must be {near:g} to {far:g} m, where the simulated board can be, '
                f'got {distance:g}'
            )
    source, name = centred(camera), 'camera'
    model = board_model(source, name)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = Reprojection(camera, source)
    eye = open_renderer(model, source, renderer)
    try:
        scenes = {}
        for distance, angle in setups:
            place_board(model, data, name, distance, angle)
            clean = view.depth(eye.render(data, name)[0])
            scenes[distance, angle] = np.where(view.outside, np.float32(np.nan), clean)
        return scenes
    finally:
        eye.close()


def _why_not_recorded(task: _Task) -> str | None:
    """Say why a recording has to be made: None if it is there, empty where there is no file."""
    if not task.path.exists():
        return ''
    try:
        # The keys of a file that is whole, also of one that is no recording.
        with open_npz(task.path) as archive:
            ours = 'seed' in archive.headers
        if not ours:
            raise _NotOursError(
                f'{task.path}: seed: not in the file: it is no recording of the simulated camera '
                'and is not overwritten; choose another folder'
            )
        return _difference(open_recording(task.path), task)
    except _NotOursError:
        raise
    except InputError as error:
        return f'damaged or half-written ({error})'


class _NotOursError(InputError):
    """A recording that somebody else made."""


def _difference(reader: RecordingReader, task: _Task) -> str | None:
    # The first frame shows whether the camera was the same, and reading all of them whether the
    # file is whole: checksums are verified on the way.
    camera = _camera(task)
    stamps = camera.mode.stamps(task.frames)
    wanted = {
        'usecase': np.array(camera.usecase),
        'seed': np.array(task.seed),
        'K': task.profile.intrinsics.matrix,
        'clean_depth': task.clean,
        'stamp': stamps,
        'distortion': np.array(task.profile.intrinsics.distortion),
    }
    if reader.shape != (task.frames, *task.clean.shape):
        return f'shape: must be {(task.frames, *task.clean.shape)}, got {reader.shape}'
    for key, value in wanted.items():
        found = reader.arrays.get(key)
        if found is None or not np.array_equal(found, value, equal_nan=value.dtype.kind == 'f'):
            return f'{key}: differs from what this capture records'
    first = camera.capture(task.clean, wanted['K'], stamps[:1], _board(task)).depth[0]
    for index, frame in enumerate(reader.frames('depth')):
        if index == 0 and not np.array_equal(frame, first, equal_nan=True):
            return 'depth: differs from what this camera profile gives'
    return None


def _camera(task: _Task) -> Camera:
    return Camera(
        task.condition.usecase, profile=task.profile, seed=task.seed, name=task.condition.name
    )


def _board(task: _Task) -> np.ndarray | None:
    # The whole scene has the board's reflectivity.
    if task.condition.percent is None:
        return None
    return np.full(task.clean.shape, task.condition.reflectivity, np.float32)


def _record(task: _Task) -> Path:
    camera = _camera(task)
    stamps = camera.mode.stamps(task.frames)
    matrix, board = task.profile.intrinsics.matrix, _board(task)
    with RecordingWriter(task.path, task.frames, *task.clean.shape) as writer:
        for start in range(0, task.frames, _CHUNK):
            frame = camera.capture(task.clean, matrix, stamps[start : start + _CHUNK], board)
            writer.add_depth(frame.depth)
        for key, value in {
            'clean_depth': task.clean,
            'K': matrix,
            'stamp': stamps,
            'usecase': camera.usecase,
            'seed': task.seed,
            'distortion': np.array(task.profile.intrinsics.distortion),
        }.items():
            writer.add_array(key, value)
    return task.path
