"""Messages as other simulators send them, through a node with the documented remaps."""

from dataclasses import dataclass
import math
from pathlib import Path
import re
import shlex
import time

from flexx2_sim_ros.camera import flexx2, Intrinsics
from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_images import array_of, image_message, info_message, nanoseconds
from simulators import assert_noise_is_sigma
from streams import CameraInfo, Image, listening

pytestmark = pytest.mark.usefixtures('ros')
PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'nodes.md'
LENS, USECASE, COUNT = flexx2().intrinsics, 'Mode_5_30fps', 8
PERIOD = 33_333_334  # nanoseconds
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


def messages_of(simulator, index):
    """Return one image of a simulator and its camera info."""
    pixels, lens = scene(), LENS
    if simulator.focal:
        height, width = pixels.shape
        pixels = scene(simulator.focal)
        lens = Intrinsics(width, height, simulator.focal, simulator.focal, width / 2, height / 2)
    pixels = np.where(np.isnan(pixels), simulator.nothing, pixels)
    stamp, encoding = index * PERIOD, simulator.encoding
    return (
        info_message(lens, stamp if simulator.stamped else 0, simulator.frame),
        image_message(pixels, stamp, encoding=encoding, frame_id=simulator.frame),
    )


def documented(simulator):
    """Return the arguments of the command on the page that remaps to the simulator's topics."""
    commands = re.findall(
        r'^ros2 run flexx2_sim_ros flexx2_camera ((?:.*\\\n)*.*)$', PAGE.read_text(), re.M
    )
    (found,) = [one for one in commands if f':={simulator.depth} ' in f'{one} ']
    return shlex.split(found.replace('\\\n', ' '))


def publish_all(listener, simulator, heard):
    """Publish all messages; each image again until the node has answered it."""
    reliable = not simulator.best_effort
    qos = QoSProfile(
        depth=simulator.keeps,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )
    publishers = [
        listener.node.create_publisher(kind, topic, qos)
        for topic, kind in ((simulator.info, CameraInfo), (simulator.depth, Image))
    ]
    for publisher in publishers:
        listener.spin_until(publisher.get_subscription_count, publisher.topic_name)
    for index in range(COUNT):
        messages, due = messages_of(simulator, index), 0.0

        def answered(messages=messages, index=index):
            nonlocal due
            if time.monotonic() >= due:
                for publisher, message in zip(publishers, messages, strict=True):
                    publisher.publish(message)
                due = time.monotonic() + AGAIN_SECONDS
            return len({nanoseconds(message) for message in heard}) > index

        listener.spin_until(answered, f'image {index}')


@pytest.mark.parametrize('name', SIMULATORS)
def test_a_simulators_messages_become_frames(name):
    simulator, space = SIMULATORS[name], f'/as_{name}'
    words = [*documented(simulator), '-r', f'__ns:={space}', '-p', f'usecase:={USECASE}']
    with listening() as listener:
        node = Flexx2Camera(cli_args=words)
        listener.add(node)
        heard = listener.listen(f'{space}/flexx2_camera/depth_image_0', Image)
        publish_all(listener, simulator, heard)
    node.destroy_node()
    frames = {nanoseconds(message): message for message in heard}
    assert sorted(frames) == [index * PERIOD for index in range(COUNT)]
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
