"""What outsiders' files and reports hit, on those files; skipped where they are not."""

import os
from pathlib import Path
import shutil
import sys

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
import numpy as np
from PIL import Image
from programs import run_python
import pytest
from real_frames import DATA

CASES = DATA.parent / 'cases'
LENS = ['--intrinsics', '365.5', '365.5', '75.5', '48']
# The same three frames of a Kinect, as drivers publish them; what each bag needs to be said.
BAGS = {
    'adi_16uc1_both': [],
    'cdepth_png': [],
    'cdepth_rvl': [],
    'equidistant_zero': [],
    'iai_kinect2.bag': [],
    'k_zero': LENS,
    'model_brown_conrady': [],
    'mono16_depth': [],
    'no_camera_info': LENS,
    'rational_14': [],
}
CALIBRATIONS = {
    'camera-intrinsics.txt': (585.0, 585.0, 320.0, 240.0),
    'iai_kinect2_calib_ir.yaml': (378.416556, 383.191856, 253.668916, 190.054661),
    'open3d_intrinsic.json': (617.25, 617.548645, 317.39212, 245.980194),
    'primesense.intr': (525.0, 525.0, 319.5, 239.5),
}
REPORTS = (
    '01_isaaclab_config_roundtrip',
    '02_orbbec_plumb_bob_8',
    '03_partial_reset_advances_time',
    '04_constant_stamp_says_streaming',
    '07_unusable_calibration_is_read',
    '09_invalid_is_65535',
    '10_one_frame_twice',
    '11_compressed_depth_16bit',
    '12_binning_and_roi',
    '13_realsense_viewer_bag',
    '16_rectified_depth',
    '17_calibration_files',
    '19_two_terms_one_noise',
    '21_tf_of_old_ros1_bags',
)


def case(*parts):
    """Return the path of a case, or skip the test."""
    path = CASES.joinpath(*parts)
    if not path.exists():
        pytest.skip(f'{path} is not there')
    return path


@pytest.fixture(scope='module')
def depth(tmp_path_factory):
    """Return the frames that all bags have."""
    out = tmp_path_factory.mktemp('whole') / 'whole.npz'
    assert main(['convert', str(case('real', 'bags', 'cdepth_png')), str(out)]) == 0
    return load_recording(out).depth


@pytest.mark.parametrize('name', BAGS)
def test_a_bag_of_any_driver_gives_the_same_depth(name, depth, tmp_path):
    out = tmp_path / 'out.npz'
    assert main(['convert', str(case('real', 'bags', name)), str(out), *BAGS[name]]) == 0
    found = load_recording(out)
    np.testing.assert_array_equal(found.depth, depth)
    assert found.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [365.5, 365.5, 75.5, 48.0]


@pytest.mark.parametrize('name', CALIBRATIONS)
def test_a_lens_from_any_common_file(name, tmp_path):
    path, out = case('real', 'calibrations', name), tmp_path / 'out.npz'
    (tmp_path / 'in').mkdir()
    size = (424, 512) if name.startswith('iai') else (480, 640)
    Image.fromarray(np.full(size, 900, np.uint16)).save(tmp_path / 'in' / '0.png')
    assert main(['convert', str(tmp_path / 'in'), str(out), '--calibration', str(path)]) == 0
    found = load_recording(out).K[[0, 1, 0, 1], [0, 1, 2, 2]]
    np.testing.assert_allclose(found, CALIBRATIONS[name], rtol=1e-6)


@pytest.mark.parametrize('name', REPORTS)
def test_the_script_of_a_report_finds_the_right_value(name, tmp_path, child_env):
    folder = tmp_path / 'reports'
    shutil.copytree(case('reports'), folder)
    program = (folder / f'{name}.py').read_text()
    for library in ('rclpy', 'warp', 'torch'):
        if f'import {library}' in program:
            pytest.importorskip(library)
    commands = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    done = run_python(f'{name}.py', cwd=folder, env=child_env | {'PATH': commands})
    assert done.returncode == 0, done.stdout + done.stderr
