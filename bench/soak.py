"""
Two camera nodes for an hour, at 60 Hz each with four effects: memory and losses.

``python -m bench.soak [MINUTES [SEED]]`` adds a line to ``build/torture/soak.jsonl`` every 30 s,
so the results of an interrupted run are kept.
"""

from contextlib import contextmanager, suppress
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from bench.journal import FOLDER
from flexx2_sim_ros.processes import end_with_parent, watched_environment
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

_CAMERAS = ('left', 'right')
_EFFECTS = ('temporal_filter', 'flying_pixels', 'heavy_tails', 'low_signal_dropout')
_RATE = 60
_SAMPLE_SECONDS = 30.0
_WARM_UP_SECONDS = 300.0
_PATIENCE = 90.0
_SCENES = 16
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
    Run the nodes, a publisher and a reader; print a line each minute and a table at the end.

    * `seed`: seed of the scene and of both cameras
    * `out`: folder for ``soak.jsonl``: a line for each sample, the last of them after the end

    Returns ``minutes`` measured, from the first images on, and by camera: ``sent``, ``received``,
    ``lost``, ``silent`` (``sent`` without the others), ``unaccounted`` (received, but neither
    published nor said to be dropped), ``read`` frames, ``resident_mb`` of each sample and
    ``slope_mb_per_hour`` of it after five minutes (NaN for less than that).
    """
    os.environ.setdefault('ROS_DOMAIN_ID', str(50 + os.getpid() % 50))
    out.mkdir(parents=True, exist_ok=True)
    path = out / 'soak.jsonl'
    path.unlink(missing_ok=True)
    console = Console()
    samples = []
    with _children(out, seed) as processes, _Reports() as reports:
        publisher = processes['publisher']
        reports.spin(time.monotonic() + _PATIENCE, lambda: bool(_last(out / 'publisher.log')))
        begun = time.monotonic()
        end, said = begun + 60.0 * minutes, begun
        while time.monotonic() < end and all(p.poll() is None for p in processes.values()):
            reports.spin(min(end, begun + _SAMPLE_SECONDS * (len(samples) + 1)))
            _keep(path, samples, _sample(begun, processes, reports, out))
            if time.monotonic() - said >= 59.0:
                said = time.monotonic()
                console.print(_line(samples[-1]), highlight=False)
        publisher.terminate()
        publisher.wait(_PATIENCE)
        reports.settle()
        _keep(path, samples, _sample(begun, processes, reports, out))
        ended = {name: p.poll() for name, p in processes.items() if name != 'publisher'}
    result = _result(samples)
    _print(console, result)
    for name, status in ended.items():
        if status is not None:
            console.print(f'{name} ended by itself: exit status {status}')
    return result


class _Reports:
    # The latest counters that each node reports on /diagnostics.

    def __init__(self):
        from diagnostic_msgs.msg import DiagnosticArray
        import rclpy

        rclpy.init(args=[])
        self._spin_once, self._shutdown = rclpy.spin_once, rclpy.try_shutdown
        self._node = rclpy.create_node('soak')
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, 10)
        self.values = {name: {} for name in _CAMERAS}
        self._count = dict.fromkeys(_CAMERAS, 0)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._node.destroy_node()
        self._shutdown()

    def _hear(self, array):
        for status in array.status:
            name = status.name.partition('/')[0]
            if name in self.values:
                self.values[name] = {pair.key: pair.value for pair in status.values}
                self._count[name] += 1

    def spin(self, until, done=lambda: False):
        while (left := until - time.monotonic()) > 0 and not done():
            self._spin_once(self._node, timeout_sec=min(left, 0.5))

    def settle(self):
        # When two reports of each node agree, it has received everything.
        end = time.monotonic() + _PATIENCE
        before = None
        while time.monotonic() < end:
            wanted = {name: count + 2 for name, count in self._count.items()}
            while time.monotonic() < end and any(
                self._count[name] < count for name, count in wanted.items()
            ):
                self._spin_once(self._node, timeout_sec=0.2)
            now = {name: values.get('inputs received') for name, values in self.values.items()}
            if now == before:
                return
            before = now


@contextmanager
def _children(out, seed):
    processes = {}
    try:
        for name in _CAMERAS:
            words = ['-r', f'__ns:=/{name}', '-p', 'usecase:=Mode_5_60fps', '-p', f'seed:={seed}']
            for effect in _EFFECTS:
                words += ['-p', f'effect.{effect}.strength:=1.0']
            processes[name] = _start(
                ['flexx2_sim_ros.nodes.flexx2_camera', '--ros-args', *words], out / f'{name}.log'
            )
        processes['reader'] = _start(['bench.soak', 'reader'], out / 'reader.log')
        processes['publisher'] = _start(
            ['bench.soak', 'publisher', str(seed)], out / 'publisher.log'
        )
        yield processes
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()


def _start(words, log):
    with log.open('wb') as file:
        return subprocess.Popen(
            [sys.executable, '-m', *words],
            env=watched_environment(),
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=subprocess.STDOUT,
        )


def _sample(begun, processes, reports, out):
    sent, read = _last(out / 'publisher.log'), _last(out / 'reader.log')
    cameras = {}
    for name in _CAMERAS:
        values = reports.values[name]
        received = int(values.get('inputs received', 0))
        lost = int(values.get(_LOST, 0))
        cameras[name] = {
            'sent': sent.get(name, 0),
            'received': received,
            'lost': lost,
            'silent': sent.get(name, 0) - received - lost,
            'unaccounted': received - sum(int(values.get(key, 0)) for key in _FATES),
            'read': read.get(name, 0),
            'resident_mb': resident_mb(processes[name].pid),
            'diagnostics': values,
        }
    return {'seconds': round(time.monotonic() - begun, 1), 'load': os.getloadavg(), **cameras}


def _keep(path, samples, sample):
    samples.append(sample)
    with path.open('a') as file:
        file.write(json.dumps(sample) + '\n')


def _last(log):
    # The last complete line of counters that a child process printed.
    lines = [line for line in log.read_text().splitlines(True) if line.startswith('{')]
    whole = [line for line in lines if line.endswith('}\n')]
    return json.loads(whole[-1]) if whole else {}


def _line(sample):
    parts = [f'{sample["seconds"] / 60:5.1f} min, load {sample["load"][0]:.1f}']
    for name in _CAMERAS:
        camera = sample[name]
        parts.append(
            f'{name}: sent {camera["sent"]}, received {camera["received"]}, lost '
            f'{camera["lost"]}, read {camera["read"]}, {camera["resident_mb"]:.1f} MB'
        )
    return '; '.join(parts)


def _result(samples):
    result = {'minutes': round(samples[-1]['seconds'] / 60, 1)}
    for name in _CAMERAS:
        warm = [
            (sample['seconds'] / 3600, sample[name]['resident_mb'])
            for sample in samples
            if sample['seconds'] >= _WARM_UP_SECONDS
        ]
        slope = float(np.polyfit(*np.transpose(warm), 1)[0]) if len(warm) > 2 else float('nan')
        last = samples[-1][name]
        result[name] = {
            **{key: last[key] for key in ('sent', 'received', 'lost', 'silent', 'unaccounted')},
            'read': last['read'],
            'resident_mb': [round(sample[name]['resident_mb'], 1) for sample in samples],
            'slope_mb_per_hour': round(slope, 3),
        }
    return result


def _print(console, result):
    table = Table(
        box=box.SIMPLE, title=f'{result["minutes"]} minutes of two cameras at {_RATE} Hz'
    )
    table.add_column('')
    for name in _CAMERAS:
        table.add_column(name, justify='right')
    rows = (
        ('images sent', lambda camera: camera['sent']),
        ('received', lambda camera: camera['received']),
        ('lost, as the node reports', lambda camera: camera['lost']),
        ('lost silently (wanted 0)', lambda camera: camera['silent']),
        ('received, no word of what became of it (wanted 0)', lambda c: c['unaccounted']),
        ('frames that the reader read', lambda camera: camera['read']),
        ('memory at the end, MB', lambda camera: camera['resident_mb'][-1]),
        ('slope after 5 min, MB/h (wanted < 1)', lambda camera: camera['slope_mb_per_hour']),
    )
    for text, of in rows:
        table.add_row(text, *(str(of(result[name])) for name in _CAMERAS))
    console.print(table)


def resident_mb(pid):
    """Return a process's resident memory in MB, NaN when it has ended."""
    try:
        pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    except (OSError, IndexError):
        return float('nan')
    return pages * os.sysconf('SC_PAGE_SIZE') / 2**20


