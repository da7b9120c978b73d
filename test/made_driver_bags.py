"""Bags of other cameras' drivers, as these write them: topics, encodings, frames and lenses."""

from made_bags import EPOCH, image, info, MATRIX, SECOND
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_typestore, Stores

ROS1 = get_typestore(Stores.ROS1_NOETIC)
INFO = 'sensor_msgs/msg/CameraInfo'
SIZE = 12, 16
RATIONAL = np.array([2.09, 1.36, 1e-4, -2e-5, 0.07, 2.42, 2.05, 0.37])
COUNT = 3
COLOUR_MATRIX = np.diag([2.0, 2.0, 1.0]) @ MATRIX


def depths():
    """Return (COUNT, H, W) float32 metres with zeros for invalid, whole millimetres."""
    metres = np.random.default_rng(0).integers(300, 4000, (COUNT, *SIZE)) / 1000
    metres[:, 0, :3] = 0
    return metres.astype(np.float32)


def millimetres(metres):
    return np.rint(1000 * metres).astype(np.uint16)


def ros1_bag(path, entries, compression=''):
    """Write the same messages as ROS 1 does; compression: BZ2 or LZ4."""
    bag = Writer(path)
    if compression:
        bag.set_compression(Writer.CompressionFormat[compression])
    with bag as writer:
        connections = {}
        for topic, kind, received, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            head = message.header
            fields = {name: getattr(message, name) for name in message.__dataclass_fields__} | {
                'header': ROS1.types['std_msgs/msg/Header'](
                    7,
                    ROS1.types['builtin_interfaces/msg/Time'](head.stamp.sec, head.stamp.nanosec),
                    head.frame_id,
                )
            }
            if kind == INFO:
                region = ROS1.types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False)
                fields |= {'roi': region}
                fields |= {name.upper(): fields.pop(name) for name in 'dkrp'}
            data = ROS1.serialize_ros1(ROS1.types[kind](**fields), kind)
            writer.write(connections[topic], received, data)
    return path


def with_frame(entry, frame_id, **changes):
    """Change a message's frame and other fields."""
    entry[3].header.frame_id = frame_id
    for name, value in changes.items():
        setattr(entry[3], name, value)
    return entry


def stamps():
    return [EPOCH + index * SECOND // 30 for index in range(COUNT)]


def pico_flexx():
    """Return what pico_flexx_driver publishes: metres, 0 for invalid, raw and shown gray."""
    entries = []
    for stamp, depth in zip(stamps(), depths(), strict=True):
        raw = millimetres(depth)
        for name, pixels, encoding in (
            ('image_mono16', raw, 'mono16'),
            ('image_mono8', (raw // 16).astype(np.uint8), 'mono8'),
            ('image_depth', depth, '32FC1'),
            ('image_noise', depth / 1000, '32FC1'),
        ):
            entries.append(image(f'/pico_flexx/{name}', stamp, pixels, encoding))
        entries.append(info('/pico_flexx/camera_info', stamp, SIZE))
    return [with_frame(entry, 'pico_flexx_optical_frame') for entry in entries]


def realsense():
    """Return what realsense-ros publishes: millimetres, infrared, depth as colour sees it."""
    entries = []
    for stamp, depth in zip(stamps(), depths(), strict=True):
        raw = millimetres(depth)
        for name, pixels, encoding in (
            ('depth', raw, '16UC1'),
            ('infra1', (raw // 16).astype(np.uint8), 'mono8'),
            ('infra2', (raw // 32).astype(np.uint8), 'mono8'),
        ):
            frame = f'camera_{name}_optical_frame'
            space = f'/camera/camera/{name}'
            entries += [
                with_frame(image(f'{space}/image_rect_raw', stamp, pixels, encoding), frame),
                with_frame(
                    info(f'{space}/camera_info', stamp, SIZE, distortion=np.zeros(5)), frame
                ),
            ]
        for name in ('color', 'aligned_depth_to_color'):
            entries += _as_colour_sees_it(
                f'/camera/camera/{name}', stamp, raw, name == 'color', 'camera_color_optical_frame'
            )
    return entries


def _as_colour_sees_it(space, stamp, raw, colour, frame):
    # The colour image, or depth moved into its pixels; both have the camera info of colour.
    height, width = SIZE
    pixels = np.zeros((height, 3 * width), np.uint8) if colour else raw
    seen = image(f'{space}/image_raw', stamp, pixels, 'rgb8' if colour else '16UC1')
    return [
        with_frame(seen, frame, width=width),
        with_frame(info(f'{space}/camera_info', stamp, SIZE, COLOUR_MATRIX), frame),
    ]


def azure_kinect():
    """Return what the driver of Azure Kinect publishes: millimetres, a rational lens."""
    entries = []
    for stamp, depth in zip(stamps(), depths(), strict=True):
        raw = millimetres(depth)
        for name, encoding in (('depth', '16UC1'), ('ir', 'mono16')):
            lens = {'distortion_model': 'rational_polynomial', 'd': RATIONAL}
            entries += [
                image(f'/{name}/image_raw', stamp, raw, encoding),
                with_frame(info(f'/{name}/camera_info', stamp, SIZE), '', **lens),
            ]
    entries = [with_frame(entry, 'depth_camera_link') for entry in entries]
    for stamp, depth in zip(stamps(), depths(), strict=True):
        for name in ('rgb', 'depth_to_rgb'):
            entries += _as_colour_sees_it(
                f'/{name}', stamp, millimetres(depth), name == 'rgb', 'rgb_camera_link'
            )
    return sorted(entries, key=lambda entry: entry[2])
