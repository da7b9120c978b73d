"""Size and time of recorded depth in MCAP bags, beside other ways to compress and to read it."""

from functools import partial
from pathlib import Path
import tempfile
import time

from bench.timing import side_by_side
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_cameras import topics_of
from flexx2_sim_ros.recording.bag_writer import BagWriter
from flexx2_sim_ros.recording.checksums import zstd, ZSTD_LEVEL
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.rendering.scenes import reflectivity_table
from flexx2_sim_ros.robots.model import build_model, stand
import mujoco
import numpy as np
from rosbags.rosbag2 import Reader

_CAMERA, _USECASE, _RATE_HZ = 'front_left', 'Mode_5_60fps', 60
_SPEED = 0.5  # m/s
_CHUNK = 1 << 20  # bytes, as rosbags closes chunks
_LEVELS = (1, 3, 9)


def run(frames=60, rounds=5):
    """Print sizes and times by kind of image, and those of whole bags."""
    images = _walk(frames)
    print(
        f'{frames} frames of {_CAMERA} of a Go1 that moves at {_SPEED} m/s through the lab, '
        f'{_USECASE}; CPU time of this thread'
    )
    for kind, stack in images.items():
        _print_image(kind, stack, rounds)
    entries = _entries(images)
    _print_bags(entries, frames, rounds)
    print('\nreading these bags of mcap; wanted: at most 1.1 x')
    for times in (1, 3):
        for compression in ('none', 'zstd'):
            _print_reading(entries, times, compression, rounds)


def _walk(frames):
    intrinsics = flexx2().intrinsics
    model = build_model(intrinsics=intrinsics)
    data = mujoco.MjData(model)
    stand(model, data)
    renderer, table = open_renderer(model, intrinsics, 'auto'), reflectivity_table(model)
    depths, reflectivities = [], []
    for _ in range(frames):
        mujoco.mj_forward(model, data)
        depth, geom_id = renderer.render(data, _CAMERA)
        depths.append(depth.copy())
        reflectivities.append(table[geom_id])
        data.qpos[0] += _SPEED / _RATE_HZ
    renderer.close()
    clean, reflectivity = np.stack(depths), np.stack(reflectivities)
    stamps = np.arange(frames) / _RATE_HZ
    camera = Camera(_USECASE, seed=1, name=_CAMERA)
    simulated = camera.capture(clean, intrinsics.matrix, stamp=stamps, reflectivity=reflectivity)
    return {'simulated': simulated.depth, 'clean': clean, 'reflectivity': reflectivity}


def _print_image(kind, stack, rounds):
    data = stack.tobytes()
    chunks = [data[at : at + _CHUNK] for at in range(0, len(data), _CHUNK)]
    ways = {f'zstd {level}': partial(zstd.compress, level=level) for level in _LEVELS}
    sizes = {name: sum(len(way(chunk)) for chunk in chunks) for name, way in ways.items()}
    times = side_by_side(
        {name: partial(_each, way, chunks) for name, way in ways.items()},
        rounds,
        time.process_time,
    )
    print(f'\n{kind}: {len(data) / len(stack) / 1e3:.0f} kB a frame')
    for name, size in sizes.items():
        print(
            f'  {name:20s} {len(data) / size:6.2f} times smaller, '
            f'{times[name] / len(stack):6.3f} ms a frame'
        )


def _each(function, items):
    for item in items:
        function(item)


def _entries(images):
    # Topic, number of the frame and image of each message.
    where = topics_of(_CAMERA)
    topics = dict(zip(images, (where.depth, where.clean, where.reflectivity), strict=True))
    return [
        (topics[kind], number, stack[number])
        for number in range(len(images['clean']))
        for kind, stack in images.items()
    ]


def _encoded(entries, first=0):
    for topic, number, image in entries:
        stamp = (first + number) * 10**9 // _RATE_HZ
        yield topic, stamp, messages.encode_image(stamp, _CAMERA, image)


def _print_bags(entries, frames, rounds):
    encoded = list(_encoded(entries))
    with tempfile.TemporaryDirectory() as folder:
        sizes = {}

        def write(compression):
            path = Path(folder) / f'{compression}_{len(list(Path(folder).iterdir()))}'
            with BagWriter(path, 'mcap', compression) as writer:
                for topic, stamp, data in encoded:
                    writer.write(topic, messages.IMAGE, stamp, data)
            sizes[compression] = sum(file.stat().st_size for file in path.iterdir())

        ways = {name: partial(write, name) for name in ('none', 'zstd')}
        times = side_by_side(ways, rounds, time.process_time)
    print(f'\nMCAP bags of all three, zstd at level {ZSTD_LEVEL}')
    for name, size in sizes.items():
        print(
            f'  {name:20s} {size / frames / 1e3:6.0f} kB a frame, {sizes["none"] / size:5.2f} '
            f'times smaller, {times[name] / frames:6.3f} ms a frame'
        )


def _print_reading(entries, times, compression, rounds):
    # The images, so many times one after the other, by this package and by rosbags alone.
    frames = len({number for _, number, _ in entries})
    info, lens = topics_of(_CAMERA).info, flexx2().intrinsics
    size = lens.height, lens.width
    lens_message = messages.encode_camera_info(0, _CAMERA, size, lens.matrix, np.zeros(5))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bag'
        with BagWriter(path, 'mcap', compression) as writer:
            writer.write(info, messages.CAMERA_INFO, 0, lens_message)
            for part in range(times):
                for topic, stamp, data in _encoded(entries, part * frames):
                    writer.write(topic, messages.IMAGE, stamp, data)
        cost = side_by_side(
            {'here': partial(load_recording, path), 'rosbags': partial(_plain_reading, path)},
            rounds,
            time.process_time,
        )
    frames *= times
    print(
        f'  {compression}, {frames} frames: {cost["here"] / frames:.3f} ms a frame, '
        f'{cost["here"] / cost["rosbags"]:.2f} x that of rosbags'
    )


def _plain_reading(path):
    # As one writes it in a minute: all messages to arrays, with no checks.
    store, stacks = messages.typestore(), {}
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            if connection.msgtype == messages.IMAGE:
                pixels = message.data.view(np.float32).reshape(message.height, message.width)
                stacks.setdefault(connection.topic, []).append(pixels)
    return {topic: np.stack(images) for topic, images in stacks.items()}
