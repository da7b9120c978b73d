"""Scenes of the demo and what they show: shapes, boards, and reflectivity by material."""

import math

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.rendering.rays import SceneGround
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.rendering.scenes import load_materials, place_board, reflectivity_table, SCENES
from flexx2_sim_ros.rendering.visibility import unseen_geoms
from flexx2_sim_ros.robots.model import build_model, stand
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import CameraMount, load_mounts
import mujoco
import numpy as np
import pytest
from walkers import LEGS, Walker

K = flexx2().intrinsics
CAMERAS = ('front_left', 'front_right')


def standing(scene, **options):
    """Return model and data of the robot standing in a scene."""
    model = build_model(scene=scene, intrinsics=K, **options)
    data = mujoco.MjData(model)
    stand(model, data)
    return model, data


def walking(scene, command, seconds):
    """Return a robot that has walked for some time."""
    walker = Walker(scene)
    for _ in range(round(seconds * 30)):
        walker.walk(command)
    mujoco.mj_forward(walker.model, walker.data)
    return walker


@pytest.mark.parametrize('scene', SCENES)
def test_the_robot_stands_in_every_scene_and_sees_something(scene):
    model, data = standing(scene)
    feet = [data.geom(f'{leg}_foot').xpos[2] for leg in LEGS]
    np.testing.assert_allclose(feet, 0.02, atol=1e-6)
    used = {model.mat(i).name.rsplit('/')[-1] for i in set(model.geom_matid) if i >= 0}
    assert used <= set(load_materials())  # no surface's reflectivity is left to a guess
    assert (model.geom_matid >= 0).all()
    renderer = open_renderer(model, K, 'ray')
    own = find_parts(model).geoms
    for camera in CAMERAS:
        depth, geom_id = renderer.render(data, camera)
        assert np.isfinite(depth).mean() > 0.99
        assert depth.min() > 0.3
        assert not own[geom_id[geom_id >= 0]].any()


@pytest.mark.parametrize('scene', SCENES)
def test_the_backends_agree(scene):
    walker = walking(scene, (0.4, 0.1, 0.2), 1.3)
    opengl = open_renderer(walker.model, K)
    if opengl.backend == 'ray':
        pytest.skip(f'no OpenGL: {"; ".join(opengl.reasons)}')
    ray = open_renderer(walker.model, K, 'ray')
    for camera in CAMERAS:
        seen, seen_id = opengl.render(walker.data, camera)
        exact, exact_id = ray.render(walker.data, camera)
        assert np.mean(np.isnan(seen) == np.isnan(exact)) > 0.999
        assert np.mean(seen_id == exact_id) > 0.995
        difference = np.abs(seen - exact)
        assert np.nanmedian(difference) < 1e-4
        assert np.nanmean(difference < 3e-3) > 0.99
    opengl.close()


def test_the_stairs_go_up_and_down():
    model, data = standing('stairs')
    ground = SceneGround(model, data, find_parts(model).geoms)
    x = np.arange(0.5, 5.5, 0.01)
    heights = ground.heights(np.stack([x, np.zeros(x.size)], axis=1), 2.0)
    rises = np.diff(heights)
    np.testing.assert_allclose(rises[np.abs(rises) > 0.01], [0.1] * 6 + [-0.1] * 6, atol=1e-6)


@pytest.mark.parametrize('colour', ['', 'rgba="1 0 0 0"', 'material="clear"'])
def test_the_robot_stands_and_walks_on_shapes_that_cannot_be_seen(colour, tmp_path):
    path = tmp_path / 'scene.xml'
    path.write_text(
        '<mujoco><asset><material name="clear" rgba="1 1 1 0"/></asset><worldbody>'
        '<geom type="plane" size="5 5 1" pos="0 0 0.1" contype="0" conaffinity="0"/>'
        f'<geom name="floor" type="box" size="5 5 0.5" pos="0 0 -0.4" {colour}/>'
        f'<geom type="box" size="0.1 5 1" pos="3 0 1" {colour}/></worldbody></mujoco>'
    )
    model, data = standing(str(path))
    assert data.geom('FR_foot').xpos[2] == pytest.approx(0.12, abs=1e-6)
    walker = walking(str(path), (0.5, 0.0, 0.0), 1.0)
    assert walker.pose.position[0] > 0.3
    assert walker.ground.heights(np.zeros(2), 1.0) == pytest.approx(0.1)
    assert walker.ground.free(np.array([1.0, 0, 0.5]), np.array([1.0, 0, 0])) == pytest.approx(1.9)
    # The model that is drawn keeps its colours.
    assert model.geom('scene/floor').rgba[3] == ('rgba' not in colour)
    assert model.mat('scene/clear').rgba[3] == 0


def test_the_rubble_is_the_same_every_time():
    one, other = (build_model(scene='rubble', intrinsics=K) for _ in range(2))
    np.testing.assert_array_equal(one.geom_pos, other.geom_pos)
    np.testing.assert_array_equal(one.geom_size, other.geom_size)


