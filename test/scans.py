"""Runs of `flexx2 gap truth`; recordings of a blind camera in a room that is known as a mesh."""

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.rooms import load_room
import numpy as np
from scipy.spatial.transform import Rotation
from study.blind.meshes import write_mesh
from study.blind.scanned import off, ScannedCamera
import trimesh
import yaml

SEED, WIDTH, HEIGHT, RECORDINGS = 2, 112, 86, 4
SMALL_K = np.array([[25.0, 0, 15.5], [0, 25, 11.5], [0, 0, 1]])
SMALL = {'frames': 8, 'width': WIDTH, 'height': HEIGHT}
# The camera in the body that motion capture or odometry follows.
MOUNT = Pose.from_numbers(np.array([0.08, -0.02, 0.05, 0.3, -0.5, 0.4, 0.7]))


def _run(out, words):
    words = 'gap', 'truth', '--out', out, '--jobs', '1', *words
    return main([str(word) for word in words])


def truth(out, *words):
    """Make ground truth in the folder `out`; return the content of truth.yaml."""
    assert _run(out, words) == 0
    return yaml.safe_load((out / 'truth.yaml').read_text())


def refused(capsys, out, *words):
    """Return the error of the command, which leaves `out` as it was."""
    before = _content(out)
    assert _run(out, words) == 2
    assert _content(out) == before
    return ' '.join(capsys.readouterr().err.partition('flexx2: error: ')[2].split())


def _content(folder):
    # Without the intermediate results of a run, which the next one may need.
    files = (path for path in folder.glob('[!.]*') if path.is_file())
    return folder.exists() and {path: path.read_bytes() for path in files}


def text(pose):
    """Return a pose as options have it."""
    return ','.join(map(str, pose.numbers()))


IN_BODY = f'--camera-in-body={text(MOUNT)}'


def record(folder, effects, prepare=lambda camera: None, **changes):
    """Write `in/*.npz` and `room.ply`; return the camera, which `prepare` may change before."""
    camera = ScannedCamera(SEED, effects, **{'recordings': RECORDINGS, **SMALL, **changes})
    prepare(camera)
    (folder / 'in').mkdir(parents=True)
    camera.record(folder / 'in')
    write_mesh(camera.solids, folder / 'room.ply')
    return camera


def rough(pose, rng):
    """Return a pose 5 cm and 3 degrees off."""
    return Pose(*off(pose, 0.05, 3.0, rng))


def bodies(camera, wrong=False):
    """Return where the body was in each frame, or 5 cm and 3 degrees off."""
    poses = []
    for pose in camera.poses(0):
        one = rough(pose, np.random.default_rng(3)) if wrong else Pose(*pose)
        turn = one.R @ MOUNT.R.T
        poses.append(Pose(turn, one.t - turn @ MOUNT.t))
    return poses


def errors(out, camera):
    """Return the median error of clean depth in each frame of a walk, metres."""
    clean = open_recording(out / '0.npz').load().clean_depth
    return np.nanmedian(np.abs(clean - camera.camera.scenes.clean(0)[0]), axis=(1, 2))


def scaled(mesh, factor):
    """Return the mesh in another scale."""
    mesh.apply_scale(factor)
    return mesh


def box(folder):
    """Write `room.ply`, a bare box; return a pose in it, and (24, 32) metres of depth."""
    mesh = trimesh.creation.box((4.0, 3.0, 2.5))
    mesh.invert()
    mesh.export(folder / 'room.ply')
    turn = Rotation.from_euler('yxz', [35, -20, 3], degrees=True).as_matrix()
    pose = Pose(turn, np.array([0.2, 0.1, -0.3]))
    v, u = np.mgrid[:24, :32]
    rays = np.stack([(u - SMALL_K[0, 2]) / 25, (v - SMALL_K[1, 2]) / 25], axis=-1).reshape(-1, 2)
    seen = load_room(folder / 'room.ply').cast(pose, rays)
    return pose, seen.depth.reshape(24, 32).astype(np.float32)
