"""Find the topics of cameras in a bag or in a running system."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os.path import commonprefix
from pathlib import Path
import re

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import bag_messages as messages

EVENTS = '/parameter_events'
CARRIED = '/recording'
DEPTH_ENCODINGS = ('32FC1', '64FC1', '16UC1')
_DEPTH, _CLOUD, _INFO, _GRAY = '/depth_image_0', '/point_cloud_0', '/camera_info', '/gray_image_0'
_CLEAN, _CLEAN_INFO = '/clean/depth_image', '/clean/camera_info'
_REFLECTIVITY = '/clean/reflectivity'
# Images of a camera that are no depth of their own, by the names that our nodes and
# pico_flexx_driver give them.
_NOT_DEPTH = (_CLEAN, _REFLECTIVITY, '/depth_noise_0', _GRAY, '/image_noise')
_EIGHT_BITS = ('mono8', '8UC1')
_GRAY_ENCODINGS = (*_EIGHT_BITS, 'mono16', '16UC1')
# Infrared images: of realsense-ros (the left one has depth's pixels, in a frame of its own) and of
# the driver of Azure Kinect.
_INFRARED = re.compile(r'/(infra[12]?|ir)/')
_SAME_PIXELS = ('/infra1/', '/infra/')
# Copies of depth in the pixels of a colour image: of realsense-ros and of the driver of Azure
# Kinect.
_COPY = re.compile(r'/(aligned_depth_to_\w+|depth_to_rgb)/')


@dataclass(frozen=True)
class CameraTopics:
    """
    The topics of a camera.

    Attributes
    ----------
    name : str
        The namespace, or the node's name if it has no namespace. If the topics' names do not tell
        the node: the topic of the depth image, without the first slash.
    node : str
        Full name of the node; empty if unknown.
    depth : str
        Topic of the depth image, also if only the cloud is published.
    info, cloud, gray : str
        Topics of the camera info, the point cloud and the gray image.
    space : str
        The namespace in which ``clean/depth_image`` is, without a slash at its end.
    inputs : dict of str to str
        Topics of clean images that were remapped, by the names that they would have.

    """

    name: str
    node: str
    depth: str
    info: str
    cloud: str
    gray: str
    space: str
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

    Attributes
    ----------
    size : tuple of int
        (height, width), pixels.
    frame_id : str
        Of its header.
    encoding : str
        Of the pixels; empty for a camera info.

    """

    size: tuple[int, int]
    frame_id: str
    encoding: str = ''


@dataclass(frozen=True)
class Survey:
    """
    The cameras that were found.

    Attributes
    ----------
    cameras : dict of str to CameraTopics
        By name.
    unclear : list of list of str
        Topics of depth images that share one camera info, so that the camera's depth is not
        known.

    """

    cameras: dict[str, CameraTopics]
    unclear: list[list[str]] = field(default_factory=list)


def sample(kind: str, data: bytes, where: str) -> Sample:
    """
    Return the properties of a topic from one of its messages.

    Parameters
    ----------
    kind : str
        ``sensor_msgs/msg/Image`` or ``sensor_msgs/msg/CameraInfo``.
    data : bytes
        The message, CDR.
    where : str
        What to call it in errors.

    Raises
    ------
    InputError
        When it is not a message of that type.

    """
    message = messages.decode(kind, data, where)
    return Sample(
        (int(message.height), int(message.width)),
        str(message.header.frame_id),
        message.encoding if kind == messages.IMAGE else '',
    )


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
    Find the cameras among topics by the names that the real driver and our nodes give them.

    Parameters
    ----------
    topics : dict of str to str
        Types by topic.

    Returns
    -------
    dict of str to CameraTopics
        By name.

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
        if kind == messages.IMAGE and topic not in named and not topic.endswith(_NOT_DEPTH)
    ]
    infos = [topic for topic, kind in topics.items() if kind == messages.CAMERA_INFO]
    return images + infos if images else []


def survey(topics: dict[str, str], samples: Mapping[str, Sample]) -> Survey:
    """
    Find the cameras among topics, by names or else by the content of messages.

    A depth image of any name is a camera if a camera info has its size and frame, and no other
    depth image has the same camera info. Copies of depth in the pixels of a colour image are left
    out if the depth image itself is there.

    Parameters
    ----------
    topics : dict of str to str
        Types by topic.
    samples : mapping of str to Sample
        Properties of the `unknown_topics`.

    Returns
    -------
    Survey

    """
    cameras = find_cameras(topics)
    taken = {camera.info for camera in cameras.values()}
    groups: dict[str, list[str]] = {}
    depths = [topic for topic in unknown_topics(topics) if _may_be_depth(topic, samples)]
    for topic in depths:
        info = _info_of(topic, samples)
        if info is not None and info not in taken and not _is_copy(topic, depths):
            groups.setdefault(info, []).append(topic)
    for info, images in groups.items():
        if len(images) == 1:
            camera = _by_shape(images[0], info, topics, samples)
            cameras[camera.name] = camera
    return Survey(cameras, [images for images in groups.values() if len(images) > 1])