def _publish(seed):
    # Sends both cameras the same images; prints how many, once a second and at the end.
    from bench.plain_publisher import wall
    from bench.scenes import room
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import CameraInfo, Image

    told = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _frame: told.append(number))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('soak_publisher')
    topics = [
        (node.create_publisher(kind, f'/{name}/clean/{topic}', 10), message)
        for name in _CAMERAS
        for kind, topic, message in ((CameraInfo, 'camera_info', 1), (Image, 'depth_image', 0))
    ]
    rng = np.random.default_rng(seed)
    scenes, messages = [], wall('224x172', 1.5)
    for shift in rng.uniform(0.0, 0.3, _SCENES).astype(np.float32):
        image, _ = wall('224x172', 1.5)
        image.data = (room() + shift).tobytes()
        scenes.append(image)
    while not (told or all(publisher.get_subscription_count() for publisher, _ in topics)):
        time.sleep(0.05)
    time.sleep(2.0)  # The nodes may change the quality of service that they request.
    sent, tick, begun = 0, 0, time.monotonic()
    while not told:
        # A missed tick is skipped.
        tick = max(tick + 1, int((time.monotonic() - begun) * _RATE))
        time.sleep(max(0.0, begun + tick / _RATE - time.monotonic()))
        image = scenes[sent % _SCENES]
        for message in (messages[1], image):
            message.header.stamp.sec, nanoseconds = divmod(tick * 10**9 // _RATE, 10**9)
            message.header.stamp.nanosec = nanoseconds
        for publisher, which in topics:
            publisher.publish(messages[1] if which else image)
        sent += 1
        if sent % _RATE == 0:
            print(json.dumps(dict.fromkeys(_CAMERAS, sent)), flush=True)
    print(json.dumps(dict.fromkeys(_CAMERAS, sent)), flush=True)
    time.sleep(5.0)  # Time to send lost messages again.
    rclpy.try_shutdown()


def _read():
    # Receives the depth of both cameras; prints how many frames, once a second.
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from sensor_msgs.msg import Image

    rclpy.init(args=[])
    node = rclpy.create_node('soak_reader')
    counts = dict.fromkeys(_CAMERAS, 0)

    def count(name):
        counts[name] += 1

    for name in _CAMERAS:
        node.create_subscription(
            Image, f'/{name}/flexx2_camera/depth_image_0', lambda _, name=name: count(name), 10
        )
    node.create_timer(1.0, lambda: print(json.dumps(counts), flush=True))
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    end_with_parent()
    if sys.argv[1:2] == ['publisher']:
        _publish(int(sys.argv[2]))
    elif sys.argv[1:2] == ['reader']:
        _read()
    else:
        run(*(kind(word) for kind, word in zip((float, int), sys.argv[1:], strict=False)))
