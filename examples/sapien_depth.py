"""
Depth images of SAPIEN (the simulator of ManiSkill) with the noise of a Flexx2.

Run it where SAPIEN and ``flexx2_sim_ros[figures]`` are installed:
``python examples/sapien_depth.py``. It needs a Vulkan driver. Without a GPU, let
VK_ICD_FILENAMES name one that computes on the CPU:
lavapipe of Mesa 24.3 or later, or Chromium's vk_swiftshader_icd.json.
SAPIEN's picture ``Position`` is in the axes of OpenGL: depth is minus its z, not its z. Its w is
the z-buffer.
"""

import argparse
from pathlib import Path

from flexx2_sim_ros.camera import Camera
import numpy as np
import sapien
from small_room import BOXES, draw, EYE, FAR, LENS, NEAR, USECASE


def build() -> tuple[sapien.Scene, sapien.render.RenderCameraComponent]:
    """Build the room with the camera; whoever uses the camera has to keep the scene."""
    scene = sapien.Scene()
    for name, (centre, half) in BOXES.items():
        builder = scene.create_actor_builder()
        builder.add_box_visual(half_size=half)
        builder.initial_pose = sapien.Pose(centre)
        builder.build_static(name=name)
    camera = scene.add_camera('flexx2', LENS.width, LENS.height, 1.0, NEAR, FAR)
    # SAPIEN counts from the corner of the first pixel, `Intrinsics` from its centre.
    camera.set_perspective_parameters(
        NEAR, FAR, LENS.fx, LENS.fy, LENS.cx + 0.5, LENS.cy + 0.5, 0.0
    )
    camera.set_entity_pose(sapien.Pose(EYE))  # looks along +x
    return scene, camera


def positions(scene: sapien.Scene, camera: sapien.render.RenderCameraComponent) -> np.ndarray:
    """Return (H, W, 4) float32: x right, y up, z backwards in metres, and the z-buffer."""
    scene.update_render()
    camera.take_picture()
    return camera.get_picture('Position')


def depth(position: np.ndarray) -> np.ndarray:
    """Return (H, W) metres along the optical axis, NaN where nothing was drawn."""
    return np.where(position[..., 3] < 1.0, -position[..., 2], np.nan)


def main() -> None:
    """Draw one frame."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--out', type=Path, default=Path('sapien_depth.png'), help='picture')
    arguments = parser.parse_args()
    position = positions(*build())
    clean = depth(position)
    frame = Camera(USECASE).capture(clean, LENS.matrix, stamp=0.0)
    draw(arguments.out, 'SAPIEN: z of Position, m', position[..., 2], clean, frame.depth)
    print(f'{np.isfinite(frame.depth).mean():.0%} of the pixels are valid; see {arguments.out}')


if __name__ == '__main__':
    main()
