"""The node of `flexx2 view`: finds cameras, pairs frames, sets modes, drives the robot."""

from collections import deque
from collections.abc import Callable, Sequence
import json
import statistics
import time
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.decoding import decode_camera_info, decode_image, stamp_nanoseconds
from flexx2_sim_ros.nodes.gating import RateMeter
from flexx2_sim_ros.nodes.runtime import Throttle
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording.bag_cameras import CameraTopics, EVENTS, find_cameras
from flexx2_sim_ros.view.driving import Driving, Velocity
from flexx2_sim_ros.view.packing import ViewedFrame
from geometry_msgs.msg import Twist
import numpy as np
from rcl_interfaces.msg import ParameterEvent, ParameterValue, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

# Largest velocities that the page may request: m/s and rad/s.
_FASTEST = (1.2, 1.2, 2.5)
_STALE_SECONDS = 1.0
_ANSWER_SECONDS = 3.0
_LOOK_SECONDS = 0.5
_STATUS_SECONDS = 0.25
_KEPT = 30
_ENCODINGS = ('32FC1', '64FC1', '16UC1')


class _Camera:
    # The state of one camera, and its subscriptions while a page is open.

    def __init__(self, node: Node, topics: CameraTopics, show: Callable[[], None]) -> None:
        self.topics = topics
        self.client = AsyncParameterClient(node, topics.node)
        self.usecase, self.usecases = '', list[str]()
        self.answer: dict[str, Any] = {}
        self.answer_by: float | None = None
        self.asked: Any = None
        self.shot: ViewedFrame | None = None
        self._node, self._show = node, show
        self._radial = False
        self._listening: list[Any] = []
        self.forget()

    def forget(self) -> None:
        """Discard all measurements."""
        self.clean_rate, self.rate = RateMeter(), RateMeter()
        self._latencies: deque[int] = deque(maxlen=120)
        self._clean: dict[int, tuple[int, Image]] = {}
        self._last_clean = self._last = 0
        self._problem = ''
        self._info: CameraInfo | None = None
        self._clean_info: CameraInfo | None = None
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
                self._node.create_subscription(kind, topic, callback, qos_profile_sensor_data)
                for kind, topic, callback in (
                    (CameraInfo, topics.info, self._on_info),
                    (CameraInfo, topics.clean_info, self._on_clean_info),
                    (Image, topics.clean, self._on_clean),
                    (Image, topics.depth, self._on_depth),
                )
            ]

    def ask(self) -> None:
        """Ask the camera's node for its mode, until it has answered."""
        if self.asked is None and self.client.services_are_ready():
            self.asked = self.client.get_parameters(['usecase', 'available_usecases'])
            self.asked.add_done_callback(self._on_modes)
            # In its own request: the real driver does not have this parameter and would return no
            # values.
            self.client.get_parameters(['input_depth']).add_done_callback(self._on_input)

    def _on_modes(self, future: Any) -> None:
        # Another node may have parameters of these names with other types.
        values = [parameter_value_to_python(value) for value in future.result().values]
        match values:
            case [str(usecase), [str(), *_] as usecases] if usecase:
                self.usecase, self.usecases = usecase, usecases

    def _on_input(self, future: Any) -> None:
        for value in future.result().values:
            self.take_input(value)

    def take_input(self, value: ParameterValue) -> None:
        """Set how clean depth is interpreted, from a value of the parameter ``input_depth``."""
        self._radial = parameter_value_to_python(value) == 'radial'

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message

    def _on_clean_info(self, message: CameraInfo) -> None:
        self._clean_info = message

    def _on_clean(self, message: Image) -> None:
        now = time.monotonic_ns()
        self._last_clean = _meter(self.clean_rate, self._last_clean, now)
        self._clean[stamp_nanoseconds(message.header.stamp)] = now, message
        while len(self._clean) > _KEPT:
            del self._clean[next(iter(self._clean))]

    def _on_depth(self, message: Image) -> None:
        now = time.monotonic_ns()
        self._last = _meter(self.rate, self._last, now)
        stamp = stamp_nanoseconds(message.header.stamp)
        came, clean = self._clean.get(stamp, (now, None))
        if clean is not None:
            self._latencies.append(now - came)
        try:
            if self._info is None:
                raise InputError(f'{self.topics.info}: must come with the depth images, got none')
            camera = decode_camera_info(self._info, self.topics.info)
            depth = decode_image(message, self.topics.depth, _ENCODINGS)
            if depth.shape != (camera.height, camera.width):
                raise InputError(f'{self.topics.info}: must have the size of the image')
            sequence = 0 if self.shot is None else self.shot.sequence + 1
            self.shot = ViewedFrame(sequence, stamp, depth, self._cleaned(clean, camera), camera)
            self._problem = ''
        except InputError as error:
            self._problem = str(error)
        self._show()

    def _cleaned(self, message: Image | None, camera: Intrinsics) -> Any:
        # Clean depth at the camera's pixels, along its optical axis.
        if message is None or self._clean_info is None:
            return None
        source = decode_camera_info(self._clean_info, self.topics.clean_info)
        image = decode_image(message, self.topics.clean, _ENCODINGS)
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


