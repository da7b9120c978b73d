"""Walks with footholds from what cameras see: which fail, and the command from files to files."""

from dataclasses import replace
import json

from campaigns import write_diagnosis
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.walking import ExactCamera, KINDS, Point, SimulatedCamera, walk
from flexx2_sim_ros.walking.footsteps import REASONS
from flexx2_sim_ros.walking.terrain import Terrain
import numpy as np
import pytest

NAME = 'Mode_9_5fps'
SETTINGS = {'usecase': NAME, 'known': {'heavy_tails': {}}}
MODE = flexx2().mode(NAME)
# A quarter of the pixels, and a quarter of the points that a cell needs.
LENS = Intrinsics.from_field_of_view(112, 86, 56.0, 44.0)
SMALL = {'lens': LENS, 'mode': MODE, 'least': 2}
EXACT = ExactCamera(MODE.range_max)


class Blind:
    """A camera that sees nothing."""

    def __call__(self, views):
        """Return no depth."""
        return np.full_like(views.depth, np.nan)


def block(top, edge):
    """Return level ground with a block that begins at x = edge."""
    half = np.array([[10.0, 10.0, 0.5], [1.0, 1.0, 0.5]])
    centre = np.array([[[0.0, 0.0], [edge + 1.0, 0.0]]])
    return Terrain(half, centre, np.zeros((1, 2)), np.array([[0.0, top]]), np.full((1, 2), 0.5))


@pytest.mark.parametrize('kind', KINDS)
def test_no_walk_fails_on_level_ground(kind):
    cameras = {'exact': EXACT, 'noise': SimulatedCamera(NAME)}
    failed = walk(Point(kind, 0.0, 0, 4), cameras, **SMALL)
    assert (failed['exact'] == -1).all()
    assert (failed['noise'] == -1).all()


def test_a_wrong_or_blind_camera_fails_where_perfect_depth_does_not():
    cameras = {
        'exact': EXACT,
        'biased': SimulatedCamera(NAME, effects={'offset': {'bias': 0.1}}),
        'blind': Blind(),
    }
    failed = walk(Point('stairs', 0.06, 0, 4), cameras, **SMALL)
    assert (failed['exact'] == -1).all()
    assert (failed['biased'] == REASONS.index('wrong height')).all()
    assert (failed['blind'] == REASONS.index('no foothold')).all()
    # Steps beyond the reach of the legs end every walk.
    assert (walk(Point('stairs', 0.25, 0, 4), cameras, **SMALL)['exact'] >= 0).all()


def test_walks_do_not_depend_on_their_batch():
    cameras = {'noise': SimulatedCamera(NAME)}
    whole = walk(Point('rubble', 0.09, 0, 4), cameras, **SMALL)['noise']
    part = walk(Point('rubble', 0.09, 2, 2), cameras, **SMALL)['noise']
    np.testing.assert_array_equal(whole[2:], part)


def test_a_camera_with_latency_sees_from_where_it_was():
    seen = {}

    def look(views):
        depth, reflectivity = views.earlier(0.2)
        past = replace(views, depth=depth, reflectivity=reflectivity)
        seen['past'], seen['now'] = SimulatedCamera(NAME)(past), SimulatedCamera(NAME)(views)
        for part in ('latency', 'delay'):
            offset = {'latency': 0.0, 'delay': 0.0, part: 0.2}
            seen[part] = SimulatedCamera(NAME, effects={'time_offset': offset})(views)
        return views.depth

    walk(Point('stairs', 0.06, 0, 1), {'look': look}, **SMALL)
    np.testing.assert_array_equal(seen['latency'], seen['past'])
    np.testing.assert_array_equal(seen['delay'], seen['now'])
    assert not np.array_equal(seen['past'], seen['now'], equal_nan=True)


def test_images_show_the_terrain():
    seen = {}

    def look(views):
        seen['views'] = views
        return views.depth

    walk(Point('rubble', 0.12, 3, 2), {'look': look}, **SMALL)
    views = seen['views']
    v, u = np.mgrid[: LENS.height, : LENS.width]
    rays = np.stack([(u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, np.ones(u.shape)], axis=-1)
    camera, last = 1, -1
    for number in range(2):
        index = camera, last, number
        points = views.position[index] + (rays * views.depth[index][..., None]) @ (
            views.rotation[index].T
        )
        near = points[np.isfinite(points[..., 2]) & (views.depth[index] < 2)]
        ground = views.terrain.heights(np.broadcast_to(near[:, :2], (2, len(near), 2)))[number]
        # Points on the sides of blocks are below their tops.
        assert (near[:, 2] < ground + 1e-4).mean() > 0.98
        assert (np.abs(near[:, 2] - ground) < 1e-4).mean() > 0.8


def test_the_command_writes_the_figure(tmp_path, capfd):
    effects = {'offset': {'bias': 0.1}, 'warm_up_drift': {}}
    write_diagnosis(tmp_path / 'diagnosis', effects, SETTINGS)
    command = ['gap', 'walk', str(tmp_path / 'diagnosis'), '--out', str(tmp_path / 'out')]
    command += ['--walks', '2', '--steps', '0.06', '0.06', '--jobs', '2', '--json']
    assert main(command) == 0
    table = json.loads(capfd.readouterr().out)
    assert (tmp_path / 'out' / 'walk.png').read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'
    assert json.loads((tmp_path / 'out' / 'walk.json').read_text()) == table
    assert (list(table['effects']), table['left_out']) == (['offset'], ['warm_up_drift'])
    failed = {(row['terrain'], row['camera']): row['failed'] for row in table['rows']}
    assert failed['stairs', 'perfect depth'] == failed['stairs', 'noise model'] == 0
    assert failed['stairs', 'with diagnosed effects'] == 2
    assert len(failed) == 9


def test_legs_that_the_model_does_not_have_are_refused(tmp_path, capsys):
    write_diagnosis(tmp_path / 'diagnosis', {'offset': {'bias': 0.1}}, SETTINGS)
    text = (config_dir() / 'robots' / 'go1.yaml').read_text()
    assert 'FL_hip_joint' in text
    text = text.replace('../models', str(config_dir() / 'models')).replace('FL_hip_joint', 'FL_no')
    (tmp_path / 'mine.yaml').write_text(text)
    command = ['gap', 'walk', str(tmp_path / 'diagnosis'), '--out', str(tmp_path / 'out')]
    command += ['--walks', '1', '--steps', '0.06', '--robot', str(tmp_path / 'mine.yaml')]
    assert main(command) == 2
    assert 'robot: must have the legs of its file' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--robot', 'nobody'], 'robot: must be go1, go2'),
        (['--steps', '0.7'], 'steps: must be a number from 0 to 0.5'),
    ],
)
def test_wrong_options_are_refused(options, said, tmp_path, capsys):
    write_diagnosis(tmp_path / 'diagnosis', {'offset': {'bias': 0.1}}, SETTINGS)
    command = ['gap', 'walk', str(tmp_path / 'diagnosis'), '--out', str(tmp_path / 'out')]
    try:
        status = main([*command, *options])
    except SystemExit as ended:
        status = ended.code
    assert status == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()
