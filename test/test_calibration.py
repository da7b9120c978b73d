"""Calibrations as other programs write them."""

import json
import re

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording.calibration import read_calibration
import pytest

SIZE = 8, 10
# As programs write them: fx 211, fy 213, cx 4.5, cy 3.5, and for some k1 0.1.
LENSES = {
    'OpenCV': (
        '%YAML:1.0\n---\ncameraMatrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n'
        '   data: [ 2.11e+02, 0., 4.5, 0.,\n       213., 3.5, 0., 0., 1. ]\n'
        'distortionCoefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n'
        '   data: [ 1.0e-01, 0., 0., 0., 0. ]\n'
    ),
    'a topic': (
        'header:\n  frame_id: cam\nheight: 8\nwidth: 10\ndistortion_model: plumb_bob\n'
        'd:\n- 0.1\n- 0.0\nk:\n- 211.0\n- 0.0\n- 4.5\n- 0.0\n- 213.0\n- 3.5\n- 0.0\n- 0.0\n- 1.0\n'
        '---\nheader:\n  frame_id: cam\n---\n'
    ),
    'Open3D': (
        '{"width": 10, "height": 8,\n\t"intrinsic_matrix": [211, 0, 0, 0, 213, 0, 4.5, 3.5, 1]}'
    ),
    'librealsense': '{"width": 10, "height": 8, "fx": 211, "fy": 213, "ppx": 4.5, "ppy": 3.5}',
    'perception': '{"_cy": 3.5, "_cx": 4.5, "_fy": 213, "_height": 8, "_fx": 211, "_width": 10}',
    'librealsense in Python': (
        '{"width": 10, "height": 8, "fx": 2.11e2, "fy": 213, "ppx": 4.5, "ppy": 3.5,'
        ' "model": "distortion.brown_conrady", "coeffs": [1e-1, 0, 0, 0, 0]}'
    ),
    'Open3D with a pose': (
        '{"class_name": "PinholeCameraParameters", "extrinsic": [1], "intrinsic": '
        '{"width": 10, "height": 8, "intrinsic_matrix": [211, 0, 0, 0, 213, 0, 4.5, 3.5, 1]}}'
    ),
    'rows': '{"K": [[211, 0, 4.5], [0, 213, 3.5], [0, 0, 1]], "D": [[1e-01, 0, 0, 0, 0]]}',
    'Kalibr': (
        'cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.0, 0.0, 0.0]\n'
        '  distortion_model: radtan\n  intrinsics: [211.0, 213.0, 4.5, 3.5]\n'
        '  resolution: [10, 8]\n'
    ),
    'ROS 1': (
        'header: \n  seq: 1\nheight: 8\nwidth: 10\ndistortion_model: "plumb_bob"\nD: [0.1, 0.0]\n'
        'K: [211.0, 0.0, 4.5, 0.0, 213.0, 3.5, 0.0, 0.0, 1.0]\nbinning_x: 0\nroi: \n'
        '  x_offset: 0\n---\n'
    ),
    'of twice the size': (
        'height: 16\nwidth: 20\nk: [422.0, 0.0, 9.5, 0.0, 426.0, 7.5, 0.0, 0.0, 1.0]\n'
        'binning_x: 2\nbinning_y: 2\n'
    ),
    'text of Windows': '\ufeff211 0 4.5\r\n0 213 3.5\r\n0 0 1\r\n',
    **{
        f'OpenCV, {name}': f'K: [211, 0, 4.5, 0, 213, 3.5, 0, 0, 1]\n{name}: [0.1, 0, 0, 0, 0]\n'
        for name in (
            'Distortion_Coefficients',
            'distCoeffs',
            'dist_coeffs',
            'dist_coeff',
            'distortion',
        )
    },
    'text': '# fx 0 cx\n211 0 4.5\n0 213 3.5\n0 0 1\n',
    'four numbers': '211 213 4.5 3.5',
    'text of 4 x 4': '211 0 4.5 0\n0 213 3.5 0\n0 0 1 0\n0 0 0 1\n',
}


