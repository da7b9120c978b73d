"""How often a walking robot fails with a diagnosed camera, by what is simulated of it."""

from collections.abc import Sequence
from pathlib import Path
import time
from typing import Any

from flexx2_sim_ros import __version__
from flexx2_sim_ros.atomic import as_json, check_outputs, output_folder, whole_files, write_text
from flexx2_sim_ros.camera import flexx2, Mode, Profile
from flexx2_sim_ros.effects.registry import for_reports
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.gap.data.given import given_effects, in_one_table, Table
from flexx2_sim_ros.gap.features.simulation import with_uptime
from flexx2_sim_ros.gap.features.work import Progress, stepper
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.report.reading import read_diagnosis
from flexx2_sim_ros.jobs import workers
from flexx2_sim_ros.limits import check_whole
from flexx2_sim_ros.physics.geometry import centred
from flexx2_sim_ros.robots.robot import DEFAULT_ROBOT, load_robot
from flexx2_sim_ros.walking import ExactCamera, SimulatedCamera
from flexx2_sim_ros.walking.cameras import WalkingCamera
from flexx2_sim_ros.walking.series import batches, draw_walks, rows, STEPS, walk_all
from flexx2_sim_ros.walking.walks import legs_of

SCHEMA = 1
FILES = 'walk.json', 'walk.png'
WALKS = 200
PERFECT, NOISE, DIAGNOSED = 'perfect depth', 'noise model', 'with diagnosed effects'
_MOST_WALKS = 100_000
_HIGHEST = 0.5  # the depth of the terrain's blocks, metres


def walk(
    diagnosis: str | Path,
    *,
    profile: Profile | None = None,
    robot: str = DEFAULT_ROBOT,
    walks: int = WALKS,
    steps: Sequence[float] = STEPS,
    seed: int = 0,
    jobs: int = 1,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """
    Let robots walk with perfect depth, with the noise model and with the diagnosed effects.

    Parameters
    ----------
    diagnosis : str or pathlib.Path
        A folder that `diagnose` has written.
    robot : str
        One of `robots.robot.robot_names`, or the path of a robot's file.
    walks : int
        For each terrain and step height.
    steps : sequence of float
        Step heights, metres.
    out : str or pathlib.Path, optional
        Folder to write ``walk.json`` and ``walk.png`` to.
    profile, seed, jobs, progress
        As for `diagnose`; the seed is that of the terrain, too.

    Returns
    -------
    dict
        The table that ``docs/robots.md`` describes.

    Raises
    ------
    InputError
        When an input cannot be used; then nothing is written.

    """
    began = time.monotonic()
    progress = progress or (lambda text, fraction: None)
    _check(robot, walks, steps, seed, jobs)
    if out is not None:
        check_outputs('--out', out, FILES)
    before = read_diagnosis(Path(diagnosis))
    diagnosed = table_of(before.effects_to_check())
    simulated = with_uptime(diagnosed, None)  # Walks have no time since power-on.
    kind = profile or flexx2()
    settings = before.table.get('settings', {})
    mode = kind.mode(str(settings.get('usecase', kind.default_usecase)))
    cameras = _cameras(before.known, simulated, mode, profile, seed)
    points = batches(walks, steps)
    lens = centred(kind.intrinsics)
    step = stepper(progress, 'walking', 0.0, 0.99, len(points))
    with workers(jobs, None) as mapped:
        found = walk_all(points, cameras, lens, mode, mapped, step, seed=seed, robot=robot)
    table: dict[str, Any] = {
        'schema': SCHEMA,
        'effects': for_reports(simulated),
        'left_out': [name for name in diagnosed if name not in simulated],
        'rows': rows(found),
        'settings': {
            'usecase': mode.name,
            'robot': load_robot(robot).name,
            'walks': walks,
            'steps': list(steps),
            'seed': seed,
        },
        'seconds': round(time.monotonic() - began, 2),
        'version': __version__,
    }
    if out is not None:
        with whole_files(output_folder(out)) as part:
            write_text(part / FILES[0], as_json(table))
            title = f'{walks} walks for each point, 95 % intervals'
            draw_walks(part / FILES[1], table['rows'], title)
    progress('done', 1.0)
    return table


def _cameras(
    known: Table, effects: Table, mode: Mode, profile: Profile | None, seed: int
) -> dict[str, WalkingCamera]:
    given = given_effects(with_uptime(table_of(given_effects(known)), None))
    tables = {NOISE: table_of(given), DIAGNOSED: in_one_table(given, effects)}
    return {
        PERFECT: ExactCamera(mode.range_max),
        **{name: SimulatedCamera(mode.name, profile, one, seed) for name, one in tables.items()},
    }


def _check(robot: str, walks: int, steps: Sequence[float], seed: int, jobs: int) -> None:
    check_whole('walks', walks, 1, _MOST_WALKS)
    check_whole('seed', seed, 0)
    check_whole('jobs', jobs, 1)
    if not steps or not all(0 <= step <= _HIGHEST for step in steps):
        raise InputError(f'steps: must be metres from 0 to {_HIGHEST:g}, got {shown(steps)}')
    if load_robot(robot).legs is None:
        raise InputError(f'robot: must have legs, got {shown(robot)}')
    legs_of(robot)
