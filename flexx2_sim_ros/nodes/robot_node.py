"""The robot node: clean depth of a robot's cameras, rendered with MuJoCo."""

import time
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.nodes.pacing import Pacer
from flexx2_sim_ros.nodes.robot_messages import joint_state, odometry
from flexx2_sim_ros.nodes.robot_motion import Mirroring, RobotMotion, Standing, Walking
from flexx2_sim_ros.nodes.robot_parameters import RobotParameters
from flexx2_sim_ros.nodes.sim_clock import SimClock
from flexx2_sim_ros.nodes.steady_node import SteadyNode, twin_text
from flexx2_sim_ros.nodes.tf_frames import camera_transforms, FramePublisher
from flexx2_sim_ros.physics.geometry import centred
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.rendering.scenes import place_board, reflectivity_table
from flexx2_sim_ros.robots.description import BASE, Link, links_of, poses, urdf
from flexx2_sim_ros.robots.model import build_model
from flexx2_sim_ros.robots.parts import find_parts
from geometry_msgs.msg import TransformStamped
import mujoco
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

_ODOM = 'odom'
_STEADY = ClockType.STEADY_TIME
# A lag of more than this fraction of the time is logged.
_LAG_FRACTION = 0.02
# After a jump of a followed clock, at most this many seconds are simulated.
_CATCH_UP_SECONDS = 0.25


