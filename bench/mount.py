"""
How effects of a camera look like another mount: ``python -m bench.mount [EFFECT ...]``.

The blind camera takes four walks of 56 x 43 pixels through a furnished room, with one effect of
usual strength, and is mounted as it says. The table has the motion of the camera in its body that
`truth.joint` fits, beside a bias, a latency and bounced light: how far ground truth would move
with the effect if the mount were taken from the recordings. In parentheses: what the fit takes for
its standard deviation.
"""

from pathlib import Path
import sys
import tempfile

from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.truth import RoomRequest
from flexx2_sim_ros.truth.joint import fitted_motion
from flexx2_sim_ros.truth.registration import Registered, views_of
from flexx2_sim_ros.truth.run import GivenRecording
import numpy as np
from study.blind.meshes import write_mesh
from study.blind.scanned import ScannedCamera

WALKS, FRAMES, WIDTH, HEIGHT = 4, 8, 56, 43
EFFECTS = (
    'none', 'offset', 'intrinsics_error', 'multipath', 'wiggling', 'depth_scale', 'time_offset',
    'fixed_pattern', 'stray_light', 'motion_artefact',
)  # fmt: skip


def views(folder, effects):
    """Record walks; return the views of all recordings from their right poses."""
    camera = ScannedCamera(2, effects, WALKS, FRAMES, WIDTH, HEIGHT, moving=True)
    (folder / 'in').mkdir()
    camera.record(folder / 'in')
    write_mesh(camera.solids, folder / 'room.ply')
    request = RoomRequest(recordings=(), out=Path(), room=folder / 'room.ply')
    out = []
    for i in range(WALKS):
        path = folder / 'in' / f'{i}.npz'
        poses = tuple(Pose(*pose) for pose in camera.poses(i))
        where = Registered(poses, (0.0,) * FRAMES, True)
        out += views_of((i, GivenRecording(path, request), where))
    return out


def main(names):
    """Print the table."""
    print('| effect | x, y, z, mm | about x, y, z, degrees |\n|---|---|---|')
    for name in names:
        with tempfile.TemporaryDirectory() as text:
            seen = views(Path(text), {} if name == 'none' else {name: 1.0})
            motion, variance, _ = fitted_motion(seen)
        cells = [
            ', '.join(f'{one:.{digits}f} ({spread:.{digits}f})' for one, spread in pairs)
            for pairs, digits in (
                (1e3 * np.stack([motion, variance**0.5], axis=1)[:3], 1),
                (np.degrees(np.stack([motion, variance**0.5], axis=1)[3:]), 2),
            )
        ]
        print(f'| `{name}` | {" | ".join(cells)} |', flush=True)


if __name__ == '__main__':
    main(sys.argv[1:] or EFFECTS)
