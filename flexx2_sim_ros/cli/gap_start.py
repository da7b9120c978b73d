"""`flexx2 gap start`: the road from recordings to a diagnosis, with questions."""

import argparse
from pathlib import Path
import shlex
import subprocess
import sys

from flexx2_sim_ros.cli import common
from flexx2_sim_ros.errors import InputError, shown, shown_path

_TRUTHS = """\
/ --planes FILE: walls or boards whose distance you measure with a tape
/ --board FILE: a printed board that the gray images show
/ --scan FILE: a scan of the room, a triangle mesh
/ --scene FILE: a MuJoCo model of the room
/ --none: the recordings have their ground truth (clean_depth)
"""
_KINDS = {
    row.split()[1].strip('-:'): row.partition(': ')[2] for row in _TRUTHS.strip().split('\n')
}
OPTIONS = f"""
Go from recordings to a diagnosis, for the first time. Asks for what no option says, prints the
commands that it runs, and runs them. Without a terminal, answers are read line by line from
standard input; an empty line takes the default.

recordings RECORDINGS: folder of recordings or of PNG images, or a LeRobot data set
--options TEXT: more options of flexx2 gap truth, as "--trajectory poses.txt --clock-offset 0"
--out
--profile
{_TRUTHS}
example: flexx2 gap start recordings/ --planes planes.yaml
"""
VALUES = {
    'recordings': {'nargs': '?'},
    'options': '',
    'out': {'required': False, 'default': 'gap'},
    'profile': {'default': None},
    'none': {'action': 'store_const', 'const': ''},
}


def run(arguments: argparse.Namespace) -> int:
    """Ask, and run the commands until one fails."""
    from flexx2_sim_ros.profiles.files import find_profile, shipped
    from flexx2_sim_ros.recording.image_folders import views
    from flexx2_sim_ros.recording.lerobot import is_dataset

    try:
        more = shlex.split(arguments.options)
    except ValueError as error:
        raise InputError(f'--options: must be options, got {shown(arguments.options)}') from error
    given = arguments.recordings or _ask('Where are the recordings (folder)?')
    recordings, out = Path(given), Path(arguments.out)
    if not recordings.exists():
        raise InputError(f'RECORDINGS: must be a folder, got {shown_path(recordings)}')
    name = arguments.profile
    if name is None:
        name = _ask(f'Which camera ({", ".join(shipped())}, or a file)?', shipped()[0])
    profile = find_profile(name)
    camera = ['--profile', name] if name else []
    dataset = is_dataset(recordings)
    if dataset or views(recordings):
        mode = _ask(f'Which mode ({", ".join(profile.names)})?', profile.default_usecase)
        converted = out / 'recordings'
        words = ['convert', str(recordings), str(converted), '--views', '--usecase', mode]
        lens = _lens() if dataset else []
        if status := _run([*words, *lens, *camera]):
            return status
        recordings = converted
    kind, file = _truth(arguments, recordings, out)
    campaign = recordings
    if kind != 'none':
        if kind == 'planes' and not file.exists():
            return _write_form(file, recordings)
        campaign = out / 'campaign'
        words = ['gap', 'truth', str(recordings), f'--{kind}', str(file), '--out', str(campaign)]
        if status := _run([*words, *camera, *more]):
            return status
    return _run(['gap', 'diagnose', str(campaign), '--out', str(out / 'diagnosis'), *camera])


def _lens() -> list[str]:
    words = _ask('Which lens (FX FY CX CY in pixels, or a calibration file)?').split()
    return ['--intrinsics', *words] if len(words) == 4 else ['--calibration', ' '.join(words)]


def _truth(arguments: argparse.Namespace, recordings: Path, out: Path) -> tuple[str, Path]:
    from flexx2_sim_ros.truth.files import has_truth, recordings_of

    for kind in _KINDS:
        if (file := getattr(arguments, kind)) is not None:
            return kind, Path(file)
    known = '\n'.join(f'  {kind:7}{text}' for kind, text in _KINDS.items())
    usual = 'none' if any(map(has_truth, recordings_of([recordings]))) else 'planes'
    kind = _ask(f'What do you know of the room?\n{known}\n', usual)
    if kind not in _KINDS:
        raise InputError(f'ground truth: must be one of {", ".join(_KINDS)}, got {shown(kind)}')
    if kind == 'none':
        return kind, Path()
    form = str(out / 'planes.yaml') if kind == 'planes' else ''
    return kind, Path(_ask('Where is the file?', form))


def _write_form(file: Path, recordings: Path) -> int:
    from flexx2_sim_ros import atomic
    from flexx2_sim_ros.truth.files import names_of, recordings_of
    from flexx2_sim_ros.truth.plane_file import plane_form

    names = names_of(recordings_of([recordings]))
    atomic.output_folder(file.parent)
    atomic.write_text(file, plane_form({Path(name).stem: {'plane 1': ''} for name in names}))
    common.messages().print(f'{file}: fill in what you measured, and run this command again')
    return 0


def _ask(question: str, default: str = '') -> str:
    # Answers come from a terminal or from a pipe.
    print(f'{question} {f"[{default}] " if default else ""}', end='', file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip() or default
    if not answer:
        raise InputError(f'answer: must not be empty: {question.splitlines()[0]}')
    return answer


def _run(words: list[str]) -> int:
    print(f'$ {shlex.join(["flexx2", *words])}', file=sys.stderr, flush=True)
    done = subprocess.run([sys.executable, '-m', 'flexx2_sim_ros.cli.main', *words], check=False)
    return done.returncode