class Viewer(Node):
    """
    What the page's server shows: a `flexx2_sim_ros.view.server.Source`.

    Cameras are found by their topics, including cameras that appear later. They are subscribed to
    only while a page is open. Subscriptions are best effort: viewers never block the stream.

    Parameters
    ----------
    cameras : sequence of str
        Only these, by name (namespace) or node; all when empty.
    drive_topic : str
        Where to publish ``geometry_msgs/Twist``.

    Attributes
    ----------
    shots, status
        As in `Source`.
    wake : callable
        Called when `shots` or `status` has changed.

    """

    def __init__(self, cameras: Sequence[str], drive_topic: str) -> None:
        """Look for cameras now and every half second."""
        super().__init__('flexx2_view', start_parameter_services=False)
        self.shots: dict[str, ViewedFrame] = {}
        self.status = '{}'
        self.wake: Callable[[], None] = lambda: None
        self._wanted = {name.strip('/') for name in cameras}
        self._cameras: dict[str, _Camera] = {}
        self._watched = False
        self._throttle = Throttle()
        self._twist = self.create_publisher(Twist, drive_topic, 10)
        self._driving = Driving(self._publish)
        # Requests of the server's thread are handled in this node's; only the newest is kept.
        self._watch_asked = False
        self._chosen: dict[str, str] = {}
        self._guard = self.create_guard_condition(self._work)
        self.create_subscription(ParameterEvent, EVENTS, self._on_event, 100)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_SECONDS, self._look, clock=steady)
        self.create_timer(_STATUS_SECONDS, self._tell, clock=steady)
        self._look()

    def watch(self, watched: bool) -> None:
        """Start or stop receiving frames."""
        self._watch_asked = watched
        self._guard.trigger()

    def drive(self, page: object, velocity: Velocity) -> bool:
        """Drive (see `Driving.drive`); does not wait for this node's executor."""
        return self._driving.drive(page, velocity)

    def leave(self, page: object) -> None:
        """Stop the robot if this page drives it."""
        self._driving.leave(page)

    def choose(self, camera: str, usecase: str) -> None:
        """Request a mode of a camera; a later request replaces one that was not sent yet."""
        if camera in self._cameras:
            self._chosen[camera] = usecase
            self._guard.trigger()

    def complain(self, text: str) -> None:
        """Log a problem of a page, at a limited rate."""
        if self._throttle.ready('page'):
            self.get_logger().warning(text)

    def destroy_node(self) -> None:
        """Stop the robot, then close the node."""
        self._driving.close()
        super().destroy_node()

    def _work(self) -> None:
        if self._watch_asked != self._watched:
            self._watch(self._watch_asked)
        for name in list(self._chosen):
            # One request at a time, so that requests to a silent node do not pile up.
            if self._cameras[name].answer_by is None:
                self._choose(name, self._chosen.pop(name))

    def _look(self) -> None:
        there = {
            topic: kinds[0] for topic, kinds in self.get_topic_names_and_types() if len(kinds) == 1
        }
        for topics in find_cameras(there).values():
            names = {topics.name.strip('/'), topics.node.strip('/')}
            if (
                topics.name not in self._cameras
                and (not self._wanted or self._wanted & names)
                and self.count_publishers(topics.depth)
            ):
                self._cameras[topics.name] = _Camera(self, topics, self._show)
                self._cameras[topics.name].listen(self._watched)
        for camera in self._cameras.values():
            if not camera.usecases:
                camera.ask()

    def _watch(self, watched: bool) -> None:
        self._watched = watched
        for camera in self._cameras.values():
            camera.listen(watched)
        self._show()
        self._tell()

    def _show(self) -> None:
        self.shots = {
            name: camera.shot for name, camera in self._cameras.items() if camera.shot is not None
        }
        self.wake()

    def _tell(self) -> None:
        now = time.monotonic()
        for camera in self._cameras.values():
            if camera.answer_by is not None and now > camera.answer_by:
                self._answer(camera, False, f'no answer within {_ANSWER_SECONDS:g} s')
        self.status = json.dumps(
            {
                'cameras': [camera.status() for _, camera in sorted(self._cameras.items())],
                'drive': {
                    'topic': self._twist.topic_name,
                    'listeners': self._twist.get_subscription_count(),
                },
            }
        )
        self.wake()

    def _on_event(self, event: ParameterEvent) -> None:
        for camera in self._cameras.values():
            if event.node != camera.topics.node:
                continue
            if event.new_parameters:  # The node was restarted.
                camera.usecases, camera.asked = [], None
            for parameter in event.changed_parameters:
                if parameter.name == 'usecase':
                    camera.usecase = parameter.value.string_value
                    camera.rate.clear()
                    self._tell()
                elif parameter.name == 'input_depth':
                    camera.take_input(parameter.value)

    def _choose(self, name: str, usecase: str) -> None:
        camera = self._cameras[name]
        if not camera.client.services_are_ready():
            self._answer(camera, False, f'{camera.topics.node} is not there')
            return
        camera.answer_by = time.monotonic() + _ANSWER_SECONDS

        def answered(future: Any) -> None:
            result = next(iter(future.result().results), SetParametersResult())
            text = f'{usecase} is set' if result.successful else result.reason
            self._answer(camera, result.successful, text or f'{usecase} was refused')
            self._tell()

        camera.client.set_parameters([Parameter('usecase', value=usecase)]).add_done_callback(
            answered
        )

    def _answer(self, camera: _Camera, successful: bool, text: str) -> None:
        camera.answer_by = None
        camera.answer = {
            'number': camera.answer.get('number', 0) + 1,
            'ok': successful,
            'text': text,
        }
        self._guard.trigger()

    def _publish(self, velocity: Velocity) -> None:
        x, y, turn = (
            max(-most, min(most, value)) for value, most in zip(velocity, _FASTEST, strict=True)
        )
        message = Twist()
        message.linear.x, message.linear.y, message.angular.z = x, y, turn
        if self.context.ok():
            self._twist.publish(message)


def _meter(meter: RateMeter, last: int, now: int) -> int:
    # After a pause, only messages since then count.
    if now - last > _STALE_SECONDS * 1e9:
        meter.clear()
    meter.add(now)
    return now
