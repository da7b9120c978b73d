"""The paper's campaign: which conditions, and their recordings from the simulated camera."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import math
from pathlib import Path

from flexx2_sim_ros.camera.geometry import pixel_rays, View
from flexx2_sim_ros.camera.intrinsics import Intrinsics
from flexx2_sim_ros.camera.modes import Mode, Profile
from flexx2_sim_ros.camera.pipeline import Camera
from flexx2_sim_ros.characterize.conditions import Condition
from flexx2_sim_ros.characterize.workers import in_processes
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording, RecordingWriter
import numpy as np

ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0)  # degrees, as in the paper
FRAMES = 300                            # a condition, as in the paper
# The paper does not list its distances. By the mode's range, metres (design).
DISTANCES = {2.4: (0.3, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0),
             7.0: (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)}
_CHUNK = 30


def conditions(profile: Profile, usecases: Sequence[str] | None = None,
               distances: Sequence[float] | None = None,
               angles: Sequence[float] = ANGLES) -> list[Condition]:
    """
    List a campaign's conditions in the order in which a person would set them up.

    Parameters
    ----------
    profile : Profile
        The camera.
    usecases : sequence of str, optional
        Modes; those whose noise was measured when left out.
    distances : sequence of float, optional
        Metres; eight that suit each mode's range when left out.
    angles : sequence of float
        Degrees.

    Returns
    -------
    list of Condition
        Board by board, all modes of one set-up together.

    Raises
    ------
    InputError
        For an unknown mode, a distance outside a mode's range or an angle beyond 80 degrees.

    """
    modes = ([mode for mode in profile.modes if mode.measured] if usecases is None
             else [profile.mode(usecase) for usecase in usecases])
    for angle in angles:
        if not 0 <= angle <= 80:
            raise InputError(f'--angles: found {angle:g}, wanted 0 to 80 degrees')
    found = []
    for mode in modes:
        for distance in distances or _distances(mode):
            if not mode.range_min <= distance <= mode.range_max:
                raise InputError(f'--distances: found {distance:g}, wanted {mode.range_min:g} to '
                                 f'{mode.range_max:g} m, the range of {mode.name}')
            # To the centimetre, as by tape and in the recordings' names.
            found += [Condition(mode.name, round(float(distance), 2), float(angle))
                      for angle in angles]
    order = {mode.name: number for number, mode in enumerate(modes)}
    return sorted(set(found), key=lambda c: (c.distance, c.angle_deg, order[c.usecase]))


def _distances(mode: Mode) -> tuple[float, ...]:
    spread = np.geomspace(max(0.3, 1.5 * mode.range_min), 0.8 * mode.range_max, 8)
    return DISTANCES.get(mode.range_max, tuple(spread.round(2)))


@dataclass(frozen=True)
class _Task:
    path: Path
    condition: Condition
    profile: Profile
    clean: np.ndarray
    frames: int
    seed: int


def capture(folder: Path, wanted: Sequence[Condition], profile: Profile, *,
            frames: int = FRAMES, seed: int = 0, renderer: str = 'auto',
            workers: int = 1) -> Iterator[tuple[Path, bool]]:
    """
    Record a campaign with the simulated camera.

    The scene `board` is rendered by MuJoCo once a set-up. Recordings that are there already and
    whole are kept, so that an interrupted capture goes on where it was.

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

    Yields
    ------
    tuple of pathlib.Path and bool
        Each recording as it is done, and whether it was recorded now.

    Raises
    ------
    InputError
        When the folder holds recordings of another campaign, or cannot be written.

    """
    if frames < 1:
        raise InputError(f'--frames: found {frames}, wanted at least 1')
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f'{folder}: cannot be made: {error}') from error
    scenes = _render(sorted({(c.distance, c.angle_deg) for c in wanted}), profile.intrinsics,
                     renderer)
    tasks = []
    for condition in wanted:
        task = _Task(folder / f'{condition.name}.npz', condition, profile,
                     scenes[condition.distance, condition.angle_deg], frames, seed)
        if _is_recorded(task):
            yield task.path, False
        else:
            tasks.append(task)
    for path in in_processes(_record, tasks, workers):
        if isinstance(path, BaseException):
            raise path
        yield path, True


def _render(setups: Sequence[tuple[float, float]], camera: Intrinsics,
            renderer: str) -> dict[tuple[float, float], np.ndarray]:
    # Imported here: planning and fitting need no MuJoCo.
    from flexx2_sim_ros.go1.model import build_model, load_mounts, stand
    from flexx2_sim_ros.go1.rendering import open_renderer
    from flexx2_sim_ros.go1.scenes import place_board
    import mujoco

    source = _centred(camera)
    mount = load_mounts()[0]
    model = build_model(scene='board', intrinsics=source, mounts=[mount])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    stand(model, data)
    view = View(camera, source)
    eye = open_renderer(model, source, renderer)
    try:
        scenes = {}
        for distance, angle in setups:
            place_board(model, data, mount.name, distance, angle)
            clean = view.depth(eye.render(data, mount.name)[0])
            scenes[distance, angle] = np.where(view.outside, np.float32(np.nan), clean)
        return scenes
    finally:
        eye.close()


def _centred(camera: Intrinsics) -> Intrinsics:
    """Return the plain pinhole to render for a camera: itself, or one that sees as much."""
    centre = (camera.width - 1) / 2, (camera.height - 1) / 2
    if (camera.cx, camera.cy) == centre and not any(camera.distortion):
        return camera
    reach = np.nanmax(np.abs(pixel_rays(camera)), axis=(1, 2))
    width, height = (2 * math.ceil(f * r + 2) for f, r in
                     zip((camera.fx, camera.fy), reach, strict=True))
    return Intrinsics(width, height, camera.fx, camera.fy, (width - 1) / 2, (height - 1) / 2)


def _is_recorded(task: _Task) -> bool:
    """Say whether a recording is there; it must be of this campaign."""
    if not task.path.exists():
        return False
    try:
        reader = open_recording(task.path)
    except InputError:
        return False
    found = {'frames': reader.shape[0], 'size': reader.shape[1:], 'usecase': reader.usecase,
             'seed': int(reader.arrays.get('seed', -1))}
    for name, value in {'frames': task.frames, 'size': task.clean.shape,
                        'usecase': task.condition.usecase, 'seed': task.seed}.items():
        if found[name] != value:
            raise InputError(f'{task.path}: {name}: found {found[name]}, wanted {value}: the '
                             'folder holds another campaign, choose another one')
    return True


def _record(task: _Task) -> Path:
    for left in task.path.parent.glob(f'.{task.path.name}.*'):
        left.unlink(missing_ok=True)  # of a capture that was killed
    camera = Camera(task.condition.usecase, profile=task.profile, seed=task.seed,
                    name=task.condition.name)
    # Whole nanoseconds, so that a frame's stamp does not depend on how it is computed.
    stamps = np.rint(np.arange(task.frames) * (1e9 / camera.mode.rate_hz)) / 1e9
    matrix = task.profile.intrinsics.matrix
    with RecordingWriter(task.path, task.frames, *task.clean.shape) as writer:
        for start in range(0, task.frames, _CHUNK):
            frame = camera.capture(task.clean, matrix, stamps[start:start + _CHUNK])
            writer.add_depth(frame.depth)
        for key, value in {'clean_depth': task.clean, 'K': matrix, 'stamp': stamps,
                           'usecase': camera.usecase, 'seed': task.seed,
                           'distortion': np.array(task.profile.intrinsics.distortion)}.items():
            writer.add_array(key, value)
    return task.path
