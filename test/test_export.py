"""The noise of a camera as parameters of mappers and simulators."""

import ast
import configparser
from dataclasses import replace
import math
import re
from xml.etree import ElementTree

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.export import measure_noise, TARGETS
from flexx2_sim_ros.profiles.files import find_profile
from flexx2_sim_ros.profiles.modes import flexx2
import numpy as np
import pytest
import yaml

CELL = 0.05


def written(name, usecase='Mode_9_30fps'):
    return TARGETS[name].write(measure_noise(flexx2(), usecase), CELL).text


@pytest.mark.parametrize('usecase', ['Mode_5_30fps', 'Mode_5_60fps', 'Mode_9_30fps'])
def test_elevation_mapping_has_the_sigma_of_the_camera(usecase):
    noise = measure_noise(flexx2(), usecase)
    table = yaml.safe_load(written('elevation_mapping', usecase))['sensor_processor']
    a, b, c, d, e = (table[f'normal_factor_{letter}'] for letter in 'abcde')
    z = noise.distance
    fitted = a + b * (z - c) ** 2 + d * z**e
    assert np.allclose(fitted / noise.typical, 1.0, atol=0.02)
    lens, mode = flexx2().intrinsics, flexx2().mode(usecase)
    assert table['lateral_factor'] == pytest.approx(mode.noise.sigma_x / lens.fx, rel=1e-3)
    assert table['cutoff_max_depth'] == mode.range_max
    assert table['type'] == 'structured_light'


def test_the_names_are_those_of_the_targets():
    perfect = yaml.safe_load(written('elevation_mapping_perfect'))
    assert perfect == {'sensor_processor': {'type': 'perfect'}}
    cupy = yaml.safe_load(written('elevation_mapping_cupy'))
    assert set(cupy) == {'sensor_noise_factor', 'min_valid_distance', 'max_ray_length'}
    server = yaml.safe_load(written('octomap_server'))['octomap_server']['ros__parameters']
    assert set(server) == {'resolution', 'sensor_model.max_range', 'sensor_model.hit'}
    assert 0.5 < server['sensor_model.hit'] < 1
    blocks = yaml.safe_load(written('nvblox'))['/**']['ros__parameters']
    assert blocks['static_mapper']['projective_integrator_weighting_mode'] == 'inverse_square'
    ini = configparser.ConfigParser(interpolation=None)
    ini.read_string(written('rtabmap'))
    assert float(ini['Core']['Grid\\RangeMax']) <= flexx2().mode('Mode_9_30fps').range_max


def test_gazebo_reads_a_depth_camera():
    sensor = ElementTree.fromstring(written('gazebo')).find('./model/link/sensor')
    assert sensor.get('type') == 'depth_camera'
    values = {name: sensor.findtext(f'.//{name}') for name in ('width', 'height', 'near', 'far')}
    assert values == {'width': '224', 'height': '172', 'near': '0.1', 'far': '7'}
    assert float(sensor.findtext('.//stddev') or 0) > 0
    lens = flexx2().intrinsics
    view = 2 * math.atan(lens.width / 2 / lens.fx)
    assert float(sensor.findtext('.//horizontal_fov') or 0) == pytest.approx(view, abs=1e-6)


@pytest.mark.parametrize('name', ['isaac_lab', 'mujoco_playground'])
def test_configurations_in_python_are_one_call(name):
    *_, last = ast.parse(written(name)).body
    assert isinstance(last, ast.Assign)
    assert isinstance(last.value, ast.Call)


def test_a_simulated_wall_has_the_sigma_of_the_model():
    # An offset leaves the noise as it is. 6,000 pixels a wall: a sigma is known to 0.9 %,
    # and 36 of them differ by over 6 % with a probability below 1e-8.
    effects = parse_effects({'offset': {'bias': 0.01}})
    noise = measure_noise(flexx2(), 'Mode_9_30fps', effects, distances=(0.4, 2.0))
    model = flexx2().mode('Mode_9_30fps').noise
    for j, angle in enumerate(noise.angles):
        expected = model.sigma_z(noise.distance, math.radians(angle))
        assert np.allclose(noise.sigma[:, j] / expected, 1.0, atol=0.06 if angle < 60 else 0.1)
    assert np.allclose(noise.bias[:, 0], 0.01, atol=1e-3)
    text = TARGETS['gazebo'].write(noise, CELL).text
    mean = float(ElementTree.fromstring(text).findtext('.//mean') or 0)
    assert mean == pytest.approx(0.01, abs=1e-3)


