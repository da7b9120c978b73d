"""Camera matrices and lenses from the files in which people have them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import re
from typing import Any

from flexx2_sim_ros.config_file import read_mapping
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.messages.camera_info import (
    CameraFields,
    decode_camera_info,
    image_sizes,
    Region,
    size_words,
    with_size,
)
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.section import is_number

# What to do about a recording whose lens is missing or wrong.
WAY_OUT = 'flexx2 convert --calibration FILE or --intrinsics FX FY CX CY says the lens'


@dataclass(frozen=True)
class Calibration:
    """
    What the calibration file `name` says.

    ``modes`` has it as a camera info, for each size of the images; a size of 0 x 0 is any.
    """

    name: str
    modes: tuple[CameraFields, ...]

    def intrinsics(
        self, size: tuple[int, int], rectified: bool = False, notes: list[str] | None = None
    ) -> Intrinsics:
        """
        Return the camera of images of a size (height, width).

        ``rectified`` and ``notes`` are as for `decode_camera_info`. Raises InputError when the
        file is of another size, or its numbers cannot be a camera.
        """
        fields = next((one for one in self.modes if _fits(one, size)), None)
        if fields is None:
            sizes = ', '.join(size_words(one) for one in self.modes)
            raise InputError(
                f'{self.name}: image_width, image_height: must be {size[1]} x {size[0]}, '
                f'the size of the images, got {sizes}'
            )
        sized = with_size(fields, size)
        camera = decode_camera_info(sized, self.name, size, rectified, notes)
        inside = 0 <= camera.cx < size[1] and 0 <= camera.cy < size[0]
        if notes is not None and not inside and not fields.width:
            notes.append(
                f'{self.name}: cx, cy: {camera.cx:g}, {camera.cy:g} are outside of the image, '
                f'{size[1]} x {size[0]}: is it the lens of images of another size?'
            )
        return camera


def _fits(fields: CameraFields, size: tuple[int, int]) -> bool:
    return size in image_sizes(fields) or not (fields.height or fields.width)


def calibration_of(numbers: Sequence[float]) -> Calibration:
    """Return the calibration of fx, fy, cx, cy, as ``--intrinsics`` has them."""
    return Calibration('--intrinsics', (CameraFields(0, 0, _pinhole(*numbers)),))


def read_calibration(path: Path) -> Calibration:
    """
    Read a calibration file; size and distortion may be left out.

    It is ``ost.yaml`` of ``camera_calibration``, what ``ros2 topic echo`` prints of a camera info,
    a file of OpenCV's ``FileStorage`` (YAML), ``camchain.yaml`` of Kalibr, JSON of Open3D
    (``intrinsic_matrix``), of librealsense (``fx``, ``fy``, ``ppx``, ``ppy``), of Azure Kinect
    (``calibration.json``, its depth camera) or of perception (``.intr``), or a text of 3 x 3 or 4
    x 4 numbers or of fx, fy, cx, cy. Raises InputError when it is no such file.
    """
    content, name = read_mapping(path, as_yaml=_as_yaml), shown_path(path)
    if _AZURE in content:
        return Calibration(name, _azure_kinect(content[_AZURE], name))
    for key in _WITHIN:
        inner = content.get(key)
        if isinstance(inner, dict):
            content = {**content, **inner}
    height, width = _size(content, name)
    distortion = _distortion(content, name)
    return Calibration(
        name,
        (
            CameraFields(
                height,
                width,
                _matrix(content, name),
                distortion,
                _model(content, name, distortion),
                _projection(content),
                _whole(content, 'binning_x'),
                _whole(content, 'binning_y'),
                Region(**{key: _whole(content.get('roi'), key) for key in _REGION}),
            ),
        ),
    )


# By the programs above: camera_calibration, OpenCV, camera info, Open3D, librealsense, Kalibr.
_WITHIN = 'intrinsic', 'intrinsics', 'depth', 'depth_intrinsics', 'cam0'
_MATRICES = (
    'camera_matrix',
    'cameraMatrix',
    'Camera_Matrix',
    'k',
    'K',
    'intrinsic_matrix',
    'intrinsics',
)
_DISTORTIONS = (
    'distortion_coefficients',
    'distortionCoefficients',
    'd',
    'D',
    'coeffs',
    'distortion_coeffs',
    'Distortion_Coefficients',
    'distCoeffs',
    'dist_coeffs',
    'dist_coeff',
    'distortion',
)
_PROJECTIONS = 'projection_matrix', 'p', 'P'
_PINHOLES = ('fx', 'fy', 'cx', 'cy'), ('fx', 'fy', 'ppx', 'ppy'), ('_fx', '_fy', '_cx', '_cy')
_SKEWS = '_skew', 'skew'
_SIZES = ('image_height', 'image_width'), ('height', 'width'), ('_height', '_width')
_REGION = 'x_offset', 'y_offset', 'height', 'width'
_NO_LENS = ('', 'none', 'pinhole')
_NUMBERS = re.compile(r'[\s,;\[\]]+')
# Of the raw calibration of Azure Kinect. Numbers are fractions of the sensor, from the corner of
# its first pixel (mode_specific_calibration.c of Azure-Kinect-Sensor-SDK, 2ce46da).
_AZURE = 'CalibrationInformation'
_AZURE_MODEL = 'CALIBRATION_LensDistortionModelBrownConrady'
_AZURE_SIDE = 1024
_AZURE_NARROW = Region(192, 180, 576, 640)
_AZURE_MODES = (_AZURE_NARROW, 1), (_AZURE_NARROW, 2), (Region(), 1), (Region(), 2)


def _pinhole(fx: float, fy: float, cx: float, cy: float) -> list[float]:
    return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]


def _as_yaml(text: str) -> str:
    # OpenCV has a first line and tags of its own, and topics end each message with a line.
    text = re.sub(r'\A\ufeff?(\s*%YAML[^\n]*\n)?', '', text).replace('!!opencv-matrix', '')
    text = re.split(r'^---\s*$', re.sub(r'\A\s*---\s*\n', '', text), maxsplit=1, flags=re.M)[0]
    lines = (line for line in text.splitlines() if not line.lstrip().startswith('#'))
    words = [word for word in _NUMBERS.split('\n'.join(lines)) if word]
    if len(words) not in (4, 9, 16) or not all(_number(word) is not None for word in words):
        return text
    numbers = [float(word) for word in words]
    if len(words) == 4:
        return f'camera_matrix: {_pinhole(*numbers)}'
    rows = 3 if len(words) == 9 else 4
    return f'camera_matrix: {[numbers[rows * i + j] for i in range(3) for j in range(3)]}'


def _number(value: Any) -> float | None:
    # YAML 1.1 takes 1e-05, as JSON has it, for a text.
    if is_number(value):
        return float(value)
    try:
        found = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        return None
    return found if math.isfinite(found) else None


def _first(content: Mapping[str, Any], names: tuple[str, ...]) -> str:
    return next((name for name in names if name in content), '')


def _matrix(content: dict[str, Any], name: str) -> list[float]:
    for names in _PINHOLES:
        found = [_number(content.get(one)) for one in names]
        if None not in found:
            matrix = _pinhole(*(float(one) for one in found if one is not None))
            matrix[1] = _number(content.get(_first(content, _SKEWS))) or 0.0  # else refused
            return matrix
    key = _first(content, _MATRICES) or 'camera_matrix'
    matrix = _numbers(content, name, key, (4, 9) if key == 'intrinsics' else (9,))
    if len(matrix) == 4:  # Kalibr
        return _pinhole(*matrix)
    if key == 'intrinsic_matrix' and not any((matrix[2], matrix[5])):  # Open3D: by column.
        matrix = [matrix[3 * i + j] for j in range(3) for i in range(3)]
    return matrix


def _distortion(content: dict[str, Any], name: str) -> list[float]:
    key = _first(content, _DISTORTIONS)
    # A lens must not be lost for the name of its coefficients.
    other = next((one for one in content if _is_distortion(one, content[one])), '')
    if other and not key:
        raise InputError(
            f'{name}: {shown(other)}: must be called {_DISTORTIONS[0]} to be read as distortion'
        )
    return _numbers(content, name, key, range(15)) if key else []


def _is_distortion(key: Any, value: Any) -> bool:
    word = str(key).lower().replace('_', '')
    return word.startswith(('distor', 'distcoef')) and isinstance(value, list | dict)


def _model(content: dict[str, Any], name: str, distortion: Sequence[float]) -> str:
    key = _first(content, ('distortion_model', 'model'))
    model = content.get(key, '')
    if not isinstance(model, str):
        raise InputError(f'{name}: {key}: must be a name, got {shown(model)}')
    if content.get('fisheye_model'):  # OpenCV
        return 'fisheye'
    model = model.removeprefix('distortion.')  # librealsense in Python
    if model.lower() not in _NO_LENS:
        return model
    return 'rational_polynomial' if any(distortion[5:]) else 'plumb_bob'


def _projection(content: dict[str, Any]) -> list[float]:
    found = content.get(_first(content, _PROJECTIONS))
    numbers = [_number(value) for value in _flat(found)]
    projection = [value for value in numbers if value is not None]
    return projection if len(projection) == len(numbers) == 12 else [0.0] * 12


def _size(content: dict[str, Any], name: str) -> tuple[int, int]:
    keys = next((keys for keys in _SIZES if any(key in content for key in keys)), _SIZES[0])
    height, width = (content.get(key) for key in keys)
    resolution = content.get('resolution')  # Kalibr
    if height is None and width is None and isinstance(resolution, list) and len(resolution) == 2:
        width, height = resolution
    if height is None and width is None:
        return 0, 0
    if type(height) is int and type(width) is int:
        return height, width
    raise InputError(
        f'{name}: {keys[1]}, {keys[0]}: must be whole numbers of pixels, got '
        f'{shown([width, height])}'
    )


def _whole(content: Any, key: str) -> int:
    value = content.get(key) if isinstance(content, dict) else None
    return value if type(value) is int and 0 <= value < 1 << 32 else 0


def _flat(found: Any) -> list[Any]:
    # Of a matrix with its data, a list, or a list of rows.
    data = found.get('data') if isinstance(found, dict) else found
    if not isinstance(data, list):
        return []
    rows = (row if isinstance(row, list) else [row] for row in data)
    return [value for row in rows for value in row]


def _numbers(content: dict[str, Any], name: str, key: str, lengths: Any) -> list[float]:
    found = content.get(key)
    data = found.get('data') if isinstance(found, dict) else found
    values = _flat(data)
    numbers = [number for number in map(_number, values) if number is not None]
    whole = isinstance(data, list) and len(numbers) == len(values)
    if not whole or len(numbers) not in lengths:
        wanted = 'nine numbers' if lengths == (9,) else 'numbers'
        raise InputError(
            f'{name}: {key}: must have data, a list of {wanted}, as camera_calibration writes it, '
            f'got {"none" if found is None else shown(data)}'
        )
    return numbers


def _azure_kinect(content: Any, name: str) -> tuple[CameraFields, ...]:
    cameras = content.get('Cameras') if isinstance(content, dict) else None
    for camera in cameras if isinstance(cameras, list) else ():
        if isinstance(camera, dict) and camera.get('Purpose') == 'CALIBRATION_CameraPurposeDepth':
            break
    else:
        raise InputError(f'{name}: {_AZURE}: must have a depth camera, got none')
    sides = camera.get('SensorHeight'), camera.get('SensorWidth')
    if sides != (_AZURE_SIDE, _AZURE_SIDE):
        raise InputError(
            f'{name}: SensorWidth, SensorHeight: must be {_AZURE_SIDE} x {_AZURE_SIDE}, got '
            f'{shown(sides)}'
        )
    lens = camera.get('Intrinsics')
    lens = lens if isinstance(lens, dict) else {}
    if lens.get('ModelType') != _AZURE_MODEL:
        raise InputError(
            f'{name}: ModelType: must be {_AZURE_MODEL}, got {shown(lens.get("ModelType"))}'
        )
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = _numbers(
        lens, name, 'ModelParameters', (14,)
    )
    matrix = _pinhole(
        fx * _AZURE_SIDE, fy * _AZURE_SIDE, cx * _AZURE_SIDE - 0.5, cy * _AZURE_SIDE - 0.5
    )
    distortion = k1, k2, p1, p2, k3, k4, k5, k6
    return tuple(
        CameraFields(
            _AZURE_SIDE,
            _AZURE_SIDE,
            matrix,
            distortion,
            'rational_polynomial',
            binning_x=binning,
            binning_y=binning,
            roi=region,
        )
        for region, binning in _AZURE_MODES
    )
