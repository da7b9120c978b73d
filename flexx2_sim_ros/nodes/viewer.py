"""The node of `flexx2 view`: finds cameras, pairs frames, sets modes, drives the robot."""

from collections.abc import Callable, Sequence
import json
import time
from typing import Any

from flexx2_sim_ros.nodes.runtime import Throttle
from flexx2_sim_ros.nodes.viewed_camera import strength_of, ViewedCamera
from flexx2_sim_ros.recording.bag_cameras import EVENTS, find_cameras, INPUTS
from flexx2_sim_ros.view.driving import Driving, Velocity
from flexx2_sim_ros.view.packing import ViewedFrame
from geometry_msgs.msg import Twist
from rcl_interfaces.msg import ParameterEvent, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

# Largest velocities that the page may request: m/s and rad/s.
_FASTEST = (1.2, 1.2, 2.5)
_ANSWER_SECONDS = 3.0
_LOOK_SECONDS = 0.5
_STATUS_SECONDS = 0.25


class Viewer(Node):
    """
    What the page's server shows: a `flexx2_sim_ros.view.server.Source`.

    Cameras are found by their topics, including cameras that appear later. They are subscribed to
    only while a page is open. Subscriptions are best effort: viewers never block the stream.
    ``cameras`` are the only ones, by name (namespace) or node; all when empty. ``drive_topic`` is
    where to publish ``geometry_msgs/Twist``. ``wake`` is called when `shots` or `status` has
    changed.
    """

    def __init__(self, cameras: Sequence[str], drive_topic: str) -> None:
        """Look for cameras now and every half second."""
        super().__init__('flexx2_view', start_parameter_services=False)
        self.shots: dict[str, ViewedFrame] = {}
        self.status = '{}'
        self.wake: Callable[[], None] = lambda: None
        self._wanted = {name.strip('/') for name in cameras}
        self._cameras: dict[str, ViewedCamera] = {}
        self._watched = False
        self._throttle = Throttle()
        self._twist = self.create_publisher(Twist, drive_topic, 10)
        self._driving = Driving(self._publish)
        # Requests of the server's thread are handled in this node's; only the newest is kept.
        self._watch_asked = False
        self._chosen: dict[tuple[str, str], str | float] = {}
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
        self._ask(camera, 'usecase', usecase)

    def adjust(self, camera: str, effect: str, strength: float) -> None:
        """Request the strength of an effect of a camera, in the same way."""
        if camera in self._cameras and effect in self._cameras[camera].strengths:
            self._ask(camera, strength_of(effect), strength)

    def _ask(self, camera: str, parameter: str, value: str | float) -> None:
        if camera in self._cameras:
            self._chosen[camera, parameter] = value
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
        for name, parameter in list(self._chosen):
            # One request at a time, so that requests to a silent node do not pile up.
            if self._cameras[name].answer_by is None:
                self._set(name, parameter, self._chosen.pop((name, parameter)))

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
                self._cameras[topics.name] = ViewedCamera(self, topics, self._show)
                self._cameras[topics.name].listen(self._watched)
        for camera in self._cameras.values():
            camera.follow()
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
                camera.ask_at = 0.0
            for parameter in event.changed_parameters:
                if parameter.name == 'usecase':
                    camera.usecase = parameter.value.string_value
                    camera.rate.clear()
                    self._tell()
                elif parameter.name in INPUTS:
                    camera.take_input(parameter.name, parameter.value)
                else:
                    camera.take_strength(parameter.name, parameter.value)

    def _set(self, name: str, parameter: str, value: str | float) -> None:
        camera = self._cameras[name]
        if not camera.client.services_are_ready():
            self._answer(camera, False, f'{camera.topics.node} is not there')
            return
        camera.answer_by = time.monotonic() + _ANSWER_SECONDS

        def answered(future: Any) -> None:
            result = next(iter(future.result().results), SetParametersResult())
            what = value if isinstance(value, str) else f'{parameter} {value:g}'
            text = f'{what} is set' if result.successful else result.reason
            self._answer(camera, result.successful, text or f'{what} was refused')
            self._tell()

        camera.client.set_parameters([Parameter(parameter, value=value)]).add_done_callback(
            answered
        )

    def _answer(self, camera: ViewedCamera, successful: bool, text: str) -> None:
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