class RobotCameras(SteadyNode):
    """
    A robot with cameras in MuJoCo. The parameter ``robot`` selects it; the default is a Go1.

    For each camera it publishes ``<camera>/clean/depth_image``, ``<camera>/clean/camera_info`` and
    ``<camera>/clean/reflectivity``, with the stamp of the state that they show. It also publishes
    the robot's true ``joint_states``, ``odom`` and frames, ``robot_description`` and ``/clock``.
    The parameter ``motion`` selects what moves the robot: nothing, ``cmd_vel``, or ``odom`` and
    ``joint_states`` of another simulator.
    """

    def __init__(self, **options: Any) -> None:
        """Build the model, open the renderer, then open the topics."""
        super().__init__('go1_cameras', **options)
        self.settings = settings = RobotParameters(self)
        self._intrinsics = centred(find_profile(settings.profile).intrinsics)
        self._model = build_model(
            settings.robot_model,
            settings.scene,
            intrinsics=self._intrinsics,
            robot=settings.robot,
            mounts=settings.mounts,
        )
        self._data = mujoco.MjData(self._model)
        self._parts = find_parts(self._model, settings.robot)
        self._reflectivity = reflectivity_table(self._model)
        try:
            self._renderer = open_renderer(self._model, self._intrinsics, settings.renderer)
        except InputError as error:
            raise InputError(f'renderer: {error}') from error
        for reason in self._renderer.reasons:
            self.get_logger().warning(f'renderer not usable: {reason}')
        self._rendered: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._alone = True
        self._motion = self._make_motion()
        self._place_board()
        self._before = self._data.qpos.copy()
        self._open_topics()
        self._pacer = Pacer(settings.rate)
        self._pacer.restart(settings.number('real_time_factor'))
        self._started, self._warned = time.monotonic(), False
        settings.watch(self._on_change)
        if self._sim_clock is not None and not self._sim_clock.follows:
            self._timer = self.create_timer(
                self._pacer.period, self._work, clock=Clock(clock_type=_STEADY)
            )
        self.create_timer(1.0, self._watch_names, clock=Clock(clock_type=_STEADY))
        self.say_unknown_parameters()
        self._say_hello()

    def _make_motion(self) -> RobotMotion:
        model, data, settings = self._model, self._data, self.settings
        robot = settings.robot
        if settings.motion == 'cmd_vel':
            return Walking(self, model, data, robot, settings.gait())
        if settings.motion == 'external':
            return Mirroring(self, model, data, robot, settings.rate, self._show_external)
        return Standing(model, data, robot)

    def _open_topics(self) -> None:
        overridable = QoSOverridingOptions.with_default_policies()

        def publisher(kind: type, topic: str) -> Any:
            return self.create_publisher(
                kind, topic, QoSProfile(depth=10), qos_overriding_options=overridable
            )

        kinds = {'depth_image': Image, 'camera_info': CameraInfo, 'reflectivity': Image}
        self._topics = {
            mount.name: {
                topic: publisher(kind, f'{mount.name}/clean/{topic}')
                for topic, kind in kinds.items()
            }
            for mount in self.settings.mounts
        }
        self._frames = FramePublisher(self)
        self._base = ''
        self._sim_clock: SimClock | None = None
        self._links: list[Link] = []
        self.create_service(Trigger, '~/reset', self._on_reset)
        if self.settings.motion == 'external':
            return
        # The other simulator publishes the pose, the joints and the time.
        self._sim_clock = SimClock(self, self.settings.publish_clock, self._follow)
        self.settings.follows_clock = self._sim_clock.follows
        self._links = links_of(self._model, self.settings.robot)
        self._description = self.create_publisher(
            String,
            'robot_description',
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        )
        self._description.publish(String(data=urdf(self._model, self._links)))
        self._joint_topic = publisher(JointState, 'joint_states')
        self._odometry_topic = publisher(Odometry, 'odom')
        self._name_base(self._frame(BASE))

    def _say_hello(self) -> None:
        settings = self.settings
        cameras = ', '.join(mount.name for mount in settings.mounts)
        inputs = {'stand': (), 'cmd_vel': ('cmd_vel',), 'external': ('odom', 'joint_states')}[
            settings.motion
        ]
        listens = ', '.join(self.resolve_topic_name(topic) for topic in inputs)
        self.get_logger().info(
            f'{cameras} at {settings.rate:g} Hz, rendered by {self._renderer.backend}; motion '
            f'{settings.motion}' + (f', listening to {listens}' if listens else '')
        )

    def _work(self) -> None:
        if self.settings.paused:
            return
        for _ in range(self._pacer.due()):
            self._step()
        self._watch_pace()

    def _follow(self, now: int) -> None:
        if self.settings.paused:
            return
        tick = self._pacer.tick_at(now)
        least = tick - max(1, int(self.settings.rate * _CATCH_UP_SECONDS))
        if not least <= self._pacer.tick <= tick:
            self._pacer.tick = tick - 1
        while self._pacer.tick < tick:
            self._step()

    def _step(self) -> None:
        # The time of tick k is exactly k / rate: no drift, and no gap when rendering is late.
        last = self._pacer.stamp
        self._pacer.tick += 1
        stamp = self._pacer.stamp
        seconds = (stamp - last) * 1e-9
        self._motion.advance(stamp, seconds)
        self._data.time = stamp * 1e-9
        if self._sim_clock is not None:
            self._sim_clock.publish(stamp)
        self._publish_state(stamp, seconds)
        self._publish_images(stamp)

    def _publish_state(self, stamp: int, seconds: float) -> None:
        position, quaternion = (
            values[self._parts.trunk] for values in (self._data.xpos, self._data.xquat)
        )
        frames = self._frame(_ODOM), self._frame(BASE)
        if self._frames.wanted:
            self._frames.moving(
                [
                    messages.transform(stamp, frames, position, quaternion),
                    *self._link_transforms(stamp, moving=True),
                ]
            )
        wanted = [
            topic.get_subscription_count() > 0
            for topic in (self._joint_topic, self._odometry_topic)
        ]
        if any(wanted):
            velocity = np.zeros(self._model.nv)
            mujoco.mj_differentiatePos(
                self._model, velocity, seconds, self._before, self._data.qpos
            )
            if wanted[0]:
                joints = velocity[self._parts.velocities]
                self._joint_topic.publish(
                    joint_state(stamp, self._parts.joints, self._data.qpos, joints)
                )
            if wanted[1]:
                linear, angular = self._parts.twist(self._data, velocity)
                self._odometry_topic.publish(
                    odometry(stamp, frames, position, quaternion, linear, angular)
                )
        np.copyto(self._before, self._data.qpos)

    def _publish_images(self, stamp: int) -> None:
        for name, topics in self._topics.items():
            head = messages.header(stamp, self._frame(f'{name}_optical_frame'))
            topics['camera_info'].publish(messages.camera_info_message(head, self._intrinsics))
            wanted = {
                topic: topics[topic].get_subscription_count() > 0
                for topic in ('reflectivity', 'depth_image')
            }
            if not any(wanted.values()):
                continue
            depth, reflectivity = self._render(name)
            if wanted['reflectivity']:
                topics['reflectivity'].publish(messages.image_message(head, reflectivity, '32FC1'))
            if wanted['depth_image']:
                topics['depth_image'].publish(messages.image_message(head, depth, '32FC1'))

    def _render(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        # If nothing has moved, the last images are still right.
        state = np.concatenate(
            [self._data.qpos, self._data.mocap_pos.ravel(), self._data.mocap_quat.ravel()]
        )
        last = self._rendered.get(name)
        if last is None or not np.array_equal(last[0], state):
            depth, geom_id = self._renderer.render(self._data, name)
            last = (state, depth.copy(), self._reflectivity[geom_id])
            self._rendered[name] = last
        return last[1], last[2]

    def _show_external(self, stamp: int, frame: str) -> None:
        if not self.settings.paused:
            self._name_base(frame or self._frame(BASE))
            self._publish_images(stamp)

    def _name_base(self, frame: str) -> None:
        if frame != self._base:
            self._base = frame
            self._frames.fixed(
                [
                    *camera_transforms(frame, self.settings.mounts, self.settings.frame_prefix),
                    *self._link_transforms(0, moving=False),
                ]
            )

    def _frame(self, name: str) -> str:
        return f'{self.settings.frame_prefix}{name}'

    def _link_transforms(self, stamp: int, *, moving: bool) -> list[TransformStamped]:
        links = [link for link in self._links if link.moves == moving]
        return [
            messages.transform(stamp, (self._frame(link.parent), self._frame(link.name)), *pose)
            for link, pose in zip(links, poses(links, self._data.qpos), strict=True)
        ]

    def _on_change(self) -> None:
        if self._sim_clock is not None and not self._sim_clock.follows:
            self._pacer.restart(self.settings.number('real_time_factor'))
            self._timer.timer_period_ns = round(self._pacer.period * 1e9)
            self._timer.reset()
            self._started, self._pacer.lag = time.monotonic(), 0.0
        if isinstance(self._motion, Walking):
            self._motion.how = self.settings.gait()
        # The robot may have moved since, and other parameters must not move the board with it.
        if self._board != self._wanted_board():
            self._place_board()

    def _on_reset(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        try:
            self._motion.reset()
        except InputError as error:
            answer.success, answer.message = False, str(error)
            return answer
        self._place_board()
        np.copyto(self._before, self._data.qpos)
        answer.success, answer.message = True, 'the robot stands where it started; time goes on'
        return answer

    def _wanted_board(self) -> tuple[float, float]:
        return self.settings.number('board_distance'), self.settings.number('board_angle_deg')

    def _place_board(self) -> None:
        self._board = self._wanted_board()
        if self.settings.scene == 'board':
            place_board(self._model, self._data, self.settings.board_camera, *self._board)

    def _watch_pace(self) -> None:
        passed = time.monotonic() - self._started
        if self._warned or passed < 2.0 or self._pacer.lag < _LAG_FRACTION * passed:
            return
        self._warned = True
        factor = self.settings.number('real_time_factor')
        self.get_logger().warning(
            f'rendering is slower than the rate: simulated time runs at '
            f'{factor * (1 - self._pacer.lag / passed):.0%} of real time (lower the parameter '
            'rate)'
        )

    def _watch_names(self) -> None:
        # A node of this name on another machine is discovered only after some seconds.
        mine = self.get_name(), self.get_namespace()
        alone = self.get_node_names_and_namespaces().count(mine) < 2
        if self._alone and not alone:
            self.get_logger().error(twin_text(self))
        self._alone = alone
        if self._sim_clock is not None:
            self._sim_clock.watch()

    def destroy_node(self) -> None:
        """Close the renderer, the node and the clock."""
        renderer = getattr(self, '_renderer', None)
        if renderer is not None:
            renderer.close()
        super().destroy_node()
        if (clock := getattr(self, '_sim_clock', None)) is not None:
            clock.close()
