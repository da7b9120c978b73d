"""Clean depth: exact geometry, the same from every backend, and reflectivity by surface."""

import os

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.model_cameras import VISIBLE_GROUPS
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.rendering.visibility import pixel_directions
from flexx2_sim_ros.robots.model import build_model, stand
from flexx2_sim_ros.robots.robot import CameraMount
import mujoco
import numpy as np
from programs import run_python
import pytest

FLEXX2 = Intrinsics.from_field_of_view(224, 172, 56.0, 44.0)
# Unequal focal lengths and an odd height, so that no mix-up goes unseen.
ODD = Intrinsics(200, 151, 300.0, 260.0, 99.5, 75.0)
AHEAD = CameraMount('eye', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
TRUNK = '<body name="trunk"><geom size="0.05" pos="-1 0 0"/></body>'
ROBOT = f'<mujoco><worldbody>{TRUNK}</worldbody></mujoco>'


@pytest.fixture(scope='session')
def opengl():
    """Return the OpenGL backend that works here."""
    renderer = open_renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), ODD)
    renderer.close()
    if renderer.backend == 'ray':
        pytest.skip(f'no OpenGL: {"; ".join(renderer.reasons)}')
    return renderer.backend


@pytest.fixture(params=['opengl', 'ray'])
def backend(request):
    """Return each backend that works here in turn."""
    return request.getfixturevalue('opengl') if request.param == 'opengl' else 'ray'


@pytest.fixture
def see(tmp_path, backend):
    """Render what one camera at the origin, looking along +x, sees of a scene's geoms."""

    def render(geoms, mount=AHEAD, assets='', **planes):
        (tmp_path / 'robot.xml').write_text(ROBOT)
        (tmp_path / 'scene.xml').write_text(
            f'<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>'
        )
        robot, scene = str(tmp_path / 'robot.xml'), str(tmp_path / 'scene.xml')
        model = build_model(robot, scene, intrinsics=ODD, mounts=[mount], **planes)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        renderer = open_renderer(model, ODD, backend)
        depth, geom_id = renderer.render(data, mount.name)
        renderer.close()
        assert depth.shape == geom_id.shape == (ODD.height, ODD.width)
        assert (depth.dtype, geom_id.dtype) == (np.float32, np.int32)
        np.testing.assert_array_equal(np.isnan(depth), geom_id < 0)
        return model, depth, geom_id

    return render


def rays():
    """Return (H, W, 3) optical rays of ODD with z = 1."""
    v, u = np.mgrid[: ODD.height, : ODD.width]
    return np.stack([(u - ODD.cx) / ODD.fx, (v - ODD.cy) / ODD.fy, np.ones(u.shape)], axis=-1)


@pytest.mark.parametrize('rpy', [(0.0, 0.0, 0.0), (0.3, 0.4, -0.5), (-0.2, -0.6, 0.3)])
def test_a_tilted_wall_has_its_known_depth_at_every_pixel(see, rpy):
    # Half a pixel of error in the principal point would show as 1 to 4 mm here.
    mount = CameraMount('eye', (0.1, -0.2, 0.3), rpy)
    _, depth, _ = see('<geom type="box" size="0.1 60 60" pos="2.1 0 0" euler="0 25 40"/>', mount)
    turn, quat = np.zeros(9), np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.radians([0, 25, 40]), 'xyz')
    mujoco.mju_quat2Mat(turn, quat)
    normal = turn.reshape(3, 3)[:, 0]
    distance = normal @ ([2.1, 0, 0] - 0.1 * normal - np.array(mount.position))
    expected = distance / (rays() @ mount.rotation.T @ normal)
    # Where the wall is out of reach or seen from behind, it says nothing.
    seen = (expected > 0.1) & (expected < 10)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(depth[seen], expected[seen], atol=1e-4)


def test_pixels_are_where_the_intrinsics_say_and_nothing_is_mirrored(see):
    # A box 1 m away, left and above of the axis: y 0.05..0.2, z 0.03..0.11.
    model, depth, geom_id = see("""
        <geom name="wall" type="box" size="0.1 5 5" pos="3.1 0 0"/>
        <geom name="box" type="box" size="0.01 0.075 0.04" pos="1.01 0.125 0.07"/>
        """)
    u = ODD.cx - ODD.fx * np.array([0.2, 0.05])
    v = ODD.cy - ODD.fy * np.array([0.11, 0.03])
    column, row = np.arange(ODD.width), np.arange(ODD.height)[:, None]
    inside = (column > u[0]) & (column < u[1]) & (row > v[0]) & (row < v[1])
    near = depth < 1.0005
    np.testing.assert_array_equal(near, inside)
    np.testing.assert_allclose(depth[inside], 1.0, atol=1e-4)
    np.testing.assert_array_equal(geom_id == model.geom('scene/wall').id, np.abs(depth - 3) < 1e-4)


