"""`flexx2 replay`: publish the messages of a bag."""

import argparse
from collections.abc import Callable
import time
from typing import Any

from flexx2_sim_ros.cli.common import messages, print_lines
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.cli.ros import ros
from rich.console import Console

_ACKNOWLEDGE_SECONDS = 5.0
_DISCOVERY_SECONDS = 0.5
OPTIONS = """
Publish the messages of a rosbag2 bag at the pace of their stamps, and a /clock that fits them.
Ends at the end of the bag. Needs ROS 2.

bag BAG: a folder, or a .mcap or .db3 file
--rate RATE: real-time factor (default %(default)s)
--loop: start again at the end, until Ctrl-C
--topics TOPIC: publish only these; wildcards allowed
--wait SECONDS: longest time to wait until every topic has a subscriber (default %(default)s)
--no-clock: do not publish /clock

example: flexx2 replay walk --rate 0.5 --topics '*/clean/*'
"""
VALUES = {
    'rate': {'type': number(0, 1e6, above=True), 'default': 1.0},
    'topics': {'nargs': '+', 'default': []},
    'wait': {'type': number(0, 1e6), 'default': 2.0},
}


def run(arguments: argparse.Namespace) -> int:
    """Publish until the end, or until told to stop."""
    from flexx2_sim_ros.recording.bag_files import Bag

    console = messages(soft_wrap=True)
    bag = Bag(arguments.bag)
    print_lines(console, bag.notes, 'yellow')
    known = len(bag.notes)
    seconds = 0.0
    with ros() as stopped:
        from flexx2_sim_ros.nodes.player import Player

        player = Player(bag, arguments.topics, not arguments.no_clock)
        try:
            _wait(player, arguments.wait, stopped, console)
            begun = time.monotonic()
            with console.status('playing'):
                player.play(arguments.rate, stopped)
                while arguments.loop and not stopped():
                    player.play(arguments.rate, stopped)
            seconds = time.monotonic() - begun
            if not stopped() and not player.finish(_ACKNOWLEDGE_SECONDS):
                console.print('a subscriber has not acknowledged all messages', style='yellow')
        finally:
            player.destroy_node()
    print_lines(console, bag.notes[known:], 'yellow')
    print(
        f'{arguments.bag}: {player.sent} messages in {seconds:.1f} s, at most '
        f'{1e3 * player.late:.0f} ms late'
    )
    return stopped.status


def _wait(player: Any, seconds: float, stopped: Callable[[], bool], console: Console) -> None:
    deadline = time.monotonic() + seconds
    with console.status('waiting for subscribers'):
        while player.unheard() and time.monotonic() < deadline and not stopped():
            time.sleep(0.02)
        # A subscriber discovered here may not have discovered this publisher yet. If it is best
        # effort, it loses the messages published before that.
        if seconds:
            time.sleep(_DISCOVERY_SECONDS)
    if unheard := player.unheard():
        print_lines(console, [f'no subscriber: {", ".join(unheard)}'], 'dim')
