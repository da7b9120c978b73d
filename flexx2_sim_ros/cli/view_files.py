"""The recordings that `flexx2 view` shows."""

from collections.abc import Sequence
from pathlib import Path

from flexx2_sim_ros.cli.common import messages
from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.errors import InputError, printable, shown, shown_path
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording import open_recording, recording_cameras
from flexx2_sim_ros.recording.opening import find_recordings, is_bag
from flexx2_sim_ros.view.recorded import RecordedCamera

# Of frames that stay in memory, for all recordings together.
_MOST_BYTES = 512 << 20


def open_files(
    path: Path, campaign: Path | None, cameras: Sequence[str], profile: str
) -> tuple[dict[str, list[RecordedCamera]], str]:
    """
    Open the recordings, or the diagnosis and its campaign, that `flexx2 view` names.

    Returned are the cameras of each recording, by its name (of bags only `cameras`, unless that is
    empty), and the verdict of the diagnosis. Recordings of a folder that cannot be read are left
    out with a warning. Raises InputError when nothing can be shown.
    """
    effects, verdict = None, ''
    if (path / 'diagnosis.json').is_file():
        if campaign is None:
            raise InputError(
                f'CAMPAIGN: must be the folder of the recordings that {shown_path(path)} is a '
                'diagnosis of, got none'
            )
        effects, verdict = _read_diagnosis(path)
        path = campaign
    elif campaign is not None:
        raise InputError(
            f'PATH: must be a diagnosis if there is a CAMPAIGN, got {shown_path(path)}'
        )
    found = _open_all(path, cameras, find_profile(profile), effects)
    return found, verdict


def _read_diagnosis(folder: Path) -> tuple[tuple[Effect, ...], str]:
    # Imported here: it takes seconds, which only a diagnosis needs.
    from flexx2_sim_ros.gap.report.reading import read_diagnosis
    from flexx2_sim_ros.gap.report.words import headline

    diagnosis = read_diagnosis(folder)
    try:
        verdict = headline(diagnosis.table)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            f'{shown_path(folder / "diagnosis.json")}: must be what flexx2 gap diagnose writes, '
            f'got a mistake at {shown(error)}'
        ) from error
    # Errors of poses belong to their recordings.
    return tuple(effect for effect in diagnosis.effects if effect.role != 'pose'), verdict


def _open_all(
    path: Path, cameras: Sequence[str], profile: Profile, effects: Sequence[Effect] | None
) -> dict[str, list[RecordedCamera]]:
    single = not path.is_dir() or is_bag(path)
    paths = [path] if single else find_recordings(path)
    most = _MOST_BYTES // len(paths)
    found: dict[str, list[RecordedCamera]] = {}
    problems = []
    for one in paths:
        try:
            found[one.name] = _open(one, cameras, profile, effects, most)
        except InputError as error:
            problems.append(printable(str(error)))
    if not found:
        raise InputError(problems[0])
    console = messages(soft_wrap=True)
    for problem in problems:
        console.print(f'left out: {problem}', style='yellow')
    return found


def _open(
    path: Path,
    cameras: Sequence[str],
    profile: Profile,
    effects: Sequence[Effect] | None,
    most_bytes: int,
) -> list[RecordedCamera]:
    names: list[str | None] = [*recording_cameras(path)] or [None]
    if cameras:
        wanted = {name.strip('/') for name in cameras}
        names = [name for name in names if name is None or name in wanted]
        if not names:
            raise InputError(f'{path}: must have a camera of --cameras, got others')
    return [
        RecordedCamera(
            open_recording(path, name, profile), profile, effects, most_bytes // len(names)
        )
        for name in names
    ]