def test_no_return_and_the_far_plane_are_nan(see):
    # Depth is along the axis: the wall's corners are farther than the far plane, but not in depth.
    narrow = '<geom type="box" size="0.1 0.5 9" pos="5.09 0 0"/>'
    behind = '<geom type="box" size="0.1 9 9" pos="5.2 0 0"/>'
    _, depth, geom_id = see(narrow + behind, far=5.0)
    middle = np.abs(rays()[..., 0]) < 0.5 / 5
    assert not np.isnan(depth[middle]).any()
    assert np.isnan(depth[~middle]).all()
    assert (geom_id[~middle] == -1).all()


def test_the_near_plane_cuts_nothing_within_the_range(see):
    _, depth, _ = see('<geom type="box" size="50 500 500" pos="50.03 0 0"/>')
    np.testing.assert_allclose(depth, 0.03, atol=1e-5)


def test_only_visible_shapes_are_seen(see):
    model, depth, geom_id = see("""
        <geom name="wall" type="box" size="0.1 5 5" pos="3.1 0 0" group="2"/>
        <geom type="box" size="0.1 5 5" pos="1 0 0" group="3"/>
        <geom type="box" size="0.1 5 5" pos="1.5 0 0" rgba="1 0 0 0"/>
        <geom name="glass" type="box" size="0.1 5 5" pos="2.1 5 0" rgba="1 1 1 0.3"/>
        <site type="box" size="0.1 5 5" pos="1.2 0 0"/>
        """)
    left = rays()[..., 0] < 0
    np.testing.assert_allclose(depth[left], 2.0, atol=1e-4)
    np.testing.assert_allclose(depth[~left], 3.0, atol=1e-4)
    assert set(geom_id[left]) == {model.geom('scene/glass').id}
    assert set(geom_id[~left]) == {model.geom('scene/wall').id}


@pytest.mark.parametrize('size', ['0 0.4 0.1', '0.4 0 0.1', '0 0 0.1', '0.4 3 0.1'])
def test_a_plane_ends_where_its_size_says(see, size):
    model, depth, geom_id = see(f"""
        <geom name="path" type="plane" size="{size}" pos="2 0 -0.5"/>
        <geom name="soil" type="box" size="60 60 0.5" pos="0 0 -1.5"/>
        """)
    x, y = (float(text) or np.inf for text in size.split()[:2])
    right, down = rays()[..., 0], np.maximum(rays()[..., 1], 1e-9)
    ahead = 0.5 / down
    # Half a pixel at the edges is left to the backend.
    margin = 2 * ahead / ODD.fy * np.maximum(1, ahead / 0.5)
    beyond = np.maximum(np.abs(ahead - 2) - x, np.abs(right * ahead) - y)
    seen = (rays()[..., 1] > 0.06) & (np.abs(beyond) > margin)
    on, off = seen & (beyond < 0), seen & (beyond > 0)
    assert on.any()
    assert off.any() == (size != '0 0 0.1')
    assert set(geom_id[on]) == {model.geom('scene/path').id}
    np.testing.assert_allclose(depth[on], ahead[on], rtol=1e-3)
    assert set(geom_id[off]) <= {model.geom('scene/soil').id}


def test_meshes_are_seen_on_both_sides(see, tmp_path):
    (tmp_path / 'roof.obj').write_text(
        'v 0 -9 -9\nv 0 9 -9\nv 0 9 9\nv 0 -9 9\nv 1 0 0\n'
        'f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 1 3 2\nf 1 4 3\n'
    )
    for turn in ('0 0 0', '0 0 180'):
        _, depth, _ = see(
            f'<geom type="mesh" mesh="roof" pos="2 0 0" euler="{turn}"/>',
            assets='<mesh name="roof" file="roof.obj" inertia="shell"/>',
        )
        assert not np.isnan(depth).any()
        assert np.ptp(depth) < 1.0


