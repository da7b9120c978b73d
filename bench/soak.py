"""
Two camera nodes for an hour, at 60 Hz each with four effects: memory and losses.

``python -m bench.soak [MINUTES [SEED]]`` adds a line to ``build/torture/soak.jsonl`` every 30 s,
so the results of an interrupted run are kept.
"""

import json
import math
import os
import sys
import time

from bench.journal import FOLDER
from bench.timing import megabytes
from flexx2_sim_ros.cli.ros import camera_command, check, nodes
import numpy as np

_CAMERAS = ('left', 'right')
_EFFECTS = ('temporal_filter', 'flying_pixels', 'heavy_tails', 'low_signal_dropout')
_RATE = 60
_SAMPLE_SECONDS = 30.0
_WARM_UP_SECONDS = 300.0
_PATIENCE = 90.0
# The counters of received images, by their names in the diagnostics.
_FATES = (
    'frames published',
    "inputs dropped (not due at the mode's rate)",
    'inputs dropped (repeated stamp)',
    'inputs rejected',
)
_LOST = 'messages lost (clean/depth_image)'


def run(minutes=60.0, seed=0, out=FOLDER):
    """
    Run the nodes, publish and read; print a line for each sample, and the result.

    * `seed`: seed of both cameras
    * `out`: folder for ``soak.jsonl``, a line for each sample, and for the logs of the nodes

    Returns ``minutes`` measured, from the first images on, and by camera: ``sent``, ``received``,
    ``lost``, ``silent`` (``sent`` without the others), ``unaccounted`` (received, but neither
    published nor said to be dropped), ``read`` frames, ``megabytes`` of each sample and
    ``slope_mb_per_hour`` of it after five minutes (NaN for less than that).
    """
    from bench.node_traffic import Traffic
    import rclpy

    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    out.mkdir(parents=True, exist_ok=True)
    samples = []
    rclpy.init(args=[])
    try:
        with nodes(_commands(seed), out) as processes, (out / 'soak.jsonl').open('w') as file:
            traffic = Traffic(_CAMERAS, _RATE)
            counters = _Counters(traffic)
            traffic.wait_for_nodes()
            begun = time.monotonic()

            def keep():
                samples.append(_sample(time.monotonic() - begun, processes, counters))
                line = samples[-1] | {'diagnostics': counters.values}
                print(json.dumps(line), file=file, flush=True)
                print(samples[-1], flush=True)

            while (left := begun + 60 * minutes - time.monotonic()) > 0:
                traffic.feed(math.ceil(_RATE * min(left, _SAMPLE_SECONDS)))
                check(processes, out)
                keep()
            counters.settle()
            keep()
    finally:
        rclpy.try_shutdown()
    result = _result(samples)
    for name, value in result.items():
        print(f'{name:8s} {value}')
    print('wanted: silent 0, unaccounted 0, slope_mb_per_hour below 1')
    return result


class _Counters:
    # The latest counters that each node reports on /diagnostics.

    def __init__(self, traffic):
        from diagnostic_msgs.msg import DiagnosticArray

        self.traffic = traffic
        self.values = {name: {} for name in _CAMERAS}
        self._reports = dict.fromkeys(_CAMERAS, 0)
        traffic.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, 10)

    def _hear(self, array):
        for status in array.status:
            name = status.name.partition('/')[0]
            if name in self.values:
                self.values[name] = {pair.key: pair.value for pair in status.values}
                self._reports[name] += 1

    def settle(self):
        # When two reports of each node agree, it has received everything.
        before, end = None, time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            wanted = {name: count + 2 for name, count in self._reports.items()}
            self.traffic.spin_until(
                lambda wanted=wanted: all(self._reports[name] >= wanted[name] for name in wanted),
                _PATIENCE,
            )
            now = {name: values.get('inputs received') for name, values in self.values.items()}
            if now == before:
                return
            before = now


def _commands(seed):
    values = {'usecase': 'Mode_5_60fps', 'seed': seed}
    values |= {f'effect.{effect}.strength': 1.0 for effect in _EFFECTS}
    return {name: camera_command(name, **values) for name in _CAMERAS}


def _sample(seconds, processes, counters):
    cameras = {}
    sent = counters.traffic.sent
    for name in _CAMERAS:
        values = counters.values[name]
        received, lost = (int(values.get(key, 0)) for key in ('inputs received', _LOST))
        cameras[name] = {
            'sent': sent,
            'received': received,
            'lost': lost,
            'silent': sent - received - lost,
            'unaccounted': received - sum(int(values.get(key, 0)) for key in _FATES),
            'read': len(counters.traffic.stamps[name]),
            'megabytes': round(megabytes(processes[name].pid), 1),
        }
    return {'seconds': round(seconds, 1), 'load': os.getloadavg(), **cameras}


def _result(samples):
    result = {'minutes': round(samples[-1]['seconds'] / 60, 1)}
    for name in _CAMERAS:
        warm = [
            (sample['seconds'] / 3600, sample[name]['megabytes'])
            for sample in samples
            if sample['seconds'] >= _WARM_UP_SECONDS
        ]
        slope = float(np.polyfit(*np.transpose(warm), 1)[0]) if len(warm) > 2 else float('nan')
        result[name] = {
            **samples[-1][name],
            'megabytes': [sample[name]['megabytes'] for sample in samples],
            'slope_mb_per_hour': round(slope, 3),
        }
    return result


if __name__ == '__main__':
    run(*(kind(word) for kind, word in zip((float, int), sys.argv[1:], strict=False)))
