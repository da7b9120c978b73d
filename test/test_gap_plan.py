"""`flexx2 gap plan`: scenes, the checklist, the page, and the table of what a plan can find."""

from dataclasses import replace
import re

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.planning.plan import read_plan
from flexx2_sim_ros.gap.planning.power import compute, power, PowerRequest, shipped_table
from flexx2_sim_ros.gap.planning.scenes import card, PlannedScene, render, wall
from flexx2_sim_ros.gap.planning.truths import KINDS, smaller, write_campaign
from flexx2_sim_ros.recording.truth import read_truth
from flexx2_sim_ros.truth.plane_file import Measured, read_planes
import numpy as np
import pytest

TWO = """\
schema: 1
title: Two walls
usecase: Mode_9_30fps
simulation: {scale: 0.2, frames: 6}
recordings:
  - {name: near, title: Near, set_up: A wall., seconds: 5, for: [offset], walls: [[1.0, 40, 0.8]]}
  - {name: far, title: Far, set_up: A hand., seconds: 5, for: [multipath],
     walls: [[2.0, -40, 0.8]], cards: [[0.8, 0, 0.15, 0.5, 0.5]]}
"""


@pytest.fixture
def two(tmp_path):
    file = tmp_path / 'two.yaml'
    file.write_text(TWO)
    return file


def test_command_writes_a_checklist_with_every_recording_and_effect(tmp_path):
    out = tmp_path / 'plan'
    assert main(['gap', 'plan', '--out', str(out)]) == 0
    text, page = (out / 'checklist.md').read_text(), (out / 'plan.html').read_text()
    plan = read_plan()
    for planned in plan.recordings:
        command = f'flexx2 record recordings/{planned.name} --seconds {planned.seconds:g}'
        assert command in text
        assert command in page
    assert page.count('data:image/png;base64,') == len(plan.recordings)
    for name in registry():
        assert re.search(rf'^\| {name} \|', text, re.M)
    # In an hour, with time to set up: three minutes each.
    assert len(plan.recordings) <= 20
    assert {name for one in plan.recordings for name in one.effects} | {'pose_error'} == set(
        registry()
    )


def test_plan_has_a_form_for_what_is_measured(two, tmp_path):
    command = ['gap', 'plan', '--plan', str(two), '--out', str(tmp_path)]
    assert main(command) == 0
    path = tmp_path / 'planes.yaml'
    text = path.read_text()
    assert 'plane 1: {distance: ___, box: ___}  # 1 m tilted by 40 degrees' in text
    assert 'far' not in text  # Something moves there.
    (hint,) = read_planes(path).seen_in('near')
    assert (hint.distance, hint.box) == (None, ())
    filled = text.replace('distance: ___', 'distance: 0.766 +- 0.003')
    path.write_text(filled)
    assert main(command) == 0
    assert path.read_text() == filled
    (hint,) = read_planes(path).seen_in('near')
    assert hint.distance == Measured(0.766, 0.003)


def test_plan_of_another_camera_has_its_mode_and_its_name_in_the_commands(tmp_path, capsys):
    command = ['gap', 'plan', '--profile', 'kinect_v2', '--out', str(tmp_path)]
    assert main(command) == 0
    text = (tmp_path / 'checklist.md').read_text()
    assert 'recordings, mode depth_30fps.' in text
    assert 'gap start recordings/ --scan room.ply --out gap/ --profile kinect_v2' in text
    assert 'ros2 param set' not in text
    assert main([*command, '--usecase', 'Mode_9_30fps']) == 2
    assert 'usecase: must be one of depth_30fps' in capsys.readouterr().err


def test_a_plan_beyond_the_range_of_the_mode_is_refused(two, tmp_path):
    two.write_text(TWO.replace('[1.0, 40, 0.8]', '[20, 40, 0.8]').replace('[2.0,', '[20,'))
    plan = read_plan(two)
    plan = replace(plan, recordings=plan.recordings[:1])
    request = PowerRequest(plan, flexx2(), tmp_path, draws=2, kinds=KINDS[:1])
    with pytest.raises(InputError, match='--plan: must have recordings within the range of Mode'):
        compute(request, 'x', lambda text, share: None)


def test_shipped_table_says_what_made_it():
    table = shipped_table()
    assert table['command'].startswith('flexx2 gap plan')
    assert re.fullmatch(r'\d{4}-\d\d-\d\d', table['date'])
    assert set(table['kinds']) == {kind.name for kind in KINDS}
    assert set(table['effects']) == set(registry())
    for row in table['effects'].values():
        assert set(row) == set(table['kinds'])
    # A plane that is fitted to the recording takes an offset for itself.
    assert table['effects']['offset']['planes']['open']
    assert not table['effects']['offset']['exact']['open']


