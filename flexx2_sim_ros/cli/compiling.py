"""`flexx2 compile`: compile the camera ahead of its first start."""

import argparse
from dataclasses import replace
from pathlib import Path
import tempfile
import time

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.compiling import compiling_said, warm_up
from flexx2_sim_ros.cli.common import messages, progress_bar
from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.physics.frame_state import why_no_phases
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import Profile

_EFFECTS = 0.3  # of the time
_SCALE, _FRAMES = 0.2, 6  # of the recordings of a diagnosis
OPTIONS = """
Compile the camera model, all effects and the diagnosis, so that a camera and flexx2 gap diagnose
start at once. The result is kept in the folder of the package, or in the cache folder of the user
if that is not writable (then each user runs this command once). Run it again after an update of
the package or of numba. Other commands have some compiled loops of their own. They are compiled
when these commands run for the first time.

--no-effects: leave out the effects and the diagnosis, which take most of the time
--profile

example: flexx2 compile
"""


def run(arguments: argparse.Namespace) -> int:
    """Compile, and print how long it took."""
    start = time.monotonic()
    compiled: list[bool] = []

    def say() -> None:
        compiled.append(True)
        print('compiling ...', flush=True)

    profile = find_profile(arguments.profile)
    camera = Camera(profile.default_usecase, profile=profile)
    chosen = () if arguments.no_effects else _that_apply(camera)
    with progress_bar(messages()) as progress, compiling_said(say):
        warm_up(camera, profile.intrinsics)
        for i, effect in enumerate(chosen):
            progress(f'compiling {effect.name}', _EFFECTS * i / len(chosen))
            own = Camera(camera.usecase, profile=profile, effects=[effect])
            warm_up(own, profile.intrinsics)
        if not arguments.no_effects:
            progress('compiling the diagnosis', _EFFECTS)
            _diagnose(profile, next(effect for effect in chosen if effect.typical))
    print(
        f'compiled in {time.monotonic() - start:.0f} s'
        if compiled
        else 'everything was compiled before'
    )
    return 0


def _that_apply(camera: Camera) -> list[Effect]:
    phases = not why_no_phases(camera.mode)
    return [kind() for kind in registry().values() if phases or not kind.needs_modulation]


def _diagnose(profile: Profile, effect: Effect) -> None:
    # A small diagnosis of one effect compiles what a large one does. Of the plan it needs a wall,
    # a shiny board, the edges of a box and a camera that moves.
    from flexx2_sim_ros.gap import diagnose
    from flexx2_sim_ros.gap.planning.plan import read_plan
    from flexx2_sim_ros.gap.planning.truths import KINDS, write_campaign

    plan = replace(read_plan(), usecase=profile.default_usecase)
    plan = replace(plan, recordings=plan.recordings[2::5], scale=_SCALE, frames=_FRAMES)
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(Path(folder), plan, profile, KINDS[0], {effect.name: {}})
        diagnose(folder, profile=profile)
