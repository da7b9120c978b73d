"""`flexx2 characterize`: the paper's measurement, on the simulated camera or on a real one."""

import argparse
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import check_folder, output_folder
from flexx2_sim_ros.cli.common import call, messages, progress_bar
from flexx2_sim_ros.cli.options import MOST_FRAMES, number, SEEDS, Step, whole_number
from flexx2_sim_ros.errors import printable
from flexx2_sim_ros.profiles.files import find_profile, save_profile
from flexx2_sim_ros.profiles.modes import Profile

_BACKENDS = ('auto', 'egl', 'osmesa', 'ray')
_OUT = 'characterization'


OPTIONS = """
Measure noise as the paper did: record a flat board at several distances and angles (plan, or
capture with the simulated camera), then fit the noise model (fit). The results are a report and a
camera profile.

example: flexx2 characterize fit campaign --out result
"""
_CONDITIONS = """\
--usecase MODE: a mode; may be repeated (default: the modes whose noise was measured)
--distances M: distances of the board, metres, to the centimetre (default: up to eight that suit
    each mode's range)
--angles DEG: angles of the board, degrees (default: 0 15 30 45 60)
--reflectivities %: the boards' reflectivities at the camera's wavelength, percent; three or more
    tell how noise depends on reflectivity (default: one white board)
--frames FRAMES: frames in each recording (default %(default)s)
--profile
"""
_OF_CONDITIONS = {
    'usecase': {'action': 'append'},
    'distances': {'type': number(0, 1e3, above=True), 'nargs': '+'},
    'angles': {'type': number(0, 80), 'nargs': '+', 'default': [0.0, 15.0, 30.0, 45.0, 60.0]},
    'reflectivities': {'type': number(1, 100), 'nargs': '+', 'default': [None]},
    'frames': {'type': whole_number(1, MOST_FRAMES), 'default': 300},
}
_PLAN = f"""
Print the campaign as a checklist (Markdown) for a person with a camera, a tape and a board. It
says what to call each recording.

{_CONDITIONS}
example: flexx2 characterize plan --usecase Mode_9_30fps > checklist.md
"""
_CAPTURE = f"""
Record the campaign with the simulated camera in the scene `board`: one .npz file for each mode,
distance and angle (46 MB for 300 frames of 224 x 172). Resumes after an interruption.

folder FOLDER: folder for the recordings
{_CONDITIONS}--seed SEED: seed of the noise (default 0)
--renderer: how the board is rendered (default %(default)s)
--jobs

example: flexx2 characterize capture campaign --frames 300
"""
_OF_CAPTURE = {
    **_OF_CONDITIONS,
    'folder': Path,
    'seed': {'type': whole_number(*SEEDS), 'default': 0},
    'renderer': {'choices': _BACKENDS, 'default': 'auto', 'action': 'store'},
}
_FIT = f"""
Analyse a folder of recordings (.npz or bags) of one camera that looks at a flat board. Writes
report.html, figures and profile.yaml. Recordings called MODE_DISTANCEm_ANGLEdeg are checked
against their names; _PERCENTpct at the end is the board's reflectivity.

folder FOLDER: folder of recordings
--out DIR: folder for the results (default: FOLDER/{_OUT})
--box X0 Y0 X1 Y1: region of the board in each image, pixels (default: detected)
--camera NAME: which camera, if bags have several
--model NAME: the camera's name in the profile
--profile
--jobs

example: flexx2 characterize fit campaign --out result
"""
_OF_FIT = {'folder': Path, 'out': Path, 'box': whole_number(0, 1_000_000)}


def _conditions(arguments: argparse.Namespace) -> tuple[Profile, list[Any]]:
    from flexx2_sim_ros.characterize.capture import conditions

    profile = find_profile(arguments.profile)
    wanted = conditions(
        profile, arguments.usecase, arguments.distances, arguments.angles, arguments.reflectivities
    )
    return profile, wanted


def _plan(arguments: argparse.Namespace) -> int:
    from flexx2_sim_ros.characterize.conditions import checklist

    profile, wanted = _conditions(arguments)
    print(checklist(wanted, profile, arguments.frames), end='')
    return 0


def _capture(arguments: argparse.Namespace) -> int:
    from flexx2_sim_ros.characterize.capture import capture

    profile, wanted = _conditions(arguments)
    console = messages()
    recorded = 0
    with progress_bar(console) as progress:
        made = call(
            capture,
            arguments,
            wanted=wanted,
            profile=profile,
            workers=arguments.jobs,
            say=lambda text: console.print(printable(text), style='yellow', soft_wrap=True),
        )
        for done, (_, new) in enumerate(made, 1):
            recorded += new
            progress(f'recorded {done} of {len(wanted)}', done / len(wanted))
    kept = len(wanted) - recorded
    console.print(
        f'{arguments.folder}: {recorded} recordings of {arguments.frames} frames'
        + (f', {kept} were there already' if kept else '')
    )
    return 0


def _fit(arguments: argparse.Namespace) -> int:
    # Imported here: SciPy and scikit-learn take a second, which other commands should not wait.
    from flexx2_sim_ros.characterize.analysis import characterize
    from flexx2_sim_ros.characterize.new_profile import to_profile
    from flexx2_sim_ros.characterize.noise_report import write_report
    from flexx2_sim_ros.cli.characterize_table import print_result

    out = arguments.out or arguments.folder / _OUT
    check_folder(out)
    console = messages()
    with progress_bar(console) as progress:
        result = call(
            characterize,
            arguments,
            workers=arguments.jobs,
            on_done=lambda done, total: progress(f'measured {done} of {total}', done / total),
        )
    profile = to_profile(result, arguments.model)
    output_folder(out)
    page = write_report(result, profile, out, arguments.camera)
    save_profile(out / 'profile.yaml', profile)
    print_result(result)
    for reason in result.left_out:
        console.print(printable(f'left out: {reason}'), style='yellow', soft_wrap=True)
    console.print(f'{page}\n{out / "profile.yaml"}', soft_wrap=True)
    return 0


STEPS = {
    'plan': Step('print the campaign as a checklist', _PLAN, _plan, _OF_CONDITIONS),
    'capture': Step(
        'record the campaign with the simulated camera', _CAPTURE, _capture, _OF_CAPTURE
    ),
    'fit': Step('analyse recordings: report and camera profile', _FIT, _fit, _OF_FIT),
}
