"""A camera node in this process, what feeds it, and what listens to it, over real DDS."""

from contextlib import closing
import itertools
import time
import unittest

try:
    import rclpy  # noqa: F401
except ImportError as error:
    raise unittest.SkipTest('ROS 2 is not installed: rclpy cannot be imported') from error

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np
from rcl_interfaces.msg import Log
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_images import array_of, image_message, info_message, nanoseconds
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField

__all__ = ['Clock', 'DiagnosticStatus', 'PointField', 'nanoseconds']

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
INPUT_HZ = 240
# Four boards facing the camera: their depths, and the columns away from their edges.
BOARDS = {1.5: slice(12, 44), 3.0: slice(68, 100), 8.0: slice(124, 156), 0.05: slice(180, 212)}

FLEXX2 = flexx2().intrinsics
WHITE = flexx2().sensor.full_scale_amplitude
DEPTH, INFO, CLOUD = 'depth_image_0', 'camera_info', 'point_cloud_0'
GRAY, NOISE = 'gray_image_0', 'depth_noise_0'
SMALL, SMALL_INFO = 'processed/depth_image', 'processed/camera_info'
OUTPUTS = {DEPTH: Image, INFO: CameraInfo, CLOUD: PointCloud2, GRAY: Image, NOISE: Image}
OUTPUTS |= {SMALL: Image, SMALL_INFO: CameraInfo}

# Conditions are met in milliseconds; this is for a machine that is busy with something else.
_PATIENCE = 60.0
_numbers = itertools.count()


class Listener:
    """
    A user of the topics: subscribes, publishes, sets parameters, and waits.

    * `node`: to subscribe and publish with
    * `heard`: messages by topic, for what `listen` was called with
    * `log`: what all nodes logged
    """

    def __init__(self):
        """Join the graph."""
        self.node = Node(f'user_{next(_numbers)}')
        self.heard = {}
        self.log = []
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._subscriptions = {}
        self.node.create_subscription(
            Log,
            '/rosout',
            self.log.append,
            QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )

    def add(self, node):
        """Let a node under test run in this executor."""
        self._executor.add_node(node)

    def spin_until(self, condition, what='condition'):
        """Handle messages until the condition holds; fail when it does not in time."""
        deadline = time.monotonic() + _PATIENCE
        while not condition():
            left = deadline - time.monotonic()
            assert left > 0, f'{what}: did not come about within {_PATIENCE} s'
            self._executor.spin_once(timeout_sec=min(left, 0.05))

    def spin_for_a_message(self):
        """Handle what comes next, or nothing after a while."""
        self._executor.spin_once(timeout_sec=0.02)

    def listen(self, topic, kind):
        """Subscribe and wait for the publisher; return the list that will fill."""
        heard = self.heard[topic] = []
        subscription = self.node.create_subscription(kind, topic, heard.append, 50)
        self._subscriptions[topic] = subscription
        self.spin_until(lambda: subscription.get_publisher_count() > 0, f'publisher of {topic}')
        return heard

    def ignore(self, topic):
        """Unsubscribe."""
        self.node.destroy_subscription(self._subscriptions.pop(topic))
        del self.heard[topic]

    def wait(self, future):
        """Return what a future brings."""
        self.spin_until(future.done, 'answer')
        return future.result()

    def parameters_of(self, node, *names):
        """Return parameters of a node elsewhere, as Python's values."""
        client = AsyncParameterClient(self.node, node)
        self.spin_until(client.services_are_ready, node)
        values = self.wait(client.get_parameters([*names])).values
        return [parameter_value_to_python(value) for value in values]

    def close(self):
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()


def listening():
    """Return a `Listener` that leaves at the end of the block."""
    return closing(Listener())


class NodeUser(Listener):
    """
    A user of the topics and parameters of one node under test.

    * `clients`: of its parameters
    """

    def __init__(self, name, start):
        """Join the graph, to hear all that the node of this full name logs; then start it."""
        super().__init__()
        self._node = start()
        self.add(self._node)
        self.clients = AsyncParameterClient(self.node, name)

    def logged(self, *parts):
        """Return what the node logged with all these parts in it."""
        name = self._node.get_logger().name
        return [
            entry.msg
            for entry in self.log
            if entry.name == name and all(part in entry.msg for part in parts)
        ]

    def set(self, **values):  # noqa: A003
        """Set parameters through the node's service; return the last one's result."""
        self.spin_until(self.clients.services_are_ready, 'parameter services')
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        return self.wait(self.clients.set_parameters(parameters)).results[-1]

    def close(self):
        """Stop the node and leave the graph."""
        super().close()
        self._node.destroy_node()


