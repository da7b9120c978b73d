"""Bags and recordings for the tests; bags as of others are made with rosbags alone."""

from flexx2_sim_ros.recording import RecordingWriter
from flexx2_sim_ros.recording.convert import convert
import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

TYPES = get_typestore(Stores.ROS2_JAZZY)
IMAGE, INFO = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CameraInfo'
CLOUD, EVENT = 'sensor_msgs/msg/PointCloud2', 'rcl_interfaces/msg/ParameterEvent'
PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
STORAGES = tuple(PLUGINS)
SECOND = 1_000_000_000
DRIVER = '/pmd_royale_ros_camera_node'
MATRIX = np.array([[210.5, 0, 111.75], [0, 212.25, 85.5], [0, 0, 1]])
DISTORTION = np.array([0.25, -0.5, 0.001, 0.002, 0.125])
# When the real driver's frames were taken: microseconds since 1970, no float64 of seconds.
EPOCH = 1_795_123_456_123_457_000

# Frames of what `every_kind` writes.
COUNT = 12


def make(kind, *values):
    """Return a message."""
    return TYPES.types[kind](*values)


def header(stamp, frame_id='pmd_royale_ros_camera_node_optical_frame'):
    """Return a header."""
    return make(
        'std_msgs/msg/Header',
        make('builtin_interfaces/msg/Time', *divmod(stamp, SECOND)),
        frame_id,
    )


def image(topic, stamp, pixels, encoding='32FC1', received=None):
    """Return an image, rows unpadded, bytes in the array's order."""
    height, width = pixels.shape
    big = pixels.dtype.byteorder == '>'
    data = np.frombuffer(pixels.tobytes(), np.uint8)
    step = width * pixels.itemsize
    message = make(IMAGE, header(stamp), height, width, encoding, int(big), step, data)
    return topic, IMAGE, stamp if received is None else received, message


def info(topic, stamp, size, matrix=MATRIX, distortion=DISTORTION):
    """Return a camera info for (height, width)."""
    matrices = matrix, np.eye(3), np.hstack([matrix, np.zeros((3, 1))])
    region = make('sensor_msgs/msg/RegionOfInterest', 0, 0, 0, 0, False)
    lens = 'plumb_bob', distortion, *(one.ravel() for one in matrices)
    return topic, INFO, stamp, make(INFO, header(stamp), *size, *lens, 0, 0, region)


def driver_cloud(topic, stamp, z):
    """Return a cloud as the real driver fills it: points row by row, width and height swapped."""
    height, width = z.shape
    points = np.zeros((height, width, 4), '<f4')
    points[..., 0], points[..., 1], points[..., 2], points[..., 3] = 7.0, 8.0, z, 1.0
    fields = [
        make('sensor_msgs/msg/PointField', name, 4 * i, 7, 1)
        for i, name in enumerate(('x', 'y', 'z', 'conf'))
    ]
    data = np.frombuffer(points.tobytes(), np.uint8)
    layout = width, height, fields, False, 16, 16 * width
    return topic, CLOUD, stamp, make(CLOUD, header(stamp), *layout, data, False)


def usecase(node, received, value, changed=False, name='usecase'):
    """Return the event of a node's mode, or of another text parameter."""
    others = (np.zeros(0, kind) for kind in (np.uint8, bool, np.int64, float))
    content = make('rcl_interfaces/msg/ParameterValue', 4, False, 0, 0.0, value, *others, [])
    given = [make('rcl_interfaces/msg/Parameter', name, content)]
    time = make('builtin_interfaces/msg/Time', *divmod(received, SECOND))
    message = make(EVENT, time, node, [] if changed else given, given if changed else [], [])
    return '/parameter_events', EVENT, received, message


