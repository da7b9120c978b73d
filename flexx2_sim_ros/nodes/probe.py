"""Measure running camera nodes from outside, over their topics."""

from dataclasses import dataclass, field
import time
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.decoding import decode_image, stamp_nanoseconds
from flexx2_sim_ros.nodes.ros_graph import remapped
from flexx2_sim_ros.recording.bag_cameras import CameraTopics, find_cameras
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import Image

# At grazing incidence the noise is as large as the distance and clipped by the range: no fair
# comparison.
_LARGEST_SIGMA_FRACTION = 0.05
_MOST_WAITING = 60  # images of a stamp whose partner may still come
# Where fewer pixels than this keep their sigma_z, the mode has changed: edges are a small part.
_SAME_MODE_FRACTION = 0.5
_ANSWER_SECONDS = 60.0


@dataclass
class Capture:
    """
    What one camera published in one mode.

    Attributes
    ----------
    clean, depth : numpy.ndarray
        The last clean image and the simulated one, metres.
    stamps : list of int
        Of the simulated frames, nanoseconds.
    latencies : list of float
        Seconds from the arrival of the clean image here to the arrival of the simulated one.

    """

    clean: np.ndarray | None = None
    depth: np.ndarray | None = None
    stamps: list[int] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    # Images whose partner of the same stamp has not come yet.
    _depths: dict[int, np.ndarray] = field(default_factory=dict)
    _sigmas: dict[int, np.ndarray] = field(default_factory=dict)
    # Of the frames of which both came.
    _count: int = 0
    _sum: Any = 0.0
    _squares: Any = 0.0
    _reference: Any = None
    _steady: Any = None
    _sigma: Any = None

    def add(self, stamp: int, depth: np.ndarray, clean: np.ndarray, latency: float) -> None:
        """Add a frame."""
        self.clean, self.depth = clean, depth
        self.stamps.append(stamp)
        self.latencies.append(latency)
        self._depths[stamp] = depth
        self._pair(stamp)

    def add_sigma(self, stamp: int, sigma: np.ndarray) -> None:
        """Add the model's sigma_z of a frame."""
        self._sigmas[stamp] = sigma
        self._pair(stamp)

    def _pair(self, stamp: int) -> None:
        # Sum up a frame once both images are here. Pixels whose sigma_z changes show another
        # surface, so that a frame whose sigma_z is lost must not count.
        if stamp not in self._depths or stamp not in self._sigmas:
            for waiting in (self._depths, self._sigmas):
                while len(waiting) > _MOST_WAITING:
                    del waiting[next(iter(waiting))]
            return
        depth, sigma = self._depths.pop(stamp), self._sigmas.pop(stamp)
        same = np.isfinite(sigma) if self._sigma is None else sigma == self._sigma
        if self._count and same.sum() < _SAME_MODE_FRACTION * np.isfinite(sigma).sum():
            # The frames before were still of the mode before: they came after its change.
            self._count, self._sum, self._squares = 0, 0.0, 0.0
            same = np.isfinite(sigma)
        if self._count == 0:
            self._reference, self._steady = depth.astype(np.float64), same
        error = depth - self._reference
        self._count += 1
        self._sum = self._sum + error
        self._squares = self._squares + error**2
        self._steady = self._steady & same
        self._sigma = sigma

    @property
    def rate_hz(self) -> float:
        """By stamps."""
        if len(self.stamps) < 2:
            return 0.0
        return (len(self.stamps) - 1) * 1e9 / (self.stamps[-1] - self.stamps[0])

    @property
    def invalid_fraction(self) -> float:
        """Of the last frame."""
        return float('nan') if self.depth is None else float(np.isnan(self.depth).mean())

    def sigmas(self) -> tuple[float, float]:
        """
        Return the realised and the modelled sigma_z, root mean square, metres.

        They are over pixels that were valid in every frame and away from edges (there, lateral
        noise sometimes shows another surface); NaN below three frames.
        """
        count = self._count
        if count < 3 or self.depth is None:
            return float('nan'), float('nan')
        variance = (self._squares - self._sum**2 / count) / (count - 1)
        use = (
            self._steady
            & np.isfinite(variance)
            & (self._sigma < _LARGEST_SIGMA_FRACTION * self.depth)
        )
        if not use.any():
            return float('nan'), float('nan')
        return (
            float(np.sqrt(variance[use].mean())),
            float(np.sqrt((self._sigma[use].astype(np.float64) ** 2).mean())),
        )