def _is_copy(topic: str, depths: list[str]) -> bool:
    found = _COPY.search(topic)
    return found is not None and any(
        other.startswith(topic[: found.start() + 1]) and not _COPY.search(other)
        for other in depths
    )


def _info_of(depth: str, samples: Mapping[str, Sample]) -> str | None:
    # The camera info of the same size and frame with the most similar name. That of clean depth
    # also has this size and frame; it is the last choice.
    of_depth = samples[depth]
    infos = [
        topic
        for topic, found in samples.items()
        if not found.encoding
        and (found.size, found.frame_id) == (of_depth.size, of_depth.frame_id)
    ]
    return max(
        sorted(infos),
        default=None,
        key=lambda topic: (not topic.endswith(_CLEAN_INFO), len(commonprefix([depth, topic]))),
    )


def _by_shape(
    depth: str, info: str, topics: dict[str, str], samples: Mapping[str, Sample]
) -> CameraTopics:
    space = depth.rpartition('/')[0]
    while space and space + _CLEAN not in topics:
        space = space.rpartition('/')[0]
    if space + _CLEAN not in topics:
        space = depth.rpartition('/')[0]
    return CameraTopics(depth.strip('/'), '', depth, info, '', _gray_of(depth, samples), space)


def _may_be_depth(topic: str, samples: Mapping[str, Sample]) -> bool:
    found = samples.get(topic)
    return (
        found is not None and found.encoding in DEPTH_ENCODINGS and _INFRARED.search(topic) is None
    )


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
        and not _may_be_depth(topic, samples)
    ]
    space = depth.rpartition('/')[0]
    grays = [topic for topic in grays if topic.rpartition('/')[0] == space] or grays
    grays = [topic for topic in grays if samples[topic].encoding not in _EIGHT_BITS] or grays
    return grays[0] if len(grays) == 1 else ''


def choose_camera(
    path: Path,
    topics: dict[str, str],
    samples: Mapping[str, Sample],
    camera: str | None,
    clean: str | None = None,
) -> CameraTopics:
    """Return the camera with a name or topic, or raise `InputError` with all names."""
    if clean is not None:
        return _choose_with_clean(path, topics, samples, camera, clean)
    found = survey(topics, samples)
    cameras = found.cameras
    if camera is None and len(cameras) == 1 and not found.unclear:
        return next(iter(cameras.values()))
    if camera is not None and camera.strip('/') in cameras:
        return cameras[camera.strip('/')]
    if camera is not None and topics.get(camera) == messages.IMAGE:
        beside = camera.rpartition('/')[0] + _INFO
        info = _info_of(camera, samples) if camera in samples else None
        return _by_shape(camera, info or beside, topics, {camera: Sample((0, 0), ''), **samples})
    images = [topic for topic, kind in topics.items() if kind == messages.IMAGE]
    several = camera is None and (cameras or found.unclear)
    got = 'several cameras' if several else repr(camera or 'no camera')
    raise InputError(
        f'{path}: camera: must be one of its cameras ({", ".join(cameras) or "none"}) or the '
        f'topic of a depth image ({", ".join(images) or "none"}) (flexx2 convert --camera '
        f'selects one), got {got}'
    )


def _choose_with_clean(
    path: Path,
    topics: dict[str, str],
    samples: Mapping[str, Sample],
    camera: str | None,
    clean: str,
) -> CameraTopics:
    # The camera whose ground truth is on a topic of another name.
    if topics.get(clean) != messages.IMAGE:
        images = [topic for topic, kind in topics.items() if kind == messages.IMAGE]
        raise InputError(
            f'{path}: --clean: must be the topic of a depth image '
            f'({", ".join(images) or "none"}), got {clean!r}'
        )
    info = (_info_of(clean, samples) if clean in samples else None) or (
        clean.rpartition('/')[0] + _INFO
    )
    others = {topic: kind for topic, kind in topics.items() if topic not in (clean, info)}
    found = choose_camera(
        path, others, {topic: one for topic, one in samples.items() if topic in others}, camera
    )
    return replace(found, inputs={found.clean: clean, found.clean_info: info})
