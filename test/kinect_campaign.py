"""Real Kinect v2 frames of a chessboard as a campaign: its plane is the clean depth."""

from dataclasses import replace

from flexx2_sim_ros.camera import flexx2, NoiseModel
import numpy as np
from test_effects_real import board_plane, CENTRE, FOCAL, KINECT, square_coordinates, views


def write_campaign(folder, chosen):
    """Write single-frame recordings of some of the views; nothing off the board."""
    folder.mkdir(parents=True, exist_ok=True)
    with np.load(KINECT, allow_pickle=False) as data:
        boxes, corners = data['box_x0y0x1y1'], data['corners_px']
    for k in chosen:
        view = views()[k]
        x0, y0, x1, y1 = boxes[k]
        v, u = np.mgrid[y0:y1, x0:x1].astype(float)
        at = square_coordinates(corners[k].reshape(-1, 2), u, v)
        board = ((at > -0.9) & (at < np.array([4.9, 6.9])[:, None, None])).all(axis=0)
        a, b, c = board_plane(view, (view.white | view.black) & (view.depth > 0))
        plane = np.where(board, 1 / (a + b * view.x + c * view.y), np.nan)
        matrix = np.array([[FOCAL, 0, CENTRE[0] - x0], [0, FOCAL, CENTRE[1] - y0], [0, 0, 1]])
        np.savez(
            folder / f'view_{k:03d}.npz',
            clean_depth=plane,
            K=matrix,
            depth=np.where(board & (view.depth > 0), view.depth, np.nan).astype(np.float32)[None],
            amplitude=view.infrared,
            stamp=np.array([float(k)]),
            usecase='kinect2',
        )


def profile(chosen):
    """Return the camera, its noise measured on some of the views."""
    spreads = []
    for k in chosen:
        view = views()[k]
        good = view.white & (view.depth > 0) & (view.infrared < 30000)
        if good.sum() > 300:
            a, b, c = board_plane(view, good)
            error = (view.depth - 1 / (a + b * view.x + c * view.y))[good]
            spreads.append(1.4826 * float(np.median(np.abs(error - np.median(error)))))
    noise = NoiseModel(float(np.median(spreads)), 0.0, 0.0, 0.0, 1.0, 0.5)
    mode = replace(
        flexx2().mode('Mode_9_30fps'),
        name='kinect2',
        range_min=0.4,
        range_max=4.5,
        noise=noise,
        noise_of='kinect2',
    )
    return replace(flexx2(), model='Kinect v2', modes=(mode,))