class Stream(NodeUser):
    """
    A camera node, fed one image at a time: each is answered before the next is sent.

    * `topics`: which of the node's outputs to listen to
    * `source`: of the clean images
    * `namespace`: of the node; one of its own when left out, so that no stream hears another
    * `feed`: whether to publish to the node; somebody else does otherwise
    * `values`: of the node's parameters
    * `camera`: the node under test
    * `name`: its full name
    """

    def __init__(self, *topics, source=FLEXX2, namespace='', feed=True, **values):
        """Start the node and wait until everybody knows everybody."""
        namespace = namespace or f'/stream_{next(_numbers)}'
        self.source = source
        self.name = f'{namespace}/flexx2_camera'
        given = [Parameter(name, value=value) for name, value in values.items()]
        super().__init__(
            self.name, lambda: Flexx2Camera(namespace=namespace, parameter_overrides=given)
        )
        self.camera = self._node
        self._clean = {}
        self._missed = {}
        for topic in topics:
            self.listen_to(topic)
        if feed:
            self._feed(namespace)
        self.spin_until(self.clients.services_are_ready, 'parameter services')

    def _feed(self, namespace):
        self._clean = {
            topic: self.node.create_publisher(kind, f'{namespace}/clean/{topic}', 10)
            for topic, kind in (
                ('depth_image', Image),
                ('camera_info', CameraInfo),
                ('reflectivity', Image),
            )
        }
        self.spin_until(
            lambda: all(publisher.get_subscription_count() for publisher in self._clean.values()),
            'inputs',
        )
        inputs = [
            subscription
            for subscription in self.camera.subscriptions
            if '/clean/' in subscription.topic_name
        ]
        assert len(inputs) == 3
        self.spin_until(
            lambda: all(subscription.get_publisher_count() for subscription in inputs), 'inputs'
        )

    def listen_to(self, topic):
        """Listen to one of the node's outputs."""
        self.listen(f'{self.name}/{topic}', OUTPUTS[topic])
        publisher = next(
            publisher
            for publisher in self.camera.publishers
            if publisher.topic_name == f'{self.name}/{topic}'
        )
        self.spin_until(publisher.get_subscription_count, topic)
        self._missed[topic] = self.published

    @property
    def published(self):
        """How many frames the node has published."""
        return self.camera._statistics.published

    @property
    def answered(self):
        """How many images the node has dealt with, one way or the other."""
        statistics, gate = self.camera._statistics, self.camera._gate
        return statistics.published + statistics.rejected + gate.early + gate.repeats

    def messages(self, topic):
        """Return what has come on one of the node's outputs."""
        return self.heard[f'{self.name}/{topic}']

    def depths(self):
        """Return the depth images that have come."""
        return [array_of(message) for message in self.messages(DEPTH)]

    def publish(self, *, image=None, info=None, reflectivity=None):
        """Send what is given, companions first."""
        for topic, message in (
            ('camera_info', info),
            ('reflectivity', reflectivity),
            ('depth_image', image),
        ):
            if message is not None:
                self._clean[topic].publish(message)

    def settle(self):
        """Wait until all that the node has published has come."""
        self.spin_until(
            lambda: all(
                len(self.messages(topic)) + missed >= self.published
                for topic, missed in self._missed.items()
            ),
            'published frames',
        )

    def send(self, image, info=None, reflectivity=None):
        """Send an image and its companions; say whether it became a frame."""
        answered, published = self.answered, self.published
        self.publish(image=image, info=info, reflectivity=reflectivity)
        self.spin_until(lambda: self.answered > answered, 'answer to an image')
        self.settle()
        return self.published > published

    def show(self, depth, stamp, reflectivity=None, **layout):
        """Send clean depth with its camera info; say whether it became a frame."""
        return self.send(
            image_message(depth, stamp, **layout),
            info_message(self.source, stamp),
            None if reflectivity is None else image_message(reflectivity, stamp),
        )

    def get(self, name):
        """Get a parameter through the node's service."""
        values = self.wait(self.clients.get_parameters([name])).values
        return parameter_value_to_python(values[0])

    def next_diagnostics(self):
        """Wait for the node's next report."""
        heard = self.heard.get('/diagnostics')
        if heard is None:
            heard = self.listen('/diagnostics', DiagnosticArray)
        heard.clear()
        name = self.name.lstrip('/')

        def mine():
            return [
                status
                for array in heard
                for status in array.status
                if status.name.startswith(name)
            ]

        self.spin_until(mine, 'diagnostics')
        return mine()[0]


def stream(*topics, **options):
    """Return a `Stream` that is closed at the end of the block."""
    return closing(Stream(*topics, **options))


def boards():
    """Draw four boards: one in every mode's range, one in some, one too far, one too near."""
    return np.repeat(np.array(list(BOARDS), np.float32), 56)[None].repeat(172, axis=0)


def plane(rays):
    """Return the depth of a slanted plane along rays (x/z, y/z)."""
    return (1.4 / (1.0 + 0.5 * rays[0] + 0.3 * rays[1])).astype(np.float32)


def library(seen, depth, stamp, usecase='', reflectivity=None):
    """Return what the library makes of the same scene."""
    settings = seen.camera.settings
    camera = Camera(usecase or settings.usecase, seed=settings.seed, name=settings.camera_name)
    return camera.capture(depth, settings.intrinsics.matrix, stamp, reflectivity)


def same(one, other):
    """Say whether two images are equal to the last bit, NaN included."""
    return np.array_equal(one, other, equal_nan=True)


def input_stamps(count, hz=INPUT_HZ, start=START):
    """Return stamps of a clock that rounds either way."""
    wobble = np.random.default_rng(count).integers(-1, 2, count)
    return [start + round(i * SECOND / hz) + int(wobble[i]) for i in range(count)]