@pytest.mark.parametrize('camera', CAMERAS)
@pytest.mark.parametrize('backend', ['auto', 'ray'])
def test_the_board_has_exactly_the_distance_and_angle_asked_for(camera, backend):
    model, data = standing('board')
    renderer = open_renderer(model, K, backend)
    board = model.geom('scene/board').id
    u = np.arange(K.width)[None].repeat(K.height, axis=0)
    for distance in (0.3, 1.0, 7.0):
        for angle in (0.0, 30.0, 60.0, -45.0):
            place_board(model, data, camera, distance, angle)
            depth, geom_id = renderer.render(data, camera)
            slope = math.tan(math.radians(angle))
            expected = distance / (1 - slope * (u - K.cx) / K.fx)
            on_board = geom_id == board
            assert on_board[K.height // 2, K.width // 2]
            # The thin side of a board that turns away is seen as well: 0.02 m, nearer or farther.
            face = on_board & (np.abs(depth - expected) < 2e-4 * max(1.0, distance**2))
            assert face.sum() > 0.9 * on_board.sum()
            assert on_board.sum() > 200
            behind = geom_id == model.geom('scene/backdrop').id
            np.testing.assert_allclose(depth[behind], distance + 1.5, rtol=1e-3)
            assert (on_board | behind).all()
    renderer.close()


@pytest.mark.parametrize(
    ('scene', 'arguments', 'said'),
    [
        ('board', ('front_left', 0.05, 0.0), 'board_distance: must be 0.1 to 10 .*, got 0.05'),
        ('board', ('front_left', math.nan, 0.0), 'board_distance: must be .*, got nan'),
        ('board', ('front_left', 1.0, 85.0), 'board_angle_deg: must be -80 to 80, got 85.0'),
        ('board', ('rear', 1.0, 0.0), "board_camera: must be one of front_left.*, got 'rear'"),
        ('corner', ('front_left', 1.0, 0.0), "scene: must be 'board', got one without a board"),
    ],
)
def test_a_board_that_cannot_be_placed_is_refused(scene, arguments, said):
    with pytest.raises(InputError, match=said):
        place_board(*standing(scene), *arguments)


@pytest.mark.parametrize('backend', ['auto', 'ray'])
def test_the_front_legs_stay_visible(backend):
    model, data = standing('lab')
    legs = {f'{leg}_{part}' for leg in ('FR', 'FL') for part in ('hip', 'thigh', 'calf')}
    for name in CAMERAS:
        hidden = unseen_geoms(model, model.cam(name).id, K)
        bodies = {model.body(model.geom_bodyid[geom]).name for geom in np.flatnonzero(hidden)}
        assert not bodies & legs
        assert {'trunk', 'RR_calf', 'RL_calf'} <= bodies
    renderer = open_renderer(model, K, backend)
    # A foreleg stretched out ahead is in the picture.
    data.qpos[find_parts(model).leg_addresses[1]] = 0.1, -0.6, -0.9
    mujoco.mj_forward(model, data)
    _, geom_id = renderer.render(data, 'front_left')
    seen = {model.body(model.geom_bodyid[geom]).name for geom in np.unique(geom_id[geom_id >= 0])}
    assert 'FL_calf' in seen
    renderer.close()


def test_a_camera_elsewhere_sees_other_parts():
    rear = CameraMount('rear', (-0.25, 0.0, 0.05), (0.0, math.radians(25), math.pi))
    model = build_model(intrinsics=K, mounts=[*load_mounts(), rear])
    hidden = unseen_geoms(model, model.cam('rear').id, K)
    bodies = {model.body(model.geom_bodyid[geom]).name for geom in np.flatnonzero(hidden)}
    assert not {'RR_calf', 'RL_calf', 'RR_thigh'} & bodies
    assert {'FR_calf', 'FL_calf'} <= bodies


def test_reflectivity_follows_the_material_and_then_the_colour():
    model = build_model(intrinsics=K)
    table = reflectivity_table(model)
    assert (table.shape, table.dtype) == ((model.ngeom + 1,), np.float32)
    materials = load_materials()
    for geom, material in (
        ('scene/board_leaning', 'white_board'),
        ('scene/pole_black', 'black'),
        ('FR_foot', 'go1_rubber'),
        ('front_left_housing', 'flexx2_housing'),
    ):
        assert table[model.geom(geom).id] == pytest.approx(materials[material])
    assert table[-1] == 0.0


def test_reflectivity_without_a_listed_material_is_the_luminance():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <asset><material name="moss" rgba="0 1 0 1"/><material name="x/black" rgba="1 1 1 1"/>
          </asset>
          <worldbody>
            <geom size="1" rgba="1 0 0 1"/><geom size="1" material="moss"/>
            <geom size="1" material="moss" rgba="0 0 1 1"/><geom size="1" material="x/black"/>
          </worldbody>
        </mujoco>""")
    np.testing.assert_allclose(
        reflectivity_table(model, {'black': 0.04}), [0.2126, 0.7152, 0.0722, 0.04, 0], atol=1e-6
    )


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('schema: 1', 'materials'),
        ('{schema: 1, materials: [wood]}', 'materials'),
        ('{schema: 1, materials: {wood: 0.5}}', 'materials.wood'),
        ('{schema: 1, materials: {wood: {reflectivity: 1.5}}}', 'materials.wood'),
        ('{schema: 1, materials: {wood: {reflectivity: .nan}}}', 'materials.wood'),
        ('{schema: 1, materials: {wood: {reflectivity: bright}}}', 'materials.wood'),
    ],
)
def test_a_bad_material_file_is_named(tmp_path, text, said):
    path = tmp_path / 'materials.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_materials(path)
    assert str(path) in str(caught.value)
