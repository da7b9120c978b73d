"""Ground truth from a scan: meshes with holes, and what cannot be used."""

import json
import os
from pathlib import Path
import struct

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import load_recording, open_recording
from flexx2_sim_ros.truth.clean import render
from flexx2_sim_ros.truth.observation import observe
from flexx2_sim_ros.truth.registration import Registered
from flexx2_sim_ros.truth.rooms import load_room
from flexx2_sim_ros.truth.search import _orientations
from flexx2_sim_ros.truth.verdict import check_room, RoomFit
import numpy as np
import pytest
from scans import box, HEIGHT, record, refused, scaled, SMALL_K, text, truth, WIDTH
from study.blind.meshes import write_mesh
import trimesh


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    """Return a folder with `in/0.npz` and `room.ply` of a camera without effects."""
    folder = tmp_path_factory.mktemp('plain')
    return folder, record(folder, {}, recordings=1)


def test_nothing_is_known_where_the_mesh_has_a_hole(tmp_path, plain):
    folder, camera = plain
    pose = Pose(*camera.poses(0)[0])
    rays = observe(open_recording(folder / 'in' / '0.npz'), None).still.rays
    whole = render(load_room(folder / 'room.ply'), pose, rays, 0.003)
    write_mesh(camera.solids, tmp_path / 'fine.ply', 0.2)
    mesh = trimesh.load_mesh(tmp_path / 'fine.ply', process=False)
    # What the middle of the image shows is cut out.
    ahead = pose.t + pose.R[:, 2] * whole.depth[HEIGHT // 2, WIDTH // 2]
    far = np.linalg.norm(mesh.triangles_center - ahead, axis=1) > 0.4
    trimesh.Trimesh(mesh.vertices, mesh.faces[far], process=False).export(tmp_path / 'hole.ply')
    holed = render(load_room(tmp_path / 'hole.ply'), pose, rays, 0.003)
    gone = ~np.isfinite(holed.depth)
    assert gone[HEIGHT // 2, WIDTH // 2]
    assert not holed.known[gone].any()
    assert holed.known[~gone].mean() > 0.8
    assert whole.known.all()


def test_colours_of_the_mesh_become_reflectivity(tmp_path):
    box = trimesh.creation.box((4, 4, 4))
    box.visual.face_colors = [128, 128, 128, 255]
    for name in ('room.ply', 'room.glb'):
        box.export(tmp_path / name)
        hits = load_room(tmp_path / name).cast(Pose(np.eye(3), np.zeros(3)), np.zeros((1, 2)))
        assert hits.depth[0] == pytest.approx(2.0, abs=1e-6)
        assert hits.reflectivity[0] == pytest.approx(128 / 255, abs=0.01)


def test_a_material_of_one_colour_says_nothing_of_reflectivity(tmp_path):
    plain = trimesh.visual.material.PBRMaterial(baseColorFactor=[200, 200, 200, 255])
    box = trimesh.creation.box((4, 4, 4))
    box.visual = trimesh.visual.TextureVisuals(material=plain)
    box.export(tmp_path / 'room.glb')
    hits = load_room(tmp_path / 'room.glb').cast(Pose(np.eye(3), np.zeros(3)), np.zeros((1, 2)))
    assert hits.depth[0] == pytest.approx(2.0, abs=1e-6)
    assert hits.reflectivity is None


def chain(name, nodes, **buffer):
    """Return a function that writes a GLB of a box with other nodes or another buffer."""

    def write(folder):
        data = trimesh.Scene(trimesh.creation.box((4, 4, 4))).export(file_type='glb')
        end = 20 + int.from_bytes(data[12:16], 'little')
        table = json.loads(data[20:end])
        if nodes:
            table |= {'nodes': nodes, 'scenes': [{'nodes': [0]}]}
        table['buffers'][0] |= buffer
        text = json.dumps(table).encode()
        text += b' ' * (-len(text) % 4)
        body = struct.pack('<I4s', len(text), b'JSON') + text + data[end:]
        (folder / name).write_bytes(struct.pack('<4sII', b'glTF', 2, 12 + len(body)) + body)
        return folder / name

    return write


def lines(name, content, box=False):
    """Return a function that writes a text file, with a box as in .obj files behind it."""

    def write(folder):
        (folder / 'plain.mtl').write_text('newmtl a\n')
        solid = trimesh.exchange.obj.export_obj(trimesh.creation.box((4, 4, 4)))
        (folder / name).write_text(content + (solid if box else ''))
        return folder / name

    return write


def mjcf(name, assets, geom):
    return lines(name, f'<mujoco>{assets}<worldbody><geom {geom}/></worldbody></mujoco>')


def mesh(solid):
    """Return a function that writes a mesh or points."""

    def write(folder):
        solid.export(folder / 'a.ply')
        return folder / 'a.ply'

    return write


BOX = 'type="box" size="1 1 1"'
MESH = '<asset><mesh name="m" file="pipe"/></asset>'
BREAKING = {
    'no colour in the .mtl': (lines('a.obj', 'mtllib plain.mtl\nusemtl a\n', True), 'as a mesh'),
    'no such vertex': (lines('a.obj', 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n'), 'as a mesh'),
    'huge vertex': (lines('a.obj', 'v 1e308 0 0\nv -1e308 0 0\nv 0 1 0\nf 1 2 3\n'), 'inf x'),
    'cycle': (chain('a.glb', [{'children': [1]}, {'children': [0], 'mesh': 0}]), 'as a mesh'),
    'NaN': (chain('a.glb', [{'mesh': 0, 'matrix': [float('nan')] * 16}]), 'finite numbers'),
    'buffer of a pipe': (chain('a.glb', [], uri='pipe'), 'pipe: must be an ordinary file'),
    'pose of NaN': (mjcf('a.xml', '', f'{BOX} pos="nan 0 0"'), 'within 1e+06 m'),
    'huge pose': (mjcf('a.xml', '', f'{BOX} pos="1e308 0 0"'), 'within 1e+06 m'),
    'includes a pipe': (mjcf('a.xml', '<include file="pipe"/>', BOX), 'an ordinary file'),
    'includes itself': (mjcf('a.xml', '<include file="a.xml"/>', BOX), 'does not compile'),
    'mesh of a pipe': (mjcf('a.xml', MESH, 'type="mesh" mesh="m"'), 'an ordinary file'),
    'memory': (mjcf('a.xml', '<size memory="100000G"/>', BOX), 'does not compile'),
    'millimetres': (mesh(scaled(trimesh.creation.box((4, 4, 4)), 1000.0)), 'like millimetres'),
    'no faces': (mesh(trimesh.PointCloud(np.eye(3))), 'no faces'),
}


@pytest.mark.parametrize('kind', BREAKING)
def test_a_room_that_breaks_its_library_is_one_sentence(tmp_path, kind):
    make, words = BREAKING[kind]
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(InputError) as error:
        load_room(make(tmp_path))
    assert words in str(error.value)
    assert '\n' not in str(error.value)


def mirrored(folder):
    room = trimesh.load_mesh(folder / 'room.ply', process=False)
    return trimesh.Trimesh(room.vertices * (-1, 1, 1), room.faces, process=False)


@pytest.mark.parametrize(
    ('room', 'words'),
    [
        (lambda folder: trimesh.creation.icosphere(radius=3.0), 'must be the room of'),
        (lambda folder: trimesh.Trimesh([[1, 0, 0], [1, 2, 0], [1, 2, 2]], [[0, 1, 2]]), 'free'),
        (mirrored, 'must not be mirrored'),
    ],
)
def test_a_room_that_is_another_one_is_one_sentence(tmp_path, plain, capsys, room, words):
    room(plain[0]).export(tmp_path / 'other.ply')
    scan = '--scan', tmp_path / 'other.ply'
    assert words in refused(capsys, tmp_path / 'out', plain[0] / 'in' / '0.npz', *scan)


# What four recordings of one furnished room fit of another one, found without a pose; of 2 bare
# walls and 4 other views of the right room; of the right room with one view of elsewhere.
@pytest.mark.parametrize(
    ('fitting', 'states', 'wrong'),
    [
        ((0.17, 0.67, 0.54, 0.82), 'refused doubtful refused used', True),
        (
            (0.5, 0.5, 0.97, 0.95, 0.96, 0.97),
            'refused refused used doubtful doubtful doubtful',
            False,
        ),
        ((0.97, 0.3), 'used refused', False),
    ],
)
def test_one_recording_that_fits_by_chance_does_not_make_it_the_room(fitting, states, wrong):
    verdicts = [
        RoomFit(state, (), part, 0.01, (0.001, 0.1))
        for state, part in zip(states.split(), fitting, strict=True)
    ]
    registered = [Registered((None,), (0.1,), False, 1.0)] * len(verdicts)
    if wrong:
        with pytest.raises(InputError, match='must be the room of the recordings'):
            check_room(Path('room.ply'), False, registered, verdicts)
    else:
        check_room(Path('room.ply'), False, registered, verdicts)


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'stamp': np.array([0, 1, 2, 3, 5e8, 5e8 + 1, 5e8 + 2, 5e8 + 3])}, 'of one clock'),
        ({'distortion': np.zeros(9)}, 'distortion: must be'),
    ],
)
def test_a_recording_that_cannot_be_used_is_one_sentence(tmp_path, capsys, changes, words):
    _, depth = box(tmp_path)
    arrays = {'depth': np.tile(depth, (8, 1, 1)), 'stamp': np.arange(8) / 30, **changes}
    np.savez(tmp_path / 'bad.npz', K=SMALL_K, **arrays)
    scan = '--scan', tmp_path / 'room.ply'
    assert words in refused(capsys, tmp_path / 'out', tmp_path / 'bad.npz', *scan)


