"""`flexx2 view`: show live cameras, recordings or a diagnosis in a browser."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
from functools import partial
import importlib.util
import os
from pathlib import Path
import shutil
import signal
import socket
import sys
import tempfile
from typing import Any
import webbrowser

from flexx2_sim_ros.cli.options import whole_number
from flexx2_sim_ros.cli.ros import camera_command, check, node_command, nodes, ros
from flexx2_sim_ros.errors import InputError, shown

_CAMERAS = ('front_left', 'front_right')
_EVERYWHERE = ('0.0.0.0', '::', '')
OPTIONS = """
Serve a page that shows depth, what it is compared with, their difference and the point cloud of
all cameras. Without PATH it shows the cameras that stream now (needs ROS 2): on the page you
switch modes and drive the robot with W A S D. PATH is a recording (.npz or bag) or a folder of
recordings: their depth is compared with the ground truth and with a simulation at it. If PATH is a
folder that flexx2 gap diagnose has written, CAMPAIGN is the folder of its recordings: their depth
is also compared with a simulation with the diagnosed effects.

path PATH: recording, folder or diagnosis
campaign CAMPAIGN: recordings of the diagnosis
--profile
--planes FILE: draw the outlines of planes on the images; they are saved to this planes.yaml of
    flexx2 gap truth
--demo: also start a Go1 with two camera nodes
--scene SCENE: scene of the demo: lab, stairs, corner, board, rubble, or an MJCF file (default lab)
--renderer RENDERER: renderer of the demo: auto, egl, osmesa or ray (default %(default)s)
--cameras NAME: show only these (namespaces or nodes; in bags: names of cameras)
--cmd-vel TOPIC: topic for driving (default %(default)s)
--host HOST: address to serve on (default %(default)s: this machine only); for any other address
    the page asks for a token, which is part of the printed URL
--no-token: do not ask for a token: everybody who reaches the address can open the page and drive
    the robot
--port PORT: default %(default)s; 0 chooses a free one
--no-browser: print the address without opening a browser

examples: flexx2 view --demo; flexx2 view walk; flexx2 view diagnosis recordings
"""
VALUES = {
    'path': {'nargs': '?', 'type': Path},
    'campaign': {'nargs': '?', 'type': Path},
    'planes': {'type': Path},
    'renderer': 'auto',
    'cameras': {'nargs': '+', 'default': []},
    'cmd_vel': '/cmd_vel',
    'host': '127.0.0.1',
    'port': {'type': whole_number(0, 65535), 'default': 8172},
}


def run(arguments: argparse.Namespace) -> int:
    """Serve until told to stop."""
    if arguments.path is not None and arguments.demo:
        raise InputError('--demo: must be left out with PATH, got both')
    if arguments.path is None and arguments.planes is not None:
        raise InputError('--planes: must be given with PATH only')
    if importlib.util.find_spec('tornado') is None:
        raise InputError(
            'tornado is not installed: pip install "flexx2_sim_ros[view]", or '
            'apt install python3-tornado'
        )
    if arguments.scene and not arguments.demo:
        raise InputError(f'--scene: must be left out without --demo, got {shown(arguments.scene)}')
    from flexx2_sim_ros.view.access import Access, is_loopback, new_token
    from flexx2_sim_ros.view.web import bind

    # The port is bound first: if that fails, nothing is started.
    sockets = bind(arguments.host, arguments.port)
    is_open = is_loopback(arguments.host) or arguments.no_token
    access = Access(arguments.host, '' if is_open else new_token())
    if arguments.path is not None:
        return _show_files(arguments, sockets, access)
    return _show_live(arguments, sockets, access)


def _show_files(arguments: argparse.Namespace, sockets: list[socket.socket], access: Any) -> int:
    from flexx2_sim_ros.cli.view_files import open_files
    from flexx2_sim_ros.view.playback import PlaybackServer

    recordings, headline = open_files(
        arguments.path, arguments.campaign, arguments.cameras, arguments.profile
    )
    server = PlaybackServer(sockets, access, recordings, headline, arguments.planes)
    server.start()
    others = 'see these recordings' + (', and draw on them' if arguments.planes else '')
    _say_where(access, server.port, not arguments.no_browser, others)
    while True:  # Ctrl-C and SIGTERM end the process.
        signal.pause()


def _show_live(arguments: argparse.Namespace, sockets: list[socket.socket], access: Any) -> int:
    with ExitStack() as stack:
        stopped = stack.enter_context(ros())
        from flexx2_sim_ros.nodes.viewer import Viewer
        from flexx2_sim_ros.view.server import Server
        from rclpy.exceptions import InvalidTopicNameException

        try:
            viewer = Viewer(arguments.cameras, arguments.cmd_vel)
        except InvalidTopicNameException as error:
            raise InputError(f'--cmd-vel: {error}'.splitlines()[0]) from error
        stack.callback(viewer.destroy_node)
        server = Server(sockets, access, viewer)
        viewer.wake = server.wake
        server.start()
        stack.callback(server.stop)
        look_after = stack.enter_context(_demo(arguments))
        _say_where(access, server.port, not arguments.no_browser, 'drive the robot')
        _spin(viewer, stopped, look_after)
    return stopped.status


@contextmanager
def _demo(arguments: argparse.Namespace) -> Iterator[Callable[[], None]]:
    # Run the demo's nodes if wanted; yield a function that raises when a node has ended.
    if not arguments.demo:
        yield lambda: None
        return
    robot = node_command(
        'go1_cameras',
        f'cmd_vel:={arguments.cmd_vel}',
        motion='cmd_vel',
        scene=arguments.scene or 'lab',
        renderer=arguments.renderer,
    )
    commands = {'go1_cameras': robot} | {one: camera_command(one) for one in _CAMERAS}
    folder = Path(tempfile.mkdtemp(prefix='flexx2_view_'))
    with nodes(commands, folder) as processes:
        yield partial(check, processes, folder)
    # After an error the folder stays, because it has the nodes' logs.
    shutil.rmtree(folder)


def _say_where(access: Any, port: int, with_browser: bool, others_can: str) -> None:
    from flexx2_sim_ros.view.access import address, is_loopback

    everywhere = access.host in _EVERYWHERE
    # A socket of IPv6 does not take requests of IPv4.
    here = '::1' if access.host == '::' else '127.0.0.1'
    url = address(here if everywhere else access.host, port, access.token)
    print(f'{url} (Ctrl-C ends it)', flush=True)
    if everywhere:
        print(
            f'From another machine: {address(socket.gethostname(), port, access.token)}',
            flush=True,
        )
    if not is_loopback(access.host):
        who = 'has this address' if access.token else 'reaches this machine'
        print(
            f'warning: --host {access.host}: everybody who {who} can {others_can}', file=sys.stderr
        )
    # Without a display, a text browser would open in this terminal.
    has_screen = (
        sys.platform != 'linux' or os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')
    )
    if has_screen and with_browser:
        webbrowser.open(url)


def _spin(viewer: Any, stopped: Callable[[], bool], look_after: Callable[[], None]) -> None:
    from flexx2_sim_ros.nodes.runtime import spin_some, Throttle
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(viewer)
    throttle = Throttle()
    while not stopped():
        spin_some(executor, viewer, throttle, 0.1)
        if not stopped():
            look_after()
    executor.shutdown()