class Probe:
    """
    Watch camera nodes and set their mode.

    ``cameras`` are namespaces; ``<camera>/flexx2_camera`` is the node. Its clean images are
    ``<camera>/clean/depth_image``, or what it subscribes to instead.
    """

    def __init__(self, cameras: list[str]) -> None:
        """Subscribe; ``rclpy.init`` has been called."""
        self._node = Node('flexx2_probe')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.captures: dict[str, Capture] = {}
        self._clean: dict[str, dict[int, tuple[float, Image]]] = {name: {} for name in cameras}
        self._latest = dict.fromkeys(cameras, 0)
        self._seen: set[str] = set()
        self._from = dict.fromkeys(cameras, 1 << 62)
        self._clients = {}
        self._clean_topics: dict[str, CameraTopics] = {}
        self._listening: dict[str, Any] = {}
        for name in cameras:
            node = f'/{name}/flexx2_camera'
            self._clients[name] = AsyncParameterClient(self._node, node)
            depth = f'{node}/depth_image_0'
            (self._clean_topics[name],) = find_cameras({depth: 'sensor_msgs/msg/Image'}).values()
            self._listen(name)
            self._subscribe(f'{node}/depth_noise_0', name, self._on_sigma)
            self._subscribe(depth, name, self._on_depth)

    def _listen(self, name: str) -> None:
        topic = self._clean_topics[name].clean
        self._listening[name] = self._subscribe(topic, name, self._on_clean)

    def _follow(self) -> None:
        for name, known in self._clean_topics.items():
            topics = remapped(self._node, known)
            if topics.clean != known.clean:
                self._clean_topics[name] = topics
                self._node.destroy_subscription(self._listening[name])
                self._listen(name)

    def _subscribe(self, topic: str, name: str, callback: Any) -> Any:
        # Reliable, so that a missing frame was not published.
        return self._node.create_subscription(
            Image, topic, lambda message: callback(name, message), 10
        )

    def _on_clean(self, name: str, message: Image) -> None:
        kept = self._clean[name]
        stamp = stamp_nanoseconds(message.header.stamp)
        kept[stamp] = (time.perf_counter(), message)
        self._latest[name] = stamp
        while len(kept) > 60:
            del kept[next(iter(kept))]

    def _on_sigma(self, name: str, message: Image) -> None:
        stamp = stamp_nanoseconds(message.header.stamp)
        if stamp >= self._from[name]:
            sigma = decode_image(message, 'depth_noise_0', ('32FC1',))
            self.captures[name].add_sigma(stamp, sigma)

    def _on_depth(self, name: str, message: Image) -> None:
        now = time.perf_counter()
        self._seen.add(name)
        stamp = stamp_nanoseconds(message.header.stamp)
        received = self._clean[name].get(stamp)
        if stamp < self._from[name] or received is None:
            return
        self.captures[name].add(
            stamp,
            decode_image(message, 'depth_image_0', ('32FC1',)),
            decode_image(received[1], 'clean/depth_image', ('32FC1',)),
            now - received[0],
        )

    def spin_until(self, condition: Any, seconds: float) -> bool:
        """Handle messages until the condition holds; return whether it did in time."""
        deadline = time.monotonic() + seconds
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, 0.1))
        return True

    def streaming(self) -> bool:
        """Return whether images of every camera arrive and its node answers."""
        self._follow()
        # A node's services exist before its camera is compiled, which takes seconds.
        return (
            self._seen == self._clients.keys()
            and all(self._latest.values())
            and all(client.services_are_ready() for client in self._clients.values())
        )

    def start(self, usecase: str) -> None:
        """
        Switch every camera to a mode and restart the measurement.

        Raises InputError when a camera refuses or does not answer.
        """
        self._from = dict.fromkeys(self._from, 1 << 62)
        for name, client in self._clients.items():
            future = client.set_parameters([Parameter('usecase', value=usecase)])
            if not self.spin_until(future.done, _ANSWER_SECONDS):
                raise InputError(f'{name}: usecase: no answer within {_ANSWER_SECONDS:g} s')
            result = future.result().results[0]
            if not result.successful:
                raise InputError(f'{name}: {result.reason}')
        self.captures = {name: Capture() for name in self._clients}
        # Images sent after the answer are of the new mode.
        self._from = {name: stamp + 1 for name, stamp in self._latest.items()}

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()