def test_a_moving_recording_that_does_not_fit_is_refused_and_the_others_go_on(tmp_path, capsys):
    pose, depth = box(tmp_path)
    (tmp_path / 'in').mkdir()
    rng = np.random.default_rng(1)
    # Leaves in the wind: no frame has a surface.
    leaves = rng.uniform(1, 4, (2, *depth.shape)).astype(np.float32)
    stamp = np.arange(2) / 30
    np.savez(tmp_path / 'in' / 'leaves.npz', depth=leaves, K=SMALL_K, stamp=stamp)
    out = tmp_path / 'out'
    words = tmp_path / 'in', '--scan', tmp_path / 'room.ply'
    words += f'--pose={text(pose)}', '--motion', 'moving'
    assert 'must be the room of the recordings' in refused(capsys, out, *words)
    seen = depth + rng.normal(0, 0.002, (2, *depth.shape)).astype(np.float32)
    np.savez(tmp_path / 'in' / 'room.npz', depth=seen, K=SMALL_K, stamp=stamp)
    # Somebody stands in front in the second of three frames.
    both = np.stack([seen[0], leaves[0], seen[1]])
    np.savez(tmp_path / 'in' / 'seen.npz', depth=both, K=SMALL_K, stamp=np.arange(3) / 30)
    rows = truth(out, *words)['recordings']
    known = load_recording(out / 'seen.npz').extra['known'].mean(axis=(1, 2))
    assert (known > 0.5).tolist() == [True, False, True]
    assert known[1] == 0
    assert [row['verdict'] == 'refused' for row in rows] == [True, False, False]
    assert rows[0]['reasons'] == [
        'the camera is lost: none of the frames that were tried fits the room'
    ]