@pytest.mark.parametrize('program', LENSES)
def test_a_lens_is_read_from_the_files_of_other_programs(program, tmp_path):
    path = tmp_path / 'lens.txt'
    path.write_text(LENSES[program])
    camera = read_calibration(path).intrinsics(SIZE)
    assert camera.matrix.ravel().tolist() == [211.0, 0.0, 4.5, 0.0, 213.0, 3.5, 0.0, 0.0, 1.0]
    bent = any(word in LENSES[program] for word in ('0.1', '1.0e-01', '1e-'))
    assert camera.distortion[0] == (0.1 if bent else 0.0)


# The raw calibration of a camera's depth sensor: cx, cy, fx, fy, k1 to k6, two zeros, p2, p1.
AZURE = [0.513, 0.517, 0.4928, 0.4929, 0.55, -0.02, -0.003, 0.89, 0.09, -0.01, 0, 0, -7e-5, 2e-5]


def _azure(**changes):
    kind = 'CALIBRATION_LensDistortionModelBrownConrady'
    camera = {
        'Intrinsics': {'ModelParameters': AZURE, 'ModelType': kind},
        'Purpose': 'CALIBRATION_CameraPurposeDepth',
        'SensorHeight': 1024,
        'SensorWidth': 1024,
    }
    colour = {'Purpose': 'CALIBRATION_CameraPurposePhotoVideo'}
    return json.dumps({'CalibrationInformation': {'Cameras': [colour, camera | changes]}})


@pytest.mark.parametrize(
    ('size', 'binning', 'offset'),
    [
        ((576, 640), 1, (192, 180)),
        ((288, 320), 2, (96, 90)),
        ((1024, 1024), 1, (0, 0)),
        ((512, 512), 2, (0, 0)),
    ],
)
def test_the_calibration_of_an_azure_kinect_is_that_of_the_mode(size, binning, offset, tmp_path):
    """Assert the arithmetic of the vendor's SDK for each of its modes."""
    path = tmp_path / 'calibration.json'
    path.write_text(_azure())
    camera = read_calibration(path).intrinsics(size)
    side = 1024 / binning
    expected = [
        AZURE[2] * side,
        AZURE[3] * side,
        AZURE[0] * side - offset[0] - 0.5,
        AZURE[1] * side - offset[1] - 0.5,
    ]
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx(expected)
    assert camera.distortion == (0.55, -0.02, 2e-5, -7e-5, -0.003, 0.89, 0.09, -0.01)


@pytest.mark.parametrize(
    ('content', 'said'),
    [
        (_azure(), 'must be 10 x 8, the size of the images, got 1024 x 1024 with roi 640 x 576'),
        (_azure(Purpose='x'), 'CalibrationInformation: must have a depth camera'),
        (_azure(SensorWidth=640), 'SensorWidth, SensorHeight: must be 1024 x 1024'),
        (_azure(Intrinsics={'ModelType': 'Theta'}), 'ModelType: must be CALIBRATION_Lens'),
        (_azure(Intrinsics=None), 'ModelType: must be CALIBRATION_Lens'),
        ('{"CalibrationInformation": []}', 'CalibrationInformation: must have a depth camera'),
        (LENSES['Kalibr'].replace('radtan', 'equi'), 'distortion_model: must be plumb_bob or'),
        (LENSES['OpenCV'] + 'fisheye_model: 1\n', 'distortion_model: must be plumb_bob or'),
        (
            LENSES['librealsense in Python'].replace('n.brown', 'n.inverse_brown'),
            'distortion_model: must be plumb_bob or',
        ),
        ('1 2 3\n4 5 6\n7 8 9\n', 'K: must be [[fx, 0, cx]'),
        ('1 2 3\n', 'must be a YAML mapping'),
        ('K: [[1, 0], [nan, 1e999]]', 'K: must have data, a list of nine numbers'),
        (LENSES['rows'].replace('D', 'distortion_params'), "'distortion_params': must be called"),
        (LENSES['perception'].replace('}', ', "_skew": 3.0}'), 'K: must be [[fx, 0, cx]'),
        ('K: ' + '[' * 5000, 'at most 30 levels'),
    ],
)
def test_other_calibrations_are_refused_in_one_sentence(content, said, tmp_path):
    path = tmp_path / 'lens.txt'
    path.write_text(content)
    with pytest.raises(InputError, match=re.escape(said)):
        read_calibration(path).intrinsics(SIZE)