def test_lost_and_wrong_pixels_are_counted_apart():
    # At 100 MHz distances repeat after 1.5 m. A fifth of the 6,000 pixels of a wall is known to
    # 0.5 %: 5 % is 10 standard deviations.
    effects = parse_effects({'range_wrap': {'mhz': 100.0}, 'random_dropout': {'share': 0.2}})
    noise = measure_noise(flexx2(), 'Mode_5_60fps', effects, angles=(0.0,))
    near, far = noise.distance < 1.4, noise.distance > 1.6
    assert np.allclose(noise.lost[near], 0.2, atol=0.05)
    assert np.abs(noise.bias[near]).max() < 1e-3
    assert (noise.lost[far] == 1).all()
    assert np.isnan(noise.sigma[far]).all()
    for target in TARGETS.values():
        lost = target.write(noise, CELL).lost
        assert any('lost pixels: up to 100%' in sentence for sentence in lost)


def test_the_age_of_images_and_what_a_mean_bias_leaves_are_lost():
    effects = parse_effects({'time_offset': {'latency': 0.05, 'delay': 0.06}, 'wiggling': {}})
    noise = measure_noise(flexx2(), 'Mode_9_30fps', effects, angles=(0.0,))
    for name in ('gazebo', 'nvblox'):
        lost = ' '.join(TARGETS[name].write(noise, CELL).lost)
        assert 'age: an image shows the scene 110 ms before it arrives' in lost
        assert ('beside the mean' in lost) == (name == 'gazebo')
        assert re.search(r'bias: depth is up to \d+\.\d mm off', lost)
    plain = TARGETS['gazebo'].write(measure_noise(flexx2(), 'Mode_9_30fps'), CELL).lost
    assert not any('bias' in sentence or 'age' in sentence for sentence in plain)


def test_other_cameras_are_exported(tmp_path):
    out = tmp_path / 'kinect.yaml'
    assert main(['export', 'elevation_mapping', '--profile', 'kinect_v2', '--out', str(out)]) == 0
    assert yaml.safe_load(out.read_text())['sensor_processor']['type'] == 'structured_light'
    kinect = find_profile('kinect_v2')
    assert kinect.model in out.read_text()
    assert TARGETS['gazebo'].file_of(kinect) == 'kinect_v2.sdf'
    noise = measure_noise(replace(kinect, model='A---B'), kinect.default_usecase)
    model = ElementTree.fromstring(TARGETS['gazebo'].write(noise, CELL).text).find('model')
    assert model.get('name') == 'a_b'


@pytest.mark.parametrize('name', ['octomap_server', 'rtabmap'])
def test_a_sigma_above_half_a_cell_everywhere_is_said(name):
    noise = measure_noise(flexx2(), 'Mode_9_30fps')
    said = [TARGETS[name].write(noise, cell).lost for cell in (0.001, CELL)]
    assert [any('at all distances, so' in one for one in lost) for lost in said] == [True, False]


def test_all_targets_go_into_a_folder(tmp_path, capsys):
    assert main(['export', 'all', '--out', str(tmp_path / 'out'), '--distances', '0.3', '3']) == 0
    names = {path.name for path in (tmp_path / 'out').iterdir()}
    assert names == {target.file_of(flexx2()) for target in TARGETS.values()}
    assert 'None of them can hold' in capsys.readouterr().out


def test_a_file_is_written_over_only_by_force(tmp_path, capsys):
    out = tmp_path / 'flexx2.sdf'
    out.write_text('mine')
    assert main(['export', 'gazebo', '--out', str(out)]) == 2
    assert out.read_text() == 'mine'
    assert '--force' in capsys.readouterr().err
    assert main(['export', 'gazebo', '--out', str(out), '--force']) == 0
    assert out.read_text() != 'mine'


def test_distances_outside_the_range_are_refused():
    with pytest.raises(InputError, match='distances: must rise and be within'):
        measure_noise(flexx2(), 'Mode_9_30fps', distances=(3.0, 1.0))
    with pytest.raises(InputError, match='distances'):
        measure_noise(flexx2(), 'Mode_9_30fps', distances=(0.3, 50.0))
