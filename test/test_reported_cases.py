"""Bags and calibrations as outsiders have them; skipped where they are not."""

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
import numpy as np
from PIL import Image
import pytest
from real_frames import DATA

CASES = DATA.parent / 'cases' / 'real'
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
    assert main(['convert', str(case('bags', 'cdepth_png')), str(out)]) == 0
    return load_recording(out).depth


@pytest.mark.parametrize('name', BAGS)
def test_a_bag_of_any_driver_gives_the_same_depth(name, depth, tmp_path):
    out = tmp_path / 'out.npz'
    assert main(['convert', str(case('bags', name)), str(out), *BAGS[name]]) == 0
    found = load_recording(out)
    np.testing.assert_array_equal(found.depth, depth)
    assert found.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [365.5, 365.5, 75.5, 48.0]


@pytest.mark.parametrize('name', CALIBRATIONS)
def test_a_lens_from_any_common_file(name, tmp_path):
    path, out = case('calibrations', name), tmp_path / 'out.npz'
    (tmp_path / 'in').mkdir()
    size = (424, 512) if name.startswith('iai') else (480, 640)
    Image.fromarray(np.full(size, 900, np.uint16)).save(tmp_path / 'in' / '0.png')
    assert main(['convert', str(tmp_path / 'in'), str(out), '--calibration', str(path)]) == 0
    found = load_recording(out).K[[0, 1, 0, 1], [0, 1, 2, 2]]
    np.testing.assert_allclose(found, CALIBRATIONS[name], rtol=1e-6)