@pytest.mark.parametrize(
    ('before', 'after', 'says'),
    [
        ('for: [offset]', 'for: [offsets]', 'recording 1: for: must be among'),
        ('for: [offset]', 'for: [[offset]]', 'recording 1: for: must be among'),
        ('seconds: 5, for: [offset]', f'seconds: {10**400}, for: [offset]', 'seconds: must be'),
        ('name: near', 'name: ../near', 'recording 1: name: must be letters'),
        ('name: near', 'name: far', 'name: must be unique'),
        ('[[1.0, 40, 0.8]]', '[[1.0, 40]]', 'walls: must be \\[distance, tilt, reflectivity\\]'),
        ('[[1.0, 40, 0.8]]', '[[.nan, 40, 0.8]]', 'walls: distance: must be 0.05 to 100'),
        ('scale: 0.2', 'scale: 7', 'simulation: scale: must be 0.1 to 1, got 7'),
        ('schema: 1', 'schema: 2', 'schema'),
    ],
)
def test_a_wrong_plan_is_refused_with_its_key(two, before, after, says):
    two.write_text(TWO.replace(before, after))
    with pytest.raises(InputError, match=says):
        read_plan(two)


def test_truth_says_how_well_it_is_known(two, tmp_path):
    plan, lens = read_plan(two), smaller(flexx2().intrinsics, 0.2)
    shape = (plan.frames, lens.height, lens.width)
    for kind in KINDS:
        folder = tmp_path / kind.name
        folder.mkdir()
        write_campaign(folder, plan, flexx2(), kind, seed=1)
        for file in folder.glob('*.npz'):
            with np.load(file) as archive:
                content = dict(archive)
            read_truth(file, content, shape)
            assert content['depth'].shape == shape
            exact = kind.name == 'exact'
            assert exact == (not {'pose_covariance', 'plane_covariance'} & set(content))
        # Planes do not move, and a scan does not have the hand.
        assert (folder / 'far.npz').exists() == (kind.plane is None)
    with np.load(tmp_path / 'scan' / 'far.npz') as archive:
        hidden = ~archive['known']
        assert 0 < hidden.mean() < 0.2
        assert np.isnan(archive['clean_depth'][hidden]).all()


def test_an_interrupted_calculation_resumes(two, tmp_path, monkeypatch):
    plan = read_plan(two)
    plan = replace(plan, recordings=plan.recordings[:1])
    request = PowerRequest(plan, flexx2(), tmp_path, draws=2, kinds=KINDS[:1])
    few = {name: registry()[name] for name in ('offset', 'excess_noise', 'pose_error')}
    monkeypatch.setattr('flexx2_sim_ros.gap.planning.power.registry', lambda: few)
    asked = []
    interrupt = 3

    def counted(effect, *rest, **more):
        asked.append(effect)
        if len(asked) == interrupt:
            raise KeyboardInterrupt
        return real(effect, *rest, **more)

    real = power
    monkeypatch.setattr('flexx2_sim_ros.gap.planning.power.power', counted)
    with pytest.raises(KeyboardInterrupt):
        compute(request, 'x', lambda text, share: None)
    interrupt = 10**6
    asked.clear()
    shares = []
    table = compute(request, 'x', lambda text, share: shares.append(share))
    assert shares == sorted(shares)
    assert asked == list(few)[2:]
    assert set(table['effects']) == set(few)
    asked.clear()
    assert compute(request, 'x', lambda text, share: None) == table
    assert not asked


STAMP = np.arange(4) / 30
HAND = card(0.6, -0.1, 0.08, 0.5, (0.5, 0.0, 0.0))
SCENES = {
    'wall': PlannedScene((wall(2.0),)),
    'tilted': PlannedScene((wall(3.0, tilt=40.0),)),
    'corner': PlannedScene((wall(1.5, tilt=45.0), wall(1.5, tilt=-45.0))),
    'box': PlannedScene((wall(1.3), card(1.0, -0.4, 0.4, 0.6))),
    'hand': PlannedScene((wall(1.5), HAND)),
    'panning': PlannedScene((wall(1.5), card(0.8, 0.0, 0.15, 0.6)), turn_rate=40.0),
}


def test_rendered_depth_agrees_with_the_scenes_description():
    lens = flexx2().intrinsics
    depth = {name: render(scene, lens, STAMP)[0] for name, scene in SCENES.items()}
    assert np.allclose(depth['wall'], 2.0)
    x = (np.arange(lens.width) - lens.cx) / lens.fx
    tilted = 3.0 / (1 - np.tan(np.radians(40)) * x)
    assert np.allclose(depth['tilted'], tilted, rtol=1e-6)
    middle = depth['corner'][86]
    assert middle.argmax() in (111, 112)
    assert middle.max() == pytest.approx(1.5, abs=0.01)
    assert set(np.unique(depth['box'])) == {np.float32(1.0), np.float32(1.3)}
    hand = depth['hand'] < 1
    places = [np.flatnonzero(row[86]).mean() for row in hand]
    speed = 0.5 * lens.fx / 0.6 / 30  # pixels a frame
    assert np.diff(places) == pytest.approx(speed, abs=1.0)
    assert (np.diff([np.flatnonzero(row[86] < 1.2).mean() for row in depth['panning']]) < 0).all()


@pytest.mark.parametrize('scene', SCENES.values(), ids=SCENES)
def test_every_visible_surface_has_a_reflectivity(scene):
    depth, reflectivity, panel = render(scene, flexx2().intrinsics, STAMP)
    assert depth.shape == reflectivity.shape
    assert depth.ndim == (3 if scene.moving else 2)
    assert (np.isfinite(depth) == (reflectivity > 0)).all()
    assert (np.isfinite(depth) == (panel > 0)).all()
