"""`flexx2 compile`: compile the camera ahead of its first start."""

import argparse
import time
from typing import Any

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.compiling import compiling_said, warm_up
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.profiles.modes import flexx2


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'compile',
        help='compile the camera before its first start',
        epilog='example: flexx2 compile',
        description='Compile the camera model and all effects, so that a camera starts at once. '
        'The result is kept in the folder of the package, or in the cache folder of the user if '
        'that is not writable (then each user runs this command once). Run it again after an '
        'update of the package or of numba.',
    )
    parser.add_argument(
        '--no-effects',
        action='store_true',
        help='leave out the effects, which take most of the time',
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compile, and say how long it took."""
    start = time.monotonic()
    compiled: list[bool] = []

    def say() -> None:
        compiled.append(True)
        print('compiling ...', flush=True)

    profile = flexx2()
    chosen = () if arguments.no_effects else [effect() for effect in registry().values()]
    with compiling_said(say):
        warm_up(Camera(profile=profile), profile.intrinsics)
        for effect in chosen:
            warm_up(Camera(profile=profile, effects=[effect]), profile.intrinsics)
    print(
        f'compiled in {time.monotonic() - start:.0f} s'
        if compiled
        else 'everything was compiled before'
    )
    return 0