def test_rays_hit_what_single_rays_hit_from_near_a_stair():
    # Before MuJoCo 4.0, mj_multiRay sees through stair_1 from here.
    model = build_model(intrinsics=FLEXX2)
    data = mujoco.MjData(model)
    stand(model, data)
    data.qpos[:2] = 0.9, -0.1
    data.qpos[3], data.qpos[6] = np.cos(-0.7 / 2), np.sin(-0.7 / 2)
    mujoco.mj_forward(model, data)
    camera = model.camera('front_right').id
    _, found = open_renderer(model, FLEXX2, 'ray').render(data, 'front_right')
    rows, columns = np.mgrid[80:172:2, 0:224:2].reshape(2, -1)
    directions = pixel_directions(FLEXX2)[rows, columns] @ data.cam_xmat[camera].reshape(3, 3).T
    hit, single = np.zeros(1, np.int32), []
    for direction in directions:
        mujoco.mj_ray(model, data, data.cam_xpos[camera], direction, VISIBLE_GROUPS, 1, -1, hit)
        single.append(int(hit[0]))
    assert model.geom('scene/stair_1').id in single
    np.testing.assert_array_equal(found[rows, columns], single)


def test_a_part_that_does_not_collide_is_seen_beside_its_body(see):
    model, _, geom_id = see("""
        <geom name="wall" type="box" size="0.1 9 9" pos="6 0 0"/>
        <body pos="3 -2.5 0"><geom size="0.1"/>
          <geom name="sign" type="box" size="0.1 0.3 0.3" pos="0 2.5 0" contype="0"
                conaffinity="0"/></body>
        """)
    assert geom_id[75, 100] == model.geom('scene/sign').id


def test_a_renderer_that_was_never_closed_leaves_a_new_one_alone(opengl):
    model = build_model(intrinsics=FLEXX2)
    data = mujoco.MjData(model)
    stand(model, data)
    empty = mujoco.MjModel.from_xml_string('<mujoco/>')
    renderer = open_renderer(model, FLEXX2, opengl)
    expected, ids = renderer.render(data, 'front_left')
    dropped = open_renderer(empty, ODD, opengl)
    renderer = open_renderer(model, FLEXX2, opengl)
    del dropped
    depth, seen = renderer.render(data, 'front_left')
    renderer.close()
    np.testing.assert_array_equal(depth, expected)
    np.testing.assert_array_equal(seen, ids)


def test_a_camera_that_cannot_be_rendered_is_named(backend):
    model = build_model(intrinsics=FLEXX2)
    data = mujoco.MjData(model)
    renderer = open_renderer(model, FLEXX2, backend)
    with pytest.raises(InputError, match="camera: must be one of front_left, front.*, got 'rear'"):
        renderer.render(data, 'rear')
    renderer.close()
    other = Intrinsics.from_field_of_view(224, 172, 60.0, 44.0)
    renderer = open_renderer(model, other, backend)
    with pytest.raises(InputError, match='camera front_left: .*focal length'):
        renderer.render(data, 'front_left')
    renderer.close()


def test_an_unknown_backend_is_refused():
    with pytest.raises(InputError, match="backend: must be one of auto, egl.*, got 'cuda'"):
        open_renderer(mujoco.MjModel.from_xml_string('<mujoco/>'), ODD, 'cuda')


OPEN = """
import mujoco
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.renderer import open_renderer
renderer = open_renderer(mujoco.MjModel.from_xml_string('<mujoco/>'),
                         Intrinsics(8, 6, 9.0, 9.0, 3.5, 2.5))
print(renderer.backend, *renderer.reasons, sep='\\n')
"""
NO_LIBRARY = """
import ctypes
load = ctypes.CDLL.__init__
def refuse(self, name, *args, **kwargs):
    if name and any(part in str(name) for part in ('GL', 'OSMesa')):
        raise OSError(f'{name}: no such library')
    load(self, name, *args, **kwargs)
ctypes.CDLL.__init__ = refuse
"""


def opened(script, **environment):
    done = run_python('-c', script, env={**os.environ, **environment}, timeout=60, check=True)
    name, *reasons = done.stdout.splitlines()
    return name, reasons


def test_without_any_graphics_library_rays_are_cast():
    name, reasons = opened(NO_LIBRARY + OPEN)
    assert name == 'ray'
    assert [reason.split()[0] for reason in reasons] == ['egl', 'osmesa']
    assert all('needs' in reason for reason in reasons)


def test_a_graphics_library_without_a_driver_is_passed_over():
    name, reasons = opened(OPEN, __EGL_VENDOR_LIBRARY_FILENAMES='/nonexistent.json')
    if name == 'egl':
        pytest.skip('this EGL library does not look its drivers up in vendor files')
    assert name in ('osmesa', 'ray')
    assert reasons[0].startswith('egl does not work here')
