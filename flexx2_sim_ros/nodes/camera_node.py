"""The camera node: takes clean depth, publishes what a Flexx2 would have seen."""

from collections.abc import Callable
from functools import partial
import time
from traceback import format_exception
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.camera.compiling import compiling_said, warm_up
from flexx2_sim_ros.camera.frame import Frame
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.camera_info import decode_camera_info, size_words
from flexx2_sim_ros.messages.decoding import check_stamp, decode_image, stamp_nanoseconds
from flexx2_sim_ros.nodes import messages
from flexx2_sim_ros.nodes.camera_outputs import CameraOutputs
from flexx2_sim_ros.nodes.camera_parameters import CameraParameters
from flexx2_sim_ros.nodes.diagnostics import Statistics
from flexx2_sim_ros.nodes.input_watch import InputWatch, Remark
from flexx2_sim_ros.nodes.late_frames import LateFrames
from flexx2_sim_ros.nodes.pacing import FrameGate
from flexx2_sim_ros.nodes.pairing import Match, StampPairing
from flexx2_sim_ros.nodes.parameters import declare
from flexx2_sim_ros.nodes.plausibility import ReflectivityUnit
from flexx2_sim_ros.nodes.runtime import Throttle
from flexx2_sim_ros.nodes.steady_node import SteadyNode
from flexx2_sim_ros.nodes.subscriptions import Input
from flexx2_sim_ros.nodes.tf_frames import FramePublisher, optical_transform
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.files import find_profile, PROFILE_HELP
from flexx2_sim_ros.profiles.modes import Profile
import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

_DEPTH_ENCODINGS = ('32FC1', '64FC1', '16UC1')
# Period of the check for publishers that are new or have changed.
_FOLLOW_SECONDS = 0.2
# Time after which the same problem of the input is logged again.
_REMIND_SECONDS = 30.0


class _NoCameraInfoError(InputError):
    """No camera info has arrived yet."""


