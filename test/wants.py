"""What tests are skipped for want of, and how to get it."""

from collections import Counter
from collections.abc import Iterable
import re

_REAL = 'recordings of real cameras beside the checkout, in ../shared/data'
# Name: part of the reason of the skip (a regular expression), how to get it.
WANTS = {
    'browser': ('no Chromium', 'apt install chromium'),
    'shared': (r'shared.* is not there', _REAL),
    'opengl': ('no OpenGL', 'apt install libegl1 libgl1-mesa-dri, or libosmesa6'),
    'ros': ('rclpy', "pip install '.[all,ros]', or a sourced ROS 2 Jazzy"),
    'gpu': ('no GPU', 'an NVIDIA GPU with its driver'),
    'warp': ("warp-lang|'warp'", 'pip install warp-lang'),
    'truth': ("'(cv2|trimesh)'", "pip install '.[truth]'"),
    'tools': ("'(build|mcap|sphinx|twine)'", "pip install '.[test]'"),
    'hdf5': ("'h5py'", "pip install '.[hdf5]'"),
    'cluster': ('extra cluster', "pip install '.[cluster]'"),
    'menagerie': ("'mujoco_menagerie'", "pip install '.[menagerie]'"),
    'torch': ("'torch'", 'pip install torch'),
    'jax': ("'jax", 'pip install jax'),
    'mujoco_warp': ("'mujoco_warp'", 'pip install mujoco-warp'),
    'matrix': (
        'FLEXX2_MATRIX',
        'make matrix, which installs simulators in environments of their own',
    ),
    'mjlab': ("'mjlab'", 'make matrix, or pip install mjlab'),
    'simulators': (
        "'(genesis|gym_quadruped|mujoco_playground|pybullet|sapien)'",
        'make matrix, or pip install genesis-world, gym-quadruped, playground, pybullet or sapien',
    ),
    'isaaclab': ("'isaaclab'", 'make matrix, or pip install --no-deps isaaclab'),
    'vulkan': ('no Vulkan', 'apt install chromium, or a Vulkan driver'),
    'ament': ("'ament_", 'a sourced ROS 2 Jazzy with ament_flake8 and ament_pep257'),
    'launch': ("'launch", 'a sourced ROS 2 Jazzy'),
}
OTHER = 'other'
# What whole test files import. These files are skipped where it is not installed, as in a ROS
# workspace, where rosdep and pip install what the nodes, bags and tests need and no more.
OF_EXTRAS = ('cv2', 'h5py', 'mcap', 'trimesh', 'warp')


def want_of(reason: str) -> str:
    """Return the name of what a test was skipped for want of."""
    return next((name for name, (part, _) in WANTS.items() if re.search(part, reason)), OTHER)


def summary(reasons: Iterable[str]) -> list[str]:
    """Return a line for each thing that is wanted: how many tests, what, how to get it."""
    reasons = list(reasons)
    lines = [
        f'{count:4d}  {name}: {WANTS[name][1]}'
        for name, count in Counter(map(want_of, reasons)).most_common()
        if name != OTHER
    ]
    others = Counter(reason for reason in reasons if want_of(reason) == OTHER)
    return lines + [f'{count:4d}  {reason}' for reason, count in others.most_common()]
