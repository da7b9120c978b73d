"""Camera matrices and lenses from the files in which people have them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
import re
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
    Read a calibration file.

    Parameters
    ----------
    path : pathlib.Path
        ``ost.yaml`` of ``camera_calibration``, what ``ros2 topic echo`` prints of a camera info, a
        file of OpenCV's ``FileStorage``, JSON of Open3D (``intrinsic_matrix``), of librealsense
        (``fx``, ``fy``, ``ppx``, ``ppy``) or of perception (``.intr``), or a text of 3 x 3 or
        4 x 4 numbers. Size and distortion may be left out.

    Raises
    ------
    InputError
        When it is no such file, or has a lens that is not supported.

    """
    content, name = read_mapping(path, as_yaml=_as_yaml), shown_path(path)
    model = content.get('distortion_model', 'plumb_bob')
    if not isinstance(model, str):
        raise InputError(f'{name}: distortion_model: must be a name, got {shown(model)}')
    key = _first(content, _DISTORTIONS)
    coefficients = _numbers(content, name, key, range(15)) if key else []
    distortion = decode_distortion(model, coefficients, name)
    return Calibration(path, _size(content, name), _matrix(content, name), distortion)


# By the programs above: camera_calibration, OpenCV, camera info, Open3D, librealsense.
_MATRICES = 'camera_matrix', 'cameraMatrix', 'k', 'K', 'intrinsic_matrix', 'intrinsics'
_DISTORTIONS = 'distortion_coefficients', 'distortionCoefficients', 'd', 'D', 'coeffs'
_PINHOLES = ('fx', 'fy', 'cx', 'cy'), ('fx', 'fy', 'ppx', 'ppy'), ('_fx', '_fy', '_cx', '_cy')
_SIZES = ('image_height', 'image_width'), ('height', 'width'), ('_height', '_width')
_NUMBERS = re.compile(r'[\s,;\[\]]+')


def _as_yaml(text: str) -> str:
    # OpenCV has a first line and tags of its own, and topics end each message with a line.
    text = re.sub(r'\A\s*%YAML[^\n]*\n', '', text).replace('!!opencv-matrix', '')
    text = re.split(r'^---\s*$', re.sub(r'\A\s*---\s*\n', '', text), maxsplit=1, flags=re.M)[0]
    words = [word for word in _NUMBERS.split(text) if word]
    if len(words) not in (9, 16) or not all(map(_is_written_number, words)):
        return text
    rows = 3 if len(words) == 9 else 4
    matrix = [float(word) for i in range(3) for word in words[rows * i : rows * i + 3]]
    return f'camera_matrix: {matrix}'


def _is_written_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _first(content: Mapping[str, Any], names: tuple[str, ...]) -> str:
    return next((name for name in names if name in content), '')


def _matrix(content: dict[str, Any], name: str) -> list[float]:
    found = content.get('intrinsics')
    inner = found if isinstance(found, dict) else content
    for names in _PINHOLES:
        if all(is_number(inner.get(one)) for one in names):
            fx, fy, cx, cy = (float(inner[one]) for one in names)
            return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    key = _first(content, _MATRICES) or 'camera_matrix'
    matrix = _numbers(content, name, key, (9,))
    if key == 'intrinsic_matrix' and not any((matrix[2], matrix[5])):  # Open3D: by column.
        matrix = [matrix[3 * i + j] for j in range(3) for i in range(3)]
    return matrix


def _size(content: dict[str, Any], name: str) -> tuple[int, int] | None:
    keys = next((keys for keys in _SIZES if any(key in content for key in keys)), _SIZES[0])
    height, width = (content.get(key) for key in keys)
    if height is None and width is None:
        return None
    if type(height) is int and type(width) is int:
        return height, width
    raise InputError(
        f'{name}: {keys[1]}, {keys[0]}: must be whole numbers of pixels, got '
        f'{shown([width, height])}'
    )


def _numbers(content: dict[str, Any], name: str, key: str, lengths: Any) -> list[float]:
    found = content.get(key)
    data = found.get('data') if isinstance(found, dict) else found
    if not isinstance(data, list) or len(data) not in lengths or not all(map(is_number, data)):
        wanted = 'numbers' if key in _DISTORTIONS else 'nine numbers'
        raise InputError(
            f'{name}: {key}: must have data, a list of {wanted}, as camera_calibration writes it, '
            f'got {"none" if found is None else shown(data)}'
        )
    return [float(value) for value in data]
