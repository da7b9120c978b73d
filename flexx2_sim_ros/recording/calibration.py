"""Camera matrices and lenses from the files of ROS' camera_calibration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import read_mapping
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.messages.decoding import decode_distortion
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.section import is_number


@dataclass(frozen=True)
class Calibration:
    """
    What a calibration file says.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    size : tuple of int or None
        Height and width of its images; None where the file does not say.
    matrix : list of float
        Nine numbers in row order, pixels.
    distortion : tuple of float
        As in `Intrinsics.distortion`.

    """

    path: Path
    size: tuple[int, int] | None
    matrix: list[float]
    distortion: tuple[float, ...]

    def intrinsics(self, size: tuple[int, int]) -> Intrinsics:
        """
        Return the camera of images of a size.

        Raises
        ------
        InputError
            When the file is of another size, or its numbers cannot be a camera.

        """
        height, width = size
        if self.size is not None and self.size != size:
            raise InputError(
                f'{shown_path(self.path)}: image_width, image_height: must be {width} x {height}, '
                f'the size of the images, got {self.size[1]} x {self.size[0]}'
            )
        try:
            return Intrinsics.from_matrix(self.matrix, width, height, self.distortion)
        except InputError as error:
            raise InputError(f'{shown_path(self.path)}: camera_matrix: {error}') from error


def read_calibration(path: Path) -> Calibration:
    """
    Read a file as ``camera_calibration`` writes it (``ost.yaml``).

    Parameters
    ----------
    path : pathlib.Path
        A YAML file with ``camera_matrix``, and optionally ``image_width``, ``image_height``,
        ``distortion_model`` (``plumb_bob`` if left out) and ``distortion_coefficients``.

    Raises
    ------
    InputError
        When it is no such file, or has a lens that is not supported.

    """
    content = read_mapping(path)
    name = shown_path(path)
    matrix = _numbers(content, name, 'camera_matrix', (9,))
    model = content.get('distortion_model', 'plumb_bob')
    coefficients = []
    if 'distortion_coefficients' in content:
        coefficients = _numbers(content, name, 'distortion_coefficients', range(15))
    if not isinstance(model, str):
        raise InputError(f'{name}: distortion_model: must be a name, got {shown(model)}')
    return Calibration(
        path, _size(content, name), matrix, decode_distortion(model, coefficients, name)
    )


def _size(content: dict[str, Any], name: str) -> tuple[int, int] | None:
    height, width = (content.get(key) for key in ('image_height', 'image_width'))
    if height is None and width is None:
        return None
    if type(height) is int and type(width) is int:
        return height, width
    raise InputError(
        f'{name}: image_width, image_height: must be whole numbers of pixels, got '
        f'{shown([width, height])}'
    )


def _numbers(content: dict[str, Any], name: str, key: str, lengths: Any) -> list[float]:
    found = content.get(key)
    data = found.get('data') if isinstance(found, dict) else found
    if not isinstance(data, list) or len(data) not in lengths or not all(map(is_number, data)):
        wanted = 'nine numbers' if key == 'camera_matrix' else 'numbers'
        raise InputError(
            f'{name}: {key}: must have data, a list of {wanted}, as camera_calibration writes it, '
            f'got {"none" if found is None else shown(data)}'
        )
    return [float(value) for value in data]
