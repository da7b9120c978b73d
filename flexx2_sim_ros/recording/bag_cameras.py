"""Which topics of a bag, or of a running system, are a camera's."""

from dataclasses import dataclass
from pathlib import Path

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import bag_messages as messages

EVENTS = '/parameter_events'
CARRIED = '/recording'
_DEPTH, _CLOUD = '/depth_image_0', '/point_cloud_0'


@dataclass(frozen=True)
class CameraTopics:
    """
    Where a camera publishes.

    The driver's names (and `flexx2_camera`'s) are relative to `node`, those of clean depth to its
    namespace.

    Attributes
    ----------
    name : str
        The namespace, or the node's name where it is in none.
    node : str
        Full name.
    depth : str
        Topic of the depth image (or where it would be, if there is only the cloud).

    """

    name: str
    node: str
    depth: str

    @property
    def info(self) -> str:
        """Return the topic of the camera info."""
        return f'{self.node}/camera_info'

    @property
    def cloud(self) -> str:
        """Return the topic of the point cloud."""
        return self.node + _CLOUD

    @property
    def gray(self) -> str:
        """Return the topic of the gray image."""
        return f'{self.node}/gray_image_0'

    @property
    def space(self) -> str:
        """Return the node's namespace, without a slash at its end."""
        return self.node.rpartition('/')[0]

    @property
    def clean(self) -> str:
        """Return the topic of clean depth."""
        return f'{self.space}/clean/depth_image'

    @property
    def clean_info(self) -> str:
        """Return the topic of clean depth's camera info."""
        return f'{self.space}/clean/camera_info'

    @property
    def reflectivity(self) -> str:
        """Return the topic of reflectivity."""
        return f'{self.space}/clean/reflectivity'

    @property
    def carried(self) -> str:
        """Return the topic of a recording's arrays that are no messages of the camera."""
        return self.space + CARRIED


def topics_of(name: str) -> CameraTopics:
    """Return the topics of a `flexx2_camera` in the namespace `name`."""
    node = f'/{name}/flexx2_camera'
    return CameraTopics(name, node, node + _DEPTH)


def find_cameras(topics: dict[str, str]) -> dict[str, CameraTopics]:
    """
    Find the cameras among topics.

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
    nodes = sorted({topic.removesuffix(suffix) for topic, kind in topics.items()
                    for suffix, wanted in kinds.items()
                    if topic.endswith(suffix) and kind == wanted})
    names = [node.rpartition('/')[0].strip('/') or node.strip('/') for node in nodes]
    # Two nodes in one namespace go by their full names.
    full = [name if names.count(name) == 1 else node.strip('/')
            for name, node in zip(names, nodes, strict=True)]
    return {name: CameraTopics(name, node, node + _DEPTH)
            for name, node in zip(full, nodes, strict=True)}


def choose_camera(path: Path, topics: dict[str, str], camera: str | None) -> CameraTopics:
    """Return the camera that is meant, or raise `InputError` with the names there are."""
    cameras = find_cameras(topics)
    if camera is None and len(cameras) == 1:
        return next(iter(cameras.values()))
    if camera in cameras:
        return cameras[camera]
    if camera is not None and topics.get(camera) == messages.IMAGE:
        node = camera.rpartition('/')[0]
        return CameraTopics(camera.strip('/'), node, camera)
    images = [topic for topic, kind in topics.items() if kind == messages.IMAGE]
    found = 'several cameras' if camera is None and cameras else repr(camera or 'no camera')
    raise InputError(
        f'{path}: camera: found {found}, wanted one of its cameras: '
        f'{", ".join(cameras) or "none"}; or the topic of a depth image: '
        f'{", ".join(images) or "none"}')