class Flexx2Camera(SteadyNode):
    """
    A simulated Flexx2, on the topics and parameters of the vendor's driver.

    It subscribes to ``clean/depth_image``, ``clean/camera_info`` and ``clean/reflectivity``, which
    is optional. It publishes ``depth_image_0``, ``camera_info``, ``point_cloud_0``,
    ``gray_image_0`` and ``depth_noise_0`` under ``~/``, and ``/diagnostics``. If the parameter
    ``parent_frame`` is set, it publishes the camera's frame on ``/tf_static``.
    """

    # Effects and exposures depend on the mode, and single effects depend on the file of effects.
    set_first = frozenset({'effects', 'usecase', 'auto_exposure_0'})

    def __init__(self, **options: Any) -> None:
        """Declare parameters, compile the camera model, then open the topics."""
        super().__init__('flexx2_camera', **options)
        self._said_once: set[str] = set()
        self._effects_said = ''
        self._throttle = Throttle()
        self._profile = self._find_profile()
        self.settings = CameraParameters(self, self._profile, self._on_change)
        self._statistics = Statistics()
        self._pairing = StampPairing()
        self._view: Reprojection | None = None
        self._camera = self._make_camera()
        self._gate = FrameGate(self._camera.mode.rate_hz)
        self._compile('the camera model')
        self._say_effects()
        self._reflectivity_unit = ReflectivityUnit(self._say_once)
        self._open_topics()
        self._frames = FramePublisher(self, moving=False) if self.settings.parent_frame else None
        self._placed = ''
        self._place(self.settings.frame_id)
        self.say_unknown_parameters()
        self.get_logger().info(
            f'{self._camera.usecase}, serial {self.settings.serial}: waiting for '
            f'{self.resolve_topic_name("clean/depth_image")}'
        )

    def _open_topics(self) -> None:
        self._outputs = CameraOutputs(self, self.settings, self._profile.sensor)
        self._late = LateFrames(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # The image is last: of messages that wait together, it is then handled after the others.
        self._inputs = {
            topic: Input(self, kind, topic, callback)
            for topic, kind, callback in (
                ('clean/camera_info', CameraInfo, self._on_info),
                ('clean/reflectivity', Image, self._on_reflectivity),
                ('clean/depth_image', Image, self._on_image),
            )
        }
        self._watch = InputWatch(self._inputs, self._pairing)
        self._warned = False
        # A steady clock, because diagnostics must continue while /clock stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._report, clock=steady)
        self.create_timer(_FOLLOW_SECONDS, self._follow, clock=steady)

    def _follow(self) -> None:
        for source in self._inputs.values():
            source.follow()

    def _compile(self, what: str) -> None:
        with compiling_said(
            lambda: self.get_logger().info(
                f'compiling {what}, once: takes about ten seconds (`flexx2 compile` does it ahead '
                'of time)'
            )
        ):
            warm_up(self._camera, self.settings.intrinsics)

    def _place(self, frame: str) -> None:
        # `frame_id` can change while the node runs.
        if self._frames is not None and frame != self._placed:
            self._placed = frame
            settings = self.settings
            self._frames.fixed(
                [
                    optical_transform(
                        (settings.parent_frame, frame), settings.mount_position, settings.mount_rpy
                    )
                ]
            )

    def _find_profile(self) -> Profile:
        name = declare(
            self, 'profile', '', f'{PROFILE_HELP[0].upper()}{PROFILE_HELP[1:]}.', read_only=True
        )
        return find_profile(name)

    def _make_camera(self) -> Camera:
        settings = self.settings
        camera = Camera(
            settings.usecase,
            profile=self._profile,
            effects=settings.effects.chosen,
            seed=settings.seed,
            name=settings.camera_name,
        )
        mode = camera.mode
        if not mode.measured:
            self._say_once(
                f'{mode.name}: its noise was not measured in this mode; it is {mode.noise_words}'
            )
        return camera

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all parameters or none. The mode and its exposure are checked together."""
        if not hasattr(self, 'settings'):  # They are being declared.
            return super().set_parameters_atomically(parameter_list)
        with self.settings.exposure_of_any_mode():
            return super().set_parameters_atomically(parameter_list)

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters one by one, each with `set_parameters_atomically`."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def _on_change(self, new_mode: bool) -> None:
        # Called between two frames: callbacks of this node never run at the same time.
        were_on = {effect.name for effect in self._camera.effects}
        if new_mode:
            self._camera = self._make_camera()
            self._gate.set_rate(self._camera.mode.rate_hz)
            self._statistics.output_rate.clear()
            self.get_logger().info(f'usecase is now {self._camera.usecase}')
        else:
            # Effects that stay on keep their memory.
            self._camera.effects = self.settings.effects.chosen
        if any(effect.name not in were_on for effect in self._camera.effects):
            self._compile('the camera model')
        self._say_effects()

    def _say_effects(self) -> None:
        names = ', '.join(effect.name for effect in self._camera.effects)
        if names != self._effects_said:
            self._effects_said = names
            self.get_logger().info(f'effects are now {names or "off"}')

    def _on_info(self, message: CameraInfo) -> None:
        stamp = stamp_nanoseconds(message.header.stamp)
        self._take(self._pairing.companion('info', stamp, message))

    def _on_reflectivity(self, message: Image) -> None:
        stamp = stamp_nanoseconds(message.header.stamp)
        self._take(self._pairing.companion('reflectivity', stamp, message))

    def _on_image(self, message: Image) -> None:
        self._statistics.receive()
        stamp = stamp_nanoseconds(message.header.stamp)
        self._take(self._pairing.image(stamp, message))

    def _take(self, matches: list[Match]) -> None:
        for match in matches:
            start = time.perf_counter()
            self._safely(partial(self._process, match, start))

    def _safely(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:  # A message must not end the node.
            # After the node was told to stop, its publishers do not exist any more.
            if self.context.ok():
                self._reject(error)

    def _reject(self, error: Exception) -> None:
        self._statistics.rejected += 1
        text = str(error)
        if not isinstance(error, InputError):
            text = f'internal error, please report it: {"".join(format_exception(error))}'
        self._statistics.last_error = text
        # Throttle by field: the value may differ in each message.
        if self._throttle.ready(text.partition(': must')[0]):
            # rclpy allows only one severity for each line of code that logs.
            if isinstance(error, _NoCameraInfoError):
                # At the start, an image often arrives before the first camera info.
                self.get_logger().warning(f'input rejected: {text}')
            else:
                self.get_logger().error(f'input rejected: {text}')

    def _process(self, match: Match, start: float) -> None:
        check_stamp(match.image.header.stamp, 'clean/depth_image')
        image = decode_image(match.image, 'clean/depth_image', _DEPTH_ENCODINGS)
        view = self._find_view(match, image)
        reflectivity = self._find_reflectivity(match, image.shape)
        if not self._due(match.stamp):
            return
        self._watch.keep(image, match.image.encoding, self._camera.mode)
        head = messages.header(match.stamp, self.settings.frame_id or match.image.header.frame_id)
        self._place(head.frame_id)
        frame = None
        if self._outputs.wanted:
            # Parameters of effects hold for the automatic or the longest exposure.
            self._camera.exposure_share = self.settings.exposure_share or 1.0
            frame = self._camera.capture(
                view.depth(image),
                self.settings.intrinsics.matrix,
                match.stamp,
                None if reflectivity is None else view.reflectivity(reflectivity),
            )
            frame.make_invalid(view.outside)
            invalid = np.count_nonzero(np.isnan(frame.depth))
            self._statistics.invalid_fraction = invalid / frame.depth.size
        else:
            self._camera.skip(match.stamp)
        delay = time_offset_of(self._camera.effects).delay_ns
        self._statistics.delay = delay * 1e-9
        publish = partial(self._publish, head, frame, start)
        self._late.add(
            match.stamp, delay, self._camera.mode.rate_hz, partial(self._safely, publish)
        )
        if delay and self._late.other_clock:
            self._say_once(
                'effect.time_offset.delay: the stamps of clean/depth_image are not of the clock '
                'of this node (see use_sim_time): the delay counts from the arrival of the image'
            )

    def _publish(self, head: Header, frame: Frame | None, start: float) -> None:
        if frame is not None:
            self._outputs.publish_frame(head, frame)
        self._outputs.publish_info(head)
        self._statistics.publish(time.perf_counter() - start)

    def _find_view(self, match: Match, image: np.ndarray) -> Reprojection:
        if match.info is None:
            raise _NoCameraInfoError(
                'clean/camera_info: must come with every image of clean/depth_image, or once '
                'and latched, got none'
            )
        notes: list[str] = []
        rectified = self.settings.is_rectified(self._inputs['clean/depth_image'].topic)
        source = decode_camera_info(match.info, 'clean/camera_info', image.shape, rectified, notes)
        for note in notes:
            self._say_once(note)
        if (source.height, source.width) != image.shape:
            raise InputError(
                'clean/camera_info: size: must be that of clean/depth_image, '
                f'{image.shape[1]} x {image.shape[0]}, got {size_words(match.info)}'
            )
        radial = self.settings.radial
        view = self._view
        if view is None or view.source != source or view.radial != radial:
            view = self._view = Reprojection(
                self.settings.intrinsics, source, radial, self._profile.sensor
            )
            if view.outside.any():
                width, height = self.settings.intrinsics.field_of_view_deg
                self._say_once(
                    f'{view.outside.mean():.0%} of the rays lie outside the view of '
                    'clean/depth_image and are invalid: render at least '
                    f'{width:.0f} x {height:.0f} degrees'
                )
        return view

    def _find_reflectivity(self, match: Match, shape: tuple[int, ...]) -> np.ndarray | None:
        if match.reflectivity is None:
            return None
        try:
            image = decode_image(match.reflectivity, 'clean/reflectivity', ('32FC1',))
            if image.shape != shape:
                raise InputError(
                    f'clean/reflectivity: size: must be that of clean/depth_image, {shape[1]} '
                    f'x {shape[0]}, got {image.shape[1]} x {image.shape[0]}'
                )
        except InputError as error:  # It is optional: the frame is published without it.
            self._reject(error)
            return None
        return self._reflectivity_unit.of(image)

    def _due(self, stamp: int) -> bool:
        statistics, gate = self._statistics, self._gate
        repeats, restarts = gate.repeats, gate.restarts
        due = gate.accept(stamp)
        if gate.repeats > repeats:
            if self._throttle.ready('repeated stamp'):
                self.get_logger().warning(
                    'clean/depth_image: header.stamp: must be new for every image, got '
                    f'{stamp} ns again; the image is left out'
                )
            return False
        if gate.restarts > restarts:
            self._camera.reset()
            self._late.clear()
            if self._throttle.ready('stamps went back'):
                self.get_logger().warning(
                    f'clean/depth_image: header.stamp went back to {stamp} ns: the camera '
                    'starts anew'
                )
        statistics.input_rate.add(stamp)
        if due:
            statistics.output_rate.add(stamp)
        return due

    def _report(self) -> None:
        mode, statistics = self._camera.mode, self._statistics
        remarks = self._watch.remarks()
        status = statistics.report(
            self.get_fully_qualified_name().lstrip('/'),
            self.settings.serial,
            mode.name,
            mode.rate_hz,
            self._gate,
            self._watch,
            self._late,
            remarks,
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        if slow := statistics.slow(mode.rate_hz):
            self._say_once(
                f'{mode.name} wants {mode.rate_hz:g} Hz: {slow} and is passed on at its own rate',
                key=f'slower than {mode.name}',
            )

        self._say(remarks)

    def _say(self, remarks: list[Remark]) -> None:
        logger = self.get_logger()
        for remark in remarks:
            if not self._throttle.ready(remark.kind, _REMIND_SECONDS):
                continue
            # rclpy allows only one severity for each line of code that logs.
            if remark.warn:
                logger.warning(remark.text)
            else:
                logger.info(remark.text)
        warned = any(remark.warn for remark in remarks)
        if self._warned and not warned and self._throttle.ready('input is fine'):
            logger.info('the input is fine again')
        self._warned = warned

    def _say_once(self, text: str, key: str = '') -> None:
        if (key or text) not in self._said_once:
            self._said_once.add(key or text)
            self.get_logger().warning(text)
