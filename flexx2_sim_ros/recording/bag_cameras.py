"""Find the topics of cameras in a bag or in a running system."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from os.path import commonprefix
import re

from flexx2_sim_ros.messages.camera_info import image_sizes
from flexx2_sim_ros.messages.compressed_depth import SUFFIX
from flexx2_sim_ros.recording import bag_messages as messages

EVENTS = '/parameter_events'
INPUTS = 'input_depth', 'input_lens'  # parameters of a camera's node that say what it receives
CARRIED = '/recording'
DEPTH_ENCODINGS = ('32FC1', '64FC1', '16UC1')
# Also 16UC1 by another name, where the topic's name says that it is depth: of RealSense Viewer.
_DEPTH_NAME = re.compile(r'depth', re.IGNORECASE)
_DEPTH, _CLOUD, _INFO, _GRAY = '/depth_image_0', '/point_cloud_0', '/camera_info', '/gray_image_0'
_CLEAN, _CLEAN_INFO = '/clean/depth_image', '/clean/camera_info'
_REFLECTIVITY = '/clean/reflectivity'
# Images of a camera that are no depth of their own, by the names that our nodes and
# pico_flexx_driver give them.
_NOT_DEPTH = (_CLEAN, _REFLECTIVITY, '/depth_noise_0', _GRAY, '/image_noise')
_EIGHT_BITS = ('mono8', '8UC1')
_GRAY_ENCODINGS = (*_EIGHT_BITS, 'mono16', '16UC1')
# Infrared images: of realsense-ros (the left one has depth's pixels, in a frame of its own), the
# drivers of Azure Kinect, Kinect v2 and of Analog Devices (active brightness).
_INFRARED = re.compile(
    r'[/_](infra(red)?(_?[12])?|ir|ab|amplitude|intensity)([/_]|$)', re.IGNORECASE
)
_SAME_PIXELS = ('/infra1/', '/infra/')
# Copies of depth in the pixels of a colour image: of realsense-ros and of the driver of Azure
# Kinect.
_COPY = re.compile(r'/(aligned_depth_to_\w+|depth_to_rgb)/')


@dataclass(frozen=True)
class CameraTopics:
    """
    The topics of a camera.

    ``name`` is the namespace, or the node's name if it has no namespace. If the topics' names do
    not tell the node: the topic of the depth image, without the first slash.
    """

    name: str
    node: str  # full name; empty if unknown
    depth: str  # also if only the cloud is published
    info: str
    cloud: str
    gray: str
    space: str  # the namespace in which ``clean/depth_image`` is, without a slash at its end
    # Topics of clean images that were remapped, by the names that they would have.
    inputs: Mapping[str, str] = field(default_factory=dict)

    @property
    def clean(self) -> str:
        """Return the topic of clean depth."""
        return self._input(_CLEAN)

    @property
    def clean_info(self) -> str:
        """Return the topic of clean depth's camera info."""
        return self._input(_CLEAN_INFO)

    @property
    def reflectivity(self) -> str:
        """Return the topic of reflectivity."""
        return self._input(_REFLECTIVITY)

    def _input(self, name: str) -> str:
        return self.inputs.get(self.space + name, self.space + name)

    @property
    def carried(self) -> str:
        """Return the topic of the recording's other arrays."""
        return self.space + CARRIED


@dataclass(frozen=True)
class Sample:
    """
    Properties of an image or camera info topic, from its first message.

    ``size`` is (height, width), pixels; ``encoding`` is empty for a camera info, and ``part`` the
    (height, width) of the images by its binning and region, if it has any.
    """

    size: tuple[int, int]
    frame_id: str
    encoding: str = ''
    part: tuple[int, int] | None = None


@dataclass(frozen=True)
class Survey:
    """
    The cameras that were found, by name.

    ``unclear`` are topics of depth images that share one camera info, so that the camera's depth
    is not known.
    """

    cameras: dict[str, CameraTopics]
    unclear: list[list[str]] = field(default_factory=list)


def sample(kind: str, data: bytes, where: str) -> Sample:
    """
    Return the properties of a topic from one of its messages, CDR.

    ``kind`` is ``sensor_msgs/msg/Image``, ``CompressedImage`` (of depth) or ``CameraInfo``;
    ``where`` is what to call the message in errors. Raises InputError when it is not of that type.
    """
    message = messages.decode_pixels(kind, data, where)
    frame = str(message.header.frame_id)
    if kind == messages.CAMERA_INFO:
        own, *part = image_sizes(message)
        return Sample(own, frame, part=part[0] if part else None)
    return Sample((int(message.height), int(message.width)), frame, message.encoding)


def topics_of(name: str) -> CameraTopics:
    """Return the topics of a `flexx2_camera` in the namespace `name`."""
    return _of_node(name, f'/{name}/flexx2_camera')


def _of_node(name: str, node: str) -> CameraTopics:
    return CameraTopics(
        name,
        node,
        node + _DEPTH,
        node + _INFO,
        node + _CLOUD,
        node + _GRAY,
        node.rpartition('/')[0],
    )


