"""`flexx2 convert`: recordings between bags and NumPy archives."""

import argparse
from typing import Any

from flexx2_sim_ros.errors import printable
from rich.console import Console


def add_parser(commands: Any) -> None:
    """Add the subcommand."""
    parser = commands.add_parser(
        'convert',
        help='convert a recording between a bag and .npz',
        description='Write a recording in another format, without loss. A and B are an .npz '
        'recording, or a rosbag2 bag: a folder, or a single .mcap or .db3 file. Bags of the real '
        'driver (pmd-royale-ros) work, too; a damaged bag is read up to the damage. '
        'From a bag with several cameras, B.npz becomes B_<camera>.npz for each.',
        epilog='example: flexx2 convert walk walk.npz --camera front_left',
    )
    parser.add_argument('source', metavar='A', help='recording to read')
    parser.add_argument('target', metavar='B', help='recording to write')
    parser.add_argument(
        '--camera',
        help='from a bag: which camera, by its name or by the topic of '
        'its depth image; to a bag: name of the camera',
    )
    parser.add_argument(
        '--storage',
        choices=('mcap', 'sqlite3'),
        default='mcap',
        help='format of a bag in a folder (default %(default)s)',
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Convert, and print what was converted."""
    from flexx2_sim_ros.recording.convert import convert

    console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
    for reader, path in convert(
        arguments.source, arguments.target, arguments.camera, arguments.storage
    ):
        for note in dict.fromkeys(reader.notes):
            console.print(printable(note), style='yellow')
        count, height, width = reader.shape
        camera = f' of {reader.camera}' if reader.camera else ''
        console.print(
            printable(
                f'{path}: {count} frames{camera}, {width} x {height}, '
                f'{reader.usecase or "unknown mode"}'
            )
        )
    return 0