def write(path, entries, storage='mcap', compression=CompressionMode.NONE):
    """Write a bag."""
    writer = Writer(path, version=9, storage_plugin=PLUGINS[storage])
    writer.set_compression(compression, CompressionFormat.ZSTD)
    connections = {}
    with writer:
        for topic, kind, received, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], received, TYPES.serialize_cdr(message, kind))
    return path


def depths(count, height=172, width=224, seed=0):
    """Return (count, height, width) float32 metres, every pixel another."""
    return np.random.default_rng(seed).uniform(0.1, 7.0, (count, height, width)).astype('f4')


def driver_bag(path, depth, storage='mcap', **options):
    """Write what the real driver publishes, with its topics, encodings and stamps."""
    return write(path, driver_entries(depth), storage, **options)


def driver_entries(depth, node=DRIVER):
    """Return what the real driver publishes for (T, H, W) metres, 0 for invalid."""
    entries = [usecase(node, EPOCH - SECOND, 'Mode_5_45fps')]
    for index, frame in enumerate(depth):
        stamp = EPOCH + index * 22_222_000
        gray = np.full(frame.shape, index % 256, np.uint8)
        # The driver sends a camera info with the depth and another with the gray image.
        entries += [
            driver_cloud(f'{node}/point_cloud_0', stamp, frame),
            image(f'{node}/depth_image_0', stamp, frame),
            info(f'{node}/camera_info', stamp, frame.shape),
            image(f'{node}/gray_image_0', stamp, gray, 'mono8'),
            info(f'{node}/camera_info', stamp, frame.shape),
        ]
    return entries


def camera_entries(name, depth, clean, start=SECOND, step=SECOND // 60):
    """Return what a camera node and what feeds it publish."""
    node = f'/{name}/flexx2_camera'
    entries = [usecase(node, start, 'Mode_5_60fps')]
    for index, (seen, there) in enumerate(zip(depth, clean, strict=True)):
        stamp = start + index * step
        entries += [
            info(f'/{name}/clean/camera_info', stamp, there.shape),
            image(f'/{name}/clean/depth_image', stamp, there),
            image(f'/{name}/clean/reflectivity', stamp, there / 10),
            image(f'{node}/depth_image_0', stamp, seen),
            info(f'{node}/camera_info', stamp, seen.shape),
        ]
    return entries


def same(a, b):
    """Say whether two arrays are the same to the last bit."""
    return (
        a is not None
        and b is not None
        and a.dtype == b.dtype
        and a.shape == b.shape
        and a.tobytes() == b.tobytes()
    )


def every_kind(folder, count=COUNT):
    """Write the same recording as bags and archives of every kind."""
    paths = {'mcap': folder / 'one.mcap', 'db3': folder / 'one.db3', 'folder': folder / 'one'}
    paths |= {kind: folder / f'{kind}.npz' for kind in ('stored', 'deflated')}
    depth = depths(count, 43, 56)
    gray = np.random.default_rng(3).integers(0, 255, depth.shape, np.uint8)
    with RecordingWriter(paths['stored'], *depth.shape) as writer:
        writer.add_depth(depth)
        for key, value in {
            'K': np.diag([50.0, 50.0, 1.0]),
            'stamp': np.arange(count) / 8,
            'amplitude': gray,
            'clean_depth': depth[0] + 1,
            'usecase': 'Mode_9_30fps',
        }.items():
            writer.add_array(key, value)
    with np.load(paths['stored']) as arrays:
        np.savez_compressed(paths['deflated'], **arrays)
    for kind in ('mcap', 'db3', 'folder'):
        convert(paths['stored'], paths[kind])
    return paths


def unlike(one, other):
    """Return which arrays of two recordings differ."""
    names = ('depth', 'K', 'stamp', 'stamp_ns', 'clean_depth', 'amplitude')
    pairs = {name: (getattr(one, name), getattr(other, name)) for name in names}
    found = [name for name, (a, b) in pairs.items() if a is not b and not same(a, b)]
    return found + ['usecase'] * (one.usecase != other.usecase)