@pytest.mark.parametrize('motion', ['still', 'moving', 'auto'])
def test_what_a_mask_of_each_frame_hides_is_not_registered_and_stays_unknown(tmp_path, motion):
    pose, depth = box(tmp_path)
    rng = np.random.default_rng(2)
    seen = depth + rng.normal(0, 0.002, (8, *depth.shape)).astype(np.float32)
    known = np.ones(seen.shape, bool)
    known[:4, :, :14] = known[4:, :, 18:] = False
    seen[~known] = 0.5  # The robot's own legs.
    file = tmp_path / 'walk.npz'
    bright = depth**-2 * np.where(known, 1000, 50_000) * rng.normal(1, 0.02, seen.shape)
    np.savez(file, depth=seen, K=SMALL_K, stamp=np.arange(8) / 30, known=known, amplitude=bright)
    out = tmp_path / 'out'
    words = '--scan', tmp_path / 'room.ply', f'--pose={text(pose)}', '--motion', motion
    (row,) = truth(out, file, *words)['recordings']
    assert row['verdict'] == 'used'
    assert row['motion'] == ('moving' if motion == 'moving' else 'still')
    with np.load(out / 'walk.npz') as written:
        assert not written['known'][~known].any()
        assert written['known'][known].mean() > 0.9
        assert row['known'] == pytest.approx(written['known'].mean(), abs=1e-3)
        # Of the room alone; the legs are 50 times as bright.
        assert np.nanmedian(written['reflectivity']) > 0.2
        clean = np.broadcast_to(written['clean_depth'], seen.shape)
        assert np.abs(clean - depth)[written['known']].max() < 0.02


def test_a_third_of_the_poses_that_are_tried_are_level():
    """Assert it at every heading and pitch: most cameras on robots are not rolled."""
    up = np.array([0.0, 0.0, 1.0])
    across = _orientations(up)[:, :, 0] @ up
    assert np.isclose(across, 0, atol=1e-6).mean() == pytest.approx(1 / 3, abs=0.01)
