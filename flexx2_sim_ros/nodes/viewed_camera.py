"""A camera that `flexx2 view` shows: its frames, rates, mode and effects."""

from collections import deque
from collections.abc import Callable
from functools import partial
import math
import statistics
import time
from typing import Any

from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.camera_info import decode_camera_info, is_rectified
from flexx2_sim_ros.messages.decoding import decode_image, stamp_nanoseconds
from flexx2_sim_ros.nodes.pacing import RateMeter
from flexx2_sim_ros.nodes.ros_graph import remapped
from flexx2_sim_ros.nodes.subscriptions import matching
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording.bag_cameras import CameraTopics, INPUTS
from flexx2_sim_ros.view.packing import ViewedFrame
import numpy as np
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import CameraInfo, Image

_STALE_SECONDS = 1.0
# ROS loses an answer that comes before the two nodes have found each other.
_ASK_SECONDS = 1.0
# Clean images wait for those of the camera, which `time_offset` makes at most 4 s late.
_KEPT_SECONDS, _KEPT_BYTES = 5.0, 64e6
_ENCODINGS = ('32FC1', '64FC1', '16UC1')
_EFFECT, _STRENGTH = 'effect.', '.strength'


def strength_of(effect: str) -> str:
    """Return the name of the parameter that holds the strength of an effect."""
    return f'{_EFFECT}{effect}{_STRENGTH}'


