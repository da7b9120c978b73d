"""Messages as other simulators send them, through a node started with the documented remaps."""

from dataclasses import dataclass
import math
from pathlib import Path
import re
import shlex
import sys
import time

from flexx2_sim_ros.camera import flexx2
from made_bags import image, info, write
import numpy as np
from programs import started
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader
from simulators import assert_noise_is_sigma
from streams import array_of, CameraInfo, Image, listening, nanoseconds

pytestmark = pytest.mark.usefixtures('ros')
PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'nodes.md'
LENS, USECASE, RATE, COUNT = flexx2().intrinsics, 'Mode_5_30fps', 30, 8
AGAIN_SECONDS = 0.3  # a new best-effort publisher loses its first messages


@dataclass(frozen=True)
class Simulator:
    """
    How a simulator publishes depth.

    * `depth`, `info`: topics
    * `frame`: the ``frame_id``
    * `encoding`: of the depth image
    * `nothing`: depth of pixels without a surface, in the image's unit
    * `best_effort`: whether lost messages are not sent again
    * `stamped`: whether camera infos have the stamps of their images; the first stamp otherwise
    * `keeps`: how many messages its publishers keep
    * `focal`: focal length in pixels of images whose camera info counts from the corner of the
      first pixel; None for the lens of the Flexx2
    """

    depth: str
    info: str
    frame: str
    encoding: str = '32FC1'
    nothing: float = np.inf
    best_effort: bool = False
    stamped: bool = True
    keeps: int = 10
    focal: float | None = None


SIMULATORS = {
    'gazebo': Simulator(
        '/rgbd_camera/depth_image', '/rgbd_camera/camera_info', 'go2/base/rgbd_camera'
    ),
    'isaac_sim': Simulator('/depth', '/camera_info', 'sim_camera', best_effort=True),
    'webots': Simulator(
        '/robot/range_finder', '/robot/range_finder/camera_info', 'range_finder', stamped=False
    ),
    'realsense': Simulator(
        '/camera/depth/image_rect_raw',
        '/camera/depth/camera_info',
        'camera_depth_optical_frame',
        encoding='16UC1',
        nothing=0.0,
        best_effort=True,
    ),
    # camera_plugin.cpp of mujoco_ros2_control, commit bda2b67: focal length of fovy, zfar of 50.
    'mujoco_ros2_control': Simulator(
        '/flexx2/depth',
        '/flexx2/camera_info',
        'flexx2_optical_frame',
        nothing=50.0,
        keeps=1,
        focal=LENS.height / 2 / math.tan(math.radians(44.5) / 2),
    ),
}


def scene(fx=LENS.fx, cx=LENS.cx):
    """Return (H, W) metres: a tilted board before nothing."""
    depth = np.full((LENS.height, LENS.width), np.nan, np.float32)
    u = np.arange(LENS.width)
    depth[20:150] = 1.5 / (1 + 0.2 * (u - cx) / fx)
    depth[:, 190:] = np.nan
    return depth


def bag(path, simulator):
    """Write what the simulator publishes from its start on."""
    pixels, matrix = scene(), LENS.matrix
    if simulator.focal:
        pixels = scene(simulator.focal)
        matrix = np.diag([simulator.focal, simulator.focal, 1.0])
        matrix[:2, 2] = LENS.width / 2, LENS.height / 2
    if simulator.encoding == '16UC1':
        pixels = np.rint(1000 * pixels)
    pixels = np.where(np.isnan(pixels), simulator.nothing, pixels)
    pixels = pixels.astype('<u2' if simulator.encoding == '16UC1' else '<f4')
    entries = []
    for index in range(COUNT):
        stamp = index * 1_000_000_000 // RATE
        given = stamp if simulator.stamped else 0
        topic, kind, _, message = info(simulator.info, given, pixels.shape, matrix, np.zeros(5))
        entries.append((topic, kind, stamp, message))
        entries.append(image(simulator.depth, stamp, pixels, simulator.encoding))
        for _, _, _, message in entries[-2:]:
            message.header.frame_id = simulator.frame
    return write(path, entries)


def documented(simulator):
    """Return the arguments of the command on the page that remaps to the simulator's topics."""
    commands = re.findall(
        r'^ros2 run flexx2_sim_ros flexx2_camera ((?:.*\\\n)*.*)$', PAGE.read_text(), re.M
    )
    (found,) = [one for one in commands if f':={simulator.depth} ' in f'{one} ']
    return shlex.split(found.replace('\\\n', ' '))


def publish_all(listener, path, simulator, heard):
    """Publish the bag byte by byte; each image again until the node has answered it."""
    reliability = (
        ReliabilityPolicy.BEST_EFFORT if simulator.best_effort else ReliabilityPolicy.RELIABLE
    )
    qos = QoSProfile(depth=simulator.keeps, reliability=reliability)
    publishers = {
        topic: listener.node.create_publisher(kind, topic, qos)
        for topic, kind in ((simulator.info, CameraInfo), (simulator.depth, Image))
    }
    for topic, publisher in publishers.items():
        listener.spin_until(publisher.get_subscription_count, f'the node at {topic}')
    with Reader(path) as reader:
        messages = [(connection.topic, bytes(data)) for connection, _, data in reader.messages()]
    for index in range(COUNT):
        due = 0.0

        def answered(index=index):
            nonlocal due
            if time.monotonic() >= due:
                for topic, data in messages[2 * index : 2 * index + 2]:
                    publishers[topic].publish(data)
                due = time.monotonic() + AGAIN_SECONDS
            return len({nanoseconds(message) for message in heard}) > index

        listener.spin_until(answered, f'image {index}')


@pytest.mark.parametrize('name', SIMULATORS)
def test_a_simulators_messages_become_frames(name, child_env, tmp_path):
    simulator = SIMULATORS[name]
    path = bag(tmp_path / 'bag', simulator)
    space = f'/as_{name}'
    words = [*documented(simulator), '-r', f'__ns:={space}', '-p', f'usecase:={USECASE}']
    command = [sys.executable, '-m', 'flexx2_sim_ros.nodes.flexx2_camera', *words]
    with listening() as listener, started(command, env=child_env, stdout=None, stderr=None):
        heard = listener.listen(f'{space}/flexx2_camera/depth_image_0', Image)
        publish_all(listener, path, simulator, heard)
    frames = {nanoseconds(message): message for message in heard}
    assert sorted(frames) == [index * 1_000_000_000 // RATE for index in range(COUNT)]
    assert {message.header.frame_id for message in heard} == {simulator.frame}
    noisy = np.stack([array_of(frames[stamp]) for stamp in sorted(frames)])
    # Where camera infos count from the corner, each ray shows what is half a pixel beside it.
    clean = scene(cx=LENS.cx - LENS.fx / simulator.focal / 2) if simulator.focal else scene()
    assert np.isnan(noisy[:, :15]).all()
    assert np.isnan(noisy[:, :, 200:]).all()
    assert np.isfinite(noisy[:, 30:140, 20:180]).all()
    there = np.broadcast_to(clean, noisy.shape)
    assert np.nanmedian((noisy - there)[:, 30:140, 20:180]) == pytest.approx(0, abs=5e-4)
    assert_noise_is_sigma(there, noisy, LENS, USECASE)
