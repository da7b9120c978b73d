"""
Depth images of Genesis with the noise of a Flexx2.

Run it where Genesis, torch and ``flexx2_sim_ros[figures]`` are installed
(``pip install genesis-world torch``): ``python examples/genesis_depth.py``. The first picture
compiles for minutes on a CPU.
Genesis gives depth along the optical axis, and the far plane for nothing. The intrinsics that it
gives count from the corner of the first pixel.
"""

import argparse
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Camera
import genesis
import numpy as np
from small_room import BOXES, draw, EYE, FAR, LENS, NEAR, USECASE

SQUARE = replace(LENS, fy=LENS.fx)  # pixels of Genesis are as high as wide


def build() -> Any:
    """Build the room on the CPU, without a window; return its camera."""
    genesis.init(backend=genesis.cpu, logging_level='warning')
    scene = genesis.Scene(show_viewer=False)
    for centre, half in BOXES.values():
        size = tuple(2 * side for side in half)
        scene.add_entity(genesis.morphs.Box(size=size, pos=centre, fixed=True))
    camera = scene.add_camera(
        res=(SQUARE.width, SQUARE.height),
        pos=EYE,
        lookat=(EYE[0] + 1.0, EYE[1], EYE[2]),
        up=(0.0, 0.0, 1.0),
        fov=2 * math.degrees(math.atan(SQUARE.height / 2 / SQUARE.fy)),  # from top to bottom
        near=NEAR,
        far=FAR,
    )
    scene.build()
    return camera


def rendered(camera: Any) -> np.ndarray:
    """Return Genesis's (H, W) float32 depth image, metres."""
    _, image, *_ = camera.render(rgb=False, depth=True)
    return np.asarray(image)


def depth(image: np.ndarray) -> np.ndarray:
    """Return (H, W) metres along the optical axis, NaN where nothing was drawn."""
    return np.where(image < 0.999 * FAR, image, np.nan)


def main() -> None:
    """Draw one frame."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--out', type=Path, default=Path('genesis_depth.png'), help='picture')
    arguments = parser.parse_args()
    image = rendered(build())
    clean = depth(image)
    # Not camera.intrinsics: centres of pixels are at whole numbers here.
    frame = Camera(USECASE).capture(clean, SQUARE.matrix, stamp=0.0)
    draw(arguments.out, 'Genesis: depth, m', image, clean, frame.depth)
    print(f'{np.isfinite(frame.depth).mean():.0%} of the pixels are valid; see {arguments.out}')


if __name__ == '__main__':
    main()
