"""`flexx2 compile`: compile the camera ahead of its first start."""

import argparse
import time

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.compiling import compiling_said, warm_up
from flexx2_sim_ros.cli.common import add_profile
from flexx2_sim_ros.effects import Effect, registry
from flexx2_sim_ros.physics.frame_state import why_no_phases
from flexx2_sim_ros.profiles.files import find_profile


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.epilog = 'example: flexx2 compile'
    parser.description = (
        'Compile the camera model and all effects, so that a camera starts at once. '
        'The result is kept in the folder of the package, or in the cache folder of the user if '
        'that is not writable (then each user runs this command once). Run it again after an '
        'update of the package or of numba. The commands characterize and gap have compiled loops '
        'of their own. They are compiled when these commands run for the first time.'
    )
    parser.add_argument(
        '--no-effects',
        action='store_true',
        help='leave out the effects, which take most of the time',
    )
    add_profile(parser)


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
    with compiling_said(say):
        warm_up(camera, profile.intrinsics)
        for effect in chosen:
            own = Camera(camera.usecase, profile=profile, effects=[effect])
            warm_up(own, profile.intrinsics)
    print(
        f'compiled in {time.monotonic() - start:.0f} s'
        if compiled
        else 'everything was compiled before'
    )
    return 0


def _that_apply(camera: Camera) -> list[Effect]:
    phases = not why_no_phases(camera.mode)
    return [kind() for kind in registry().values() if phases or not kind.needs_modulation]
