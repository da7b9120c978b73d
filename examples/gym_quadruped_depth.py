"""
Depth images of gym-quadruped (plain MuJoCo) with the noise of a Flexx2.

Run it where gym-quadruped and ``flexx2_sim_ros[figures]`` are installed, with
MUJOCO_GL=egl on a machine without a display: ``python examples/gym_quadruped_depth.py``.
``Camera.depth_image`` of gym-quadruped is not the depth that this needs: it holds distances along
the ray, computed with a focal length that takes MuJoCo's vertical field of view for the
horizontal one. MuJoCo's own renderer gives depth along the optical axis, and the distance of the
far plane where it sees nothing.
"""

import argparse
from pathlib import Path

from flexx2_sim_ros.camera import Camera, flexx2, Intrinsics
from gym_quadruped.quadruped_env import QuadrupedEnv
from gym_quadruped.sensors.rgbd_camera import Camera as GymCamera
import mujoco
import numpy as np
from small_room import draw, USECASE

WIDTH, HEIGHT = flexx2().intrinsics.width, flexx2().intrinsics.height
CAMERA = 'robotcam'  # in the head of the Aliengo, level


def build() -> QuadrupedEnv:
    """Return an Aliengo in front of stairs, in its pose at rest."""
    env = QuadrupedEnv('aliengo', scene='stairs')
    env.reset(random=False)
    return env


def lens(model: mujoco.MjModel) -> Intrinsics:
    """Return the camera's intrinsics: its pixels are square, and ``fovy`` is vertical."""
    focal = HEIGHT / 2 / np.tan(np.radians(model.camera(CAMERA).fovy[0]) / 2)
    return Intrinsics(WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)


def depth(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return (H, W) float32 metres along the optical axis, NaN where there is nothing."""
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.enable_depth_rendering()
        renderer.update_scene(data, CAMERA)
        image = renderer.render()
    far = model.vis.map.zfar * model.stat.extent
    return np.where(image < 0.999 * far, image, np.nan)


def gym_depth(env: QuadrupedEnv) -> np.ndarray:
    """Return the (H, W) image that gym-quadruped calls depth."""
    return GymCamera(WIDTH, HEIGHT, 30, env.mjModel, env.mjData, CAMERA).depth_image


def main() -> None:
    """Draw one frame."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument(
        '--out', type=Path, default=Path('gym_quadruped_depth.png'), help='picture'
    )
    arguments = parser.parse_args()
    env = build()
    clean = depth(env.mjModel, env.mjData)
    frame = Camera(USECASE).capture(clean, lens(env.mjModel).matrix, stamp=env.simulation_time)
    given = np.where(np.isnan(clean), np.nan, gym_depth(env) - clean)
    draw(arguments.out, 'its depth_image - depth, m', given, clean, frame.depth)
    print(f'{np.isfinite(frame.depth).mean():.0%} of the pixels are valid; see {arguments.out}')


if __name__ == '__main__':
    main()
