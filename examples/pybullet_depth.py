"""
Depth images of PyBullet with the noise of a Flexx2.

Run it where PyBullet and ``flexx2_sim_ros[figures]`` are installed:
``python examples/pybullet_depth.py``.
PyBullet's depth image is a z-buffer, which is not depth: a wall at 2.5 m has the value 0.98.
"""

import argparse
from pathlib import Path

from flexx2_sim_ros.camera import Camera, depth_from_z_buffer
import numpy as np
import pybullet
from small_room import BOXES, draw, EYE, FAR, LENS, NEAR, USECASE


def build() -> int:
    """Build the room without a window; return its physics client."""
    client = pybullet.connect(pybullet.DIRECT)
    for centre, half in BOXES.values():
        shape = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
        pybullet.createMultiBody(
            baseVisualShapeIndex=shape, basePosition=centre, physicsClientId=client
        )
    return client


def z_buffer(client: int) -> np.ndarray:
    """Return the camera's (H, W) float32 z-buffer: 0 at the near plane, 1 at the far plane."""
    view = pybullet.computeViewMatrix(EYE, np.add(EYE, (1.0, 0.0, 0.0)), (0.0, 0.0, 1.0))
    # TinyRenderer looks through the lower left corner of each pixel, and not through its centre.
    left, bottom = -NEAR * LENS.cx / LENS.fx, -NEAR * LENS.cy / LENS.fy
    right, top = left + NEAR * LENS.width / LENS.fx, bottom + NEAR * LENS.height / LENS.fy
    projection = pybullet.computeProjectionMatrix(left, right, bottom, top, NEAR, FAR)
    *_, buffer, _ = pybullet.getCameraImage(
        LENS.width,
        LENS.height,
        view,
        projection,
        renderer=pybullet.ER_TINY_RENDERER,  # on the CPU, without a window
        physicsClientId=client,
    )
    return np.reshape(buffer, (LENS.height, LENS.width))


def main() -> None:
    """Draw one frame."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--out', type=Path, default=Path('pybullet_depth.png'), help='picture')
    arguments = parser.parse_args()
    buffer = z_buffer(build())
    clean = depth_from_z_buffer(buffer, NEAR, FAR)
    frame = Camera(USECASE).capture(clean, LENS.matrix, stamp=0.0)
    draw(arguments.out, 'PyBullet: z-buffer', buffer, clean, frame.depth)
    print(f'{np.isfinite(frame.depth).mean():.0%} of the pixels are valid; see {arguments.out}')


if __name__ == '__main__':
    main()
