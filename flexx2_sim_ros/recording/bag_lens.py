"""The lens of a camera in a bag, and clean images of another lens looked up at its pixels."""

from collections.abc import Callable, Sequence
from typing import Any

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.camera_info import (
    decode_camera_info,
    image_sizes,
    is_rectified,
    size_words,
    with_size,
)
from flexx2_sim_ros.physics.geometry import Reprojection
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording.bag_cameras import CameraTopics
from flexx2_sim_ros.recording.calibration import Calibration, WAY_OUT
import numpy as np


class BagLens:
    """
    The lens of a camera in the bag `path`.

    ``info`` is its first ``sensor_msgs/CameraInfo`` that says something, ``given`` the lens to
    take instead, both may be None. ``rectified`` says whether depth is; None: the name of its
    topic says it. Raises InputError when there is neither a camera info nor a lens.
    """

    def __init__(
        self,
        path: str,
        where: CameraTopics,
        info: Any,
        given: Calibration | None,
        rectified: bool | None,
    ) -> None:
        """Keep them."""
        self._label = f'{path}: {where.info}'
        self._depth, self._path = where.depth, path
        self._info, self._given = info, given
        self._by_name = rectified is None and is_rectified(where.depth)
        self._rectified = rectified or self._by_name
        if info is None and given is None:
            raise InputError(
                f'{self._label}: must have the camera matrix, got no complete message; {WAY_OUT}'
            )

    @property
    def sizes(self) -> Sequence[tuple[int, int]]:
        """Return (height, width) of the images that it can be of, the likeliest first."""
        modes = () if self._given is None else self._given.modes
        messages = [*modes, *([] if self._info is None else [self._info])]
        return [size for one in messages for size in image_sizes(one) if all(size)]

    def check_size(self, size: tuple[int, int]) -> None:
        """Refuse a camera info of another size than the image: it would be another camera."""
        # A size of 0 says nothing.
        if self._given is None and self.sizes and size not in self.sizes:
            raise InputError(
                f'{self._label}: size: must be that of {self._depth}, {size[1]} x {size[0]}, got '
                f'{size_words(self._info)}; {WAY_OUT}'
            )

    def camera(self, size: tuple[int, int], notes: list[str]) -> Intrinsics:
        """
        Return the camera of images of a size (height, width); what was assumed goes to the notes.

        Raises InputError when it cannot be a camera.
        """
        if self._given is not None:
            camera = self._given.intrinsics(size, self._rectified, notes)
            if self._info is not None:
                notes.append(f'{self._path}: K, distortion: those of {self._given.name}')
            return camera
        try:
            info = with_size(self._info, size)
            camera = decode_camera_info(info, self._label, size, self._rectified, notes)
        except InputError as error:
            also = '; --no-rectified takes K and D' if self._rectified else ''
            raise InputError(f'{error}; {WAY_OUT}{also}') from error
        if self._by_name and (any(self._info.d) or list(camera.matrix.flat) != [*self._info.k]):
            notes.append(
                f'{self._label}: {self._depth} is rectified by its name: P and no distortion '
                '(--no-rectified takes K and D)'
            )
        return camera


def view_of(
    camera: Intrinsics, clean_info: Any, radial: bool = False, rectified: bool = False
) -> Reprojection | None:
    """
    Return how the recorded camera looks through the clean images of a simulator.

    ``clean_info`` is the ``sensor_msgs/CameraInfo`` of the clean images. If ``radial``, they hold
    distances along the ray instead of along the axis. None where both have the same pixels, or
    where the message describes no camera.
    """
    try:
        source = decode_camera_info(clean_info, rectified=rectified)
    except InputError:
        return None
    if camera == source and not radial:
        return None
    view = Reprojection(camera, source, radial)
    return None if view.identical and not radial else view


def looked_up(
    decoder: Callable[[bytes], np.ndarray], view: Reprojection, depth: bool
) -> Callable[[bytes], np.ndarray]:
    """
    Return a decoder of images as the recorded camera sees them: (H, W) float32 at its pixels.

    NaN is where the clean images do not reach. ``decoder`` returns a clean image of a message, (H,
    W): depth in metres if ``depth``, else reflectivity. One that is not of the size of the source
    of ``view`` is left as it is.
    """

    def look(data: bytes) -> np.ndarray:
        image = decoder(data)
        if image.shape != (view.source.height, view.source.width):
            return image
        image = image.astype(np.float32, copy=False)
        seen = view.depth(image) if depth else view.reflectivity(image)
        return np.where(view.outside, np.float32(np.nan), seen)

    return look
