"""What the examples of simulators share: a small room, a camera in it and a picture."""

from pathlib import Path

from flexx2_sim_ros.camera import flexx2
import numpy as np

USECASE, RANGE = 'Mode_9_30fps', 7.0  # metres
LENS = flexx2().intrinsics  # 224 x 172 pixels, 56 x 44 degrees, the principal point in the middle
NEAR, FAR = 0.05, 20.0  # clipping planes, metres: beyond the range of every mode
EYE = (0.0, 0.0, 0.5)  # where the camera is, metres; it looks along +x, with z up
# Centre and half size of each box, metres. Above the wall and beside it there is nothing.
BOXES = {
    'floor': ((2.25, 0.0, -0.05), (1.75, 2.0, 0.05)),
    'wall': ((2.55, 0.2, 0.4), (0.05, 1.2, 0.4)),
    'box': ((1.5, 0.35, 0.2), (0.2, 0.15, 0.2)),
    'post': ((1.1, -0.3, 0.35), (0.02, 0.02, 0.35)),
}


def draw(path: Path, title: str, given: np.ndarray, clean: np.ndarray, seen: np.ndarray) -> None:
    """
    Draw what a simulator gives beside its depth, the Flexx2's depth and the noise.

    Parameters
    ----------
    path : pathlib.Path
        The PNG to write.
    title : str
        What ``given`` is.
    given : numpy.ndarray
        (H, W), in the simulator's own unit.
    clean, seen : numpy.ndarray
        (H, W) metres along the optical axis, without and with noise; NaN or 0 is invalid.

    """
    from matplotlib.figure import Figure

    clean, seen = (np.where(image > 0, image, np.nan) for image in (clean, seen))
    figure = Figure(figsize=(12, 2.6), layout='constrained')
    near, far = np.nanmin(clean), min(np.nanmax(clean), RANGE)
    shown = given[~(clean > RANGE)]
    for axis, image, text, limits in zip(
        figure.subplots(1, 4),
        (given, clean, seen, 1e3 * (seen - clean)),
        (title, 'depth, m', 'Flexx2, m', 'noise, mm'),
        ((np.nanmin(shown), np.nanmax(shown)), (near, far), (near, far), (-20.0, 20.0)),
        strict=True,
    ):
        colours = 'coolwarm' if text == 'noise, mm' else 'viridis'
        drawn = axis.imshow(image, vmin=limits[0], vmax=limits[1], cmap=colours)
        axis.set(title=text, xticks=[], yticks=[])
        figure.colorbar(drawn, ax=axis, shrink=0.9)
    figure.savefig(path, dpi=80)
