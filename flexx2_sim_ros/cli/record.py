"""`flexx2 record`: record all cameras into a bag."""

import argparse
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
import shutil
import time
from typing import Any

from flexx2_sim_ros.atomic import check_folder
from flexx2_sim_ros.cli.common import messages, plain_table
from flexx2_sim_ros.cli.options import number
from flexx2_sim_ros.cli.ros import ros
from flexx2_sim_ros.errors import InputError, printable
from rich.console import Console

_SHOW_SECONDS = 0.25
_DRAIN_SECONDS = 2.0
_IDLE = 5
OPTIONS = """
Record clean and simulated depth, reflectivity, gray images, camera infos and modes of all cameras,
simulated or real, with /tf, /tf_static and /clock, into a rosbag2 bag, until Ctrl-C. Lost messages
are counted and shown. Needs ROS 2.

bag BAG: new folder, without an ending (default: flexx2_ and the time)
--seconds SECONDS: stop this long after the first message (default: record until Ctrl-C)
--wait SECONDS: longest time to wait for the first message (default %(default)s)
--storage mcap|sqlite3: format of the bag (default %(default)s)
--compression zstd|none: of MCAP bags, without loss (default zstd; none for sqlite3)
--cameras NAME: record only these (namespaces or nodes)
--also TOPIC: record more topics; wildcards allowed: '*/point_cloud_0' '*/depth_noise_0' /odom
--queue MB: memory for messages that wait for the disk (default %(default)g)

example: flexx2 record walk --seconds 10
"""
VALUES = {
    'bag': {'nargs': '?', 'type': Path},
    'seconds': number(0, 1e9, above=True),
    'wait': {'type': number(0, 1e9, above=True), 'default': 30.0},
    'storage': 'mcap',
    'cameras': {'nargs': '+', 'default': []},
    'also': {'nargs': '+', 'default': []},
    'queue': {'type': number(0, 1e6, above=True), 'default': 256.0},
}


def run(arguments: argparse.Namespace) -> int:
    """Record until told to stop."""
    path = arguments.bag or Path(datetime.now().strftime('flexx2_%Y%m%d_%H%M%S'))
    from flexx2_sim_ros.recording.bag_writer import BagWriter, check_bag_name
    from flexx2_sim_ros.recording.sink import BagSink

    usual = 'zstd' if arguments.storage == 'mcap' else 'none'
    check_bag_name(path)
    writer = BagWriter(path, arguments.storage, arguments.compression or usual)
    check_folder(path)
    with ros() as stopped:
        from flexx2_sim_ros.nodes.recorder import Recorder

        with BagSink(writer, round(1e6 * arguments.queue)) as sink:
            recorder = Recorder(sink, arguments.cameras, arguments.also)
            try:
                _spin(recorder, sink, arguments, stopped)
            finally:
                recorder.destroy_node()
                sink.remarks |= _remarks(recorder)
                _report(recorder, path)
    if recorder.started is None:
        shutil.rmtree(path, ignore_errors=True)
        if not stopped():
            raise InputError(f'{path}: nothing was recorded: no camera published anything')
    return stopped.status


def _spin(
    recorder: Any, sink: Any, arguments: argparse.Namespace, stopped: Callable[[], bool]
) -> None:
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(recorder)
    console = messages()
    begun = shown = time.monotonic()
    with console.status('waiting for cameras') as status:
        while not stopped() and sink.error is None:
            executor.spin_once(timeout_sec=0.1)
            now = time.monotonic()
            if recorder.started is None:
                if now - begun > arguments.wait:
                    break
            elif arguments.seconds is not None and recorder.seconds >= arguments.seconds:
                break
            if now - shown > _SHOW_SECONDS:
                shown = now
                status.update(_progress(recorder, sink))
        status.update('writing the rest')
        _drain(recorder, executor)
    executor.shutdown()


def _drain(recorder: Any, executor: Any) -> None:
    # Messages that arrived before the end but were not handled yet belong to the bag.
    end = time.monotonic() + _DRAIN_SECONDS
    idle = 0
    while idle < _IDLE and time.monotonic() < end:
        taken = recorder.taken
        executor.spin_once(timeout_sec=0.0)
        idle = idle + 1 if recorder.taken == taken else 0


def _progress(recorder: Any, sink: Any) -> str:
    if recorder.started is None:
        return 'waiting for cameras'
    topics = recorder.topics.values()
    messages, size, lost = (
        sum(getattr(topic, name) for topic in topics) for name in ('messages', 'size', 'lost')
    )
    return (
        f'{recorder.seconds:.0f} s, {messages} messages, {size / 1e6:.0f} MB, '
        f'{sink.waiting / 1e6:.0f} MB waiting, [{"red" if lost else "green"}]{lost} lost[/]'
    )


def _remarks(recorder: Any) -> dict[str, str]:
    from flexx2_sim_ros.recording.bag_files import LOST

    lost = [f'{topic.lost} of {name}' for name, topic in recorder.topics.items() if topic.lost]
    return {LOST: ', '.join(lost)} if lost else {}


def _report(recorder: Any, path: Path) -> None:
    numbers = 'messages', 'from [s]', 'Hz', 'MB', 'lost', 'gaps'
    table = plain_table('topic', *numbers, text=('topic',), whole=numbers)
    table.columns[0].overflow = 'fold'
    for name, topic in sorted(recorder.topics.items()):
        gaps = topic.gaps()
        text = f'{gaps.count} ({gaps.longest:.3f} s)' if gaps.count else '0'
        table.add_row(
            printable(name),
            str(topic.messages),
            f'{topic.first:.1f}',
            f'{topic.rate_hz:.2f}' if topic.stamps else '',
            f'{topic.size / 1e6:.1f}',
            str(topic.lost),
            text if topic.stamps else '',
            style='red' if topic.lost else None,
        )
    console = Console(highlight=False, markup=False)
    console.print(table)
    lost = sum(topic.lost for topic in recorder.topics.values())
    refused = sum(topic.refused for topic in recorder.topics.values())
    console.print(
        f'{path}: {recorder.seconds:.1f} s, {lost} messages lost'
        + (
            f' ({refused} because the disk was too slow, {lost - refused} in transport)'
            if lost
            else ''
        ),
        soft_wrap=True,
    )