class ViewedCamera:
    """The state of one camera, and its subscriptions while a page is open."""

    def __init__(self, node: Node, topics: CameraTopics, show: Callable[[], None]) -> None:
        """Make a client of the camera's parameters; `show` is called for each frame."""
        self.topics = topics
        self.client = AsyncParameterClient(node, topics.node)
        self.usecase, self.usecases = '', list[str]()
        self.strengths: dict[str, float] = {}
        self.answer: dict[str, Any] = {}
        self.answer_by: float | None = None
        self.ask_at = 0.0  # in monotonic time
        self.shot: ViewedFrame | None = None
        self._node, self._show = node, show
        self._radial = False
        self._rectified: bool | None = None  # None: the name of the topic says it
        # Kept while no page is open: a simulator may send it once.
        self._clean_info: CameraInfo | None = None
        self._listening: list[Any] = []
        self.forget()

    def forget(self) -> None:
        """Discard all measurements."""
        self.clean_rate, self.rate = RateMeter(), RateMeter()
        self._latencies: deque[int] = deque(maxlen=120)
        self._clean: dict[int, tuple[int, Image]] = {}
        self._last_clean = self._last = self._first_clean = 0
        self._problem = ''
        self._info: CameraInfo | None = None
        self._view: Reprojection | None = None

    def listen(self, wanted: bool) -> None:
        """Subscribe or unsubscribe."""
        if wanted == bool(self._listening):
            return
        for subscription in self._listening:
            self._node.destroy_subscription(subscription)
        self._listening, self.shot = [], None
        self.forget()
        if wanted:
            topics = self.topics
            self._listening = [
                self._node.create_subscription(kind, topic, callback, self._quality(topic))
                for kind, topic, callback in (
                    (CameraInfo, topics.info, self._on_info),
                    (CameraInfo, topics.clean_info, self._on_clean_info),
                    (Image, topics.clean, self._on_clean),
                    (Image, topics.depth, self._on_depth),
                )
            ]

    def follow(self) -> None:
        """Subscribe anew if the camera's node subscribes to other clean images than known."""
        topics = remapped(self._node, self.topics)
        if topics != self.topics:
            watched = bool(self._listening)
            self.listen(False)
            self.topics = topics
            self.listen(watched)

    def _quality(self, topic: str) -> QoSProfile:
        # What was sent before the page was open comes only to a reliable, latched subscription.
        offers = self._node.get_publishers_info_by_topic(topic)
        reliability, durability = matching([offer.qos_profile for offer in offers])
        if durability != DurabilityPolicy.TRANSIENT_LOCAL:
            return qos_profile_sensor_data
        return QoSProfile(depth=1, reliability=reliability, durability=durability)

    def ask(self) -> None:
        """Ask the camera's node for its mode, until it has answered."""
        if time.monotonic() >= self.ask_at and self.client.services_are_ready():
            self.ask_at = time.monotonic() + _ASK_SECONDS
            asked = self.client.get_parameters(['usecase', 'available_usecases'])
            asked.add_done_callback(self._on_modes)
            # In requests of their own: the real driver does not have these parameters and would
            # return no values.
            for name in INPUTS:
                self.client.get_parameters([name]).add_done_callback(partial(self._on_input, name))
            self.client.list_parameters(['effect']).add_done_callback(self._on_listed)

    def _on_modes(self, future: Any) -> None:
        self.ask_at = math.inf
        # Another node may have parameters of these names with other types; their texts are empty.
        match future.result().values:
            case [usecase, usecases] if usecase.string_value and usecases.string_array_value:
                self.usecase = usecase.string_value
                self.usecases = list(usecases.string_array_value)

    def _on_input(self, name: str, future: Any) -> None:
        for value in future.result().values:
            self.take_input(name, value)

    def _on_listed(self, future: Any) -> None:
        # Only effects that the node has: for a request with any other it returns no values.
        there = set(future.result().result.names)
        names = [name for effect in registry() if (name := strength_of(effect)) in there]

        def take(values: Any) -> None:
            for name, value in zip(names, values.result().values, strict=False):
                self.take_strength(name, value)

        if names:
            self.client.get_parameters(names).add_done_callback(take)

    def take_strength(self, parameter: str, value: ParameterValue) -> None:
        """Note the strength of an effect, if this is a parameter of one."""
        effect = parameter.removeprefix(_EFFECT).removesuffix(_STRENGTH)
        if (
            parameter == strength_of(effect)
            and effect in registry()
            and value.type == ParameterType.PARAMETER_DOUBLE
        ):
            self.strengths[effect] = value.double_value

    def take_input(self, name: str, value: ParameterValue) -> None:
        """Set how clean depth is interpreted, from a value of a parameter of `INPUTS`."""
        if name == 'input_depth':
            self._radial = value.string_value == 'radial'
        else:
            self._rectified = {'raw': False, 'rectified': True}.get(value.string_value)

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message

    def _on_clean_info(self, message: CameraInfo) -> None:
        self._clean_info = message

    def _on_clean(self, message: Image) -> None:
        now = time.monotonic_ns()
        self._last_clean = _meter(self.clean_rate, self._last_clean, now)
        self._first_clean = self._first_clean or now
        self._clean[stamp_nanoseconds(message.header.stamp)] = now, message
        size = sum(len(image.data) for _, image in self._clean.values())
        for stamp, (came, image) in list(self._clean.items()):
            if size <= _KEPT_BYTES and now - came <= _KEPT_SECONDS * 1e9:
                break
            size -= len(image.data)
            del self._clean[stamp]

    def _on_depth(self, message: Image) -> None:
        now = time.monotonic_ns()
        if now - self._last > _STALE_SECONDS * 1e9:
            self._latencies.clear()
        self._last = _meter(self.rate, self._last, now)
        stamp = stamp_nanoseconds(message.header.stamp)
        came, clean = self._clean.get(stamp, (now, None))
        if clean is not None:
            self._latencies.append(now - came)
        try:
            if self._info is None:
                raise InputError(f'{self.topics.info}: must come with the depth images, got none')
            depth = decode_image(message, self.topics.depth, _ENCODINGS)
            camera = decode_camera_info(
                self._info, self.topics.info, depth.shape, is_rectified(self.topics.depth)
            )
            if depth.shape != (camera.height, camera.width):
                raise InputError(
                    f'{self.topics.info}: must have the height and width of the image, '
                    f'{depth.shape}, got {(camera.height, camera.width)}'
                )
            sequence = 0 if self.shot is None else self.shot.sequence + 1
            self.shot = ViewedFrame(sequence, stamp, depth, self._cleaned(clean, camera), camera)
            self._problem = ''
            waited = now - self._first_clean > _STALE_SECONDS * 1e9
            if clean is not None and self._clean_info is None and waited:
                raise InputError(
                    f'{self.topics.clean_info}: must come with {self.topics.clean}, got none'
                )
        except InputError as error:
            self._problem = str(error)
        self._show()

    def _cleaned(self, message: Image | None, camera: Intrinsics) -> Any:
        # Clean depth at the camera's pixels, along its optical axis.
        if message is None or self._clean_info is None:
            return None
        image = decode_image(message, self.topics.clean, _ENCODINGS)
        rectified = is_rectified(self.topics.clean) if self._rectified is None else self._rectified
        source = decode_camera_info(
            self._clean_info, self.topics.clean_info, image.shape, rectified
        )
        if image.shape != (source.height, source.width):
            return None
        if source == camera and not self._radial:
            return image
        view = self._view
        if (
            view is None
            or (view.source, view.camera) != (source, camera)
            or view.radial != self._radial
        ):
            view = self._view = Reprojection(camera, source, self._radial)
        return np.where(view.outside, np.float32(0), view.depth(image))

    def status(self) -> dict[str, Any]:
        """Return the values that the page shows beside the images."""
        age = (time.monotonic_ns() - self._last) / 1e9 if self._last else None
        clean_age = (time.monotonic_ns() - self._last_clean) / 1e9
        stale = age is None or age > _STALE_SECONDS
        problem = self._problem
        if age is None and self._listening:
            problem = problem or f'nothing has come on {self.topics.depth}'
        elif stale and age is not None:
            problem = f'no image for {age:.0f} s'
        return {
            'name': self.topics.name,
            'node': self.topics.node,
            'usecase': self.usecase,
            'usecases': self.usecases,
            'strengths': self.strengths,
            'clean_hz': round(self.clean_rate.hz if clean_age < _STALE_SECONDS else 0.0, 2),
            'hz': round(0.0 if stale else self.rate.hz, 2),
            'latency_ms': (
                round(statistics.median(self._latencies) / 1e6, 2)
                if self._latencies and not stale
                else None
            ),
            'invalid': None if self.shot is None else round(self.shot.invalid_fraction, 4),
            'stale': stale,
            'problem': problem,
            'answer': self.answer,
        }


def _meter(meter: RateMeter, last: int, now: int) -> int:
    # After a pause, only messages since then count.
    if now - last > _STALE_SECONDS * 1e9:
        meter.clear()
    meter.add(now)
    return now