def find_cameras(topics: dict[str, str]) -> dict[str, CameraTopics]:
    """
    Find the cameras, by name, by the names of topics from the real driver and our nodes.

    ``topics`` are types by topic.
    """
    kinds = {_DEPTH: messages.IMAGE, _CLOUD: messages.POINT_CLOUD}
    nodes = sorted(
        {
            topic.removesuffix(suffix)
            for topic, kind in topics.items()
            for suffix, wanted in kinds.items()
            if topic.endswith(suffix) and kind == wanted
        }
    )
    names = [node.rpartition('/')[0].strip('/') or node.strip('/') for node in nodes]
    # Two nodes in one namespace have their full names.
    full = [
        name if names.count(name) == 1 else node.strip('/')
        for name, node in zip(names, nodes, strict=True)
    ]
    return {name: _of_node(name, node) for name, node in zip(full, nodes, strict=True)}


def unknown_topics(topics: dict[str, str]) -> list[str]:
    """
    Return the topics that `survey` needs samples of.

    These are images with unknown names and, if there are any, all camera infos.
    """
    named = {camera.depth for camera in find_cameras(topics).values()}
    images = [
        topic
        for topic, kind in topics.items()
        if messages.has_depth_pixels(topic, kind)
        and topic not in named
        and not topic.endswith(_NOT_DEPTH)
        and not (topic.endswith(SUFFIX) and topic.removesuffix(SUFFIX) in topics)
    ]
    infos = [topic for topic, kind in topics.items() if kind == messages.CAMERA_INFO]
    return images + infos if images else []


def survey(topics: dict[str, str], samples: Mapping[str, Sample], lens: bool = False) -> Survey:
    """
    Find the cameras among topics, by names or else by the content of messages.

    A depth image of any name is a camera if a camera info has its size and frame, and no other
    depth image has the same camera info. Copies of depth in the pixels of a colour image are left
    out if the depth image itself is there. ``topics`` are types by topic, ``samples`` those of the
    `unknown_topics`. If the ``lens`` is known from elsewhere, depth images need no camera info.
    """
    cameras = find_cameras(topics)
    taken = {camera.info for camera in cameras.values()}
    groups: dict[str, list[str]] = {}
    depths = [topic for topic in unknown_topics(topics) if may_be_depth(topic, samples)]
    for topic in depths:
        info = info_of(topic, samples)
        if _is_copy(topic, depths) or info in taken:
            continue
        if info is not None:
            groups.setdefault(info, []).append(topic)
        elif lens:
            camera = by_shape(topic, '', topics, samples)
            cameras[camera.name] = camera
    for info, images in groups.items():
        if len(images) == 1:
            camera = by_shape(images[0], info, topics, samples)
            cameras[camera.name] = camera
    return Survey(cameras, [images for images in groups.values() if len(images) > 1])


def _is_copy(topic: str, depths: list[str]) -> bool:
    found = _COPY.search(topic)
    return found is not None and any(
        other.startswith(topic[: found.start() + 1]) and not _COPY.search(other)
        for other in depths
    )


def info_of(depth: str, samples: Mapping[str, Sample]) -> str | None:
    """Return the camera info of a depth image, or None."""
    # The camera info of the same size and frame with the most similar name. That of clean depth
    # also has this size and frame; it is the last choice.
    of_depth = samples[depth]
    infos = [
        topic
        for topic, found in samples.items()
        if not found.encoding
        and of_depth.size in (found.size, found.part)
        and found.frame_id == of_depth.frame_id
    ]
    return max(
        sorted(infos),
        default=None,
        key=lambda topic: (not topic.endswith(_CLEAN_INFO), len(commonprefix([depth, topic]))),
    )


def by_shape(
    depth: str, info: str, topics: dict[str, str], samples: Mapping[str, Sample]
) -> CameraTopics:
    """Return the camera of a depth image and its camera info."""
    space = depth.rpartition('/')[0]
    while space and space + _CLEAN not in topics:
        space = space.rpartition('/')[0]
    if space + _CLEAN not in topics:
        space = depth.rpartition('/')[0]
    return CameraTopics(depth.strip('/'), '', depth, info, '', _gray_of(depth, samples), space)


def may_be_depth(topic: str, samples: Mapping[str, Sample]) -> bool:
    found = samples.get(topic)
    if found is None or _INFRARED.search(topic) is not None:
        return False
    named = found.encoding == 'mono16' and _DEPTH_NAME.search(topic) is not None
    return named or found.encoding in DEPTH_ENCODINGS


def _gray_of(depth: str, samples: Mapping[str, Sample]) -> str:
    # Of the same size and frame, or by its name; in depth's own namespace if there is one; of
    # 16 bits rather than of 8. Empty where it is not clear.
    of_depth = samples[depth]
    siblings = {depth.replace('/depth/', name, 1) for name in _SAME_PIXELS} - {depth}
    grays = [
        topic
        for topic, found in samples.items()
        if found.encoding in _GRAY_ENCODINGS
        and found.size == of_depth.size
        and (found.frame_id == of_depth.frame_id or topic in siblings)
        and not may_be_depth(topic, samples)
    ]
    space = depth.rpartition('/')[0]
    grays = [topic for topic in grays if topic.rpartition('/')[0] == space] or grays
    grays = [topic for topic in grays if samples[topic].encoding not in _EIGHT_BITS] or grays
    return grays[0] if len(grays) == 1 else ''
