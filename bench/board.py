"""
How accurate a printed board's pose is, and what it costs: ``python -m bench.board``.

Boards are drawn by a renderer that shares no code with the package: blurred by 0.6 pixels, seen in
the mean of 20 frames of an 8-bit gray image with 2 % of noise. Each line: the sheet, its distance,
how many of six views show tags, and medians over these views of the error of the board's place and
of its direction from corners of tags (PnP) and from gray values, of that along the board's normal
in its own standard deviations, and of the seconds of one view.
"""

from dataclasses import replace
import time

from bench.printed_board import Board, gray_of, HEIGHT, K, SHEETS, WIDTH
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.truth.board import find_board, find_tags, plane_covariance, poses_from
from flexx2_sim_ros.truth.gray import Gray
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.target import target_of
import numpy as np

DISTANCES = 0.5, 1.0, 1.5, 2.0, 2.5
VIEWS = (0, 0), (10, -5), (20, -25), (-15, 30), (35, 10), (-5, -40)  # degrees about x and y
FRAMES, NOISE, SEED = 20, 0.02, 1


def main() -> None:
    """Print a table."""
    rng = np.random.default_rng(SEED)
    rays = np.moveaxis(pixel_rays(Intrinsics.from_matrix(K, WIDTH, HEIGHT)), 0, -1)
    print(
        '| sheet | m | found | PnP | gray values | in sigmas | s |\n|---|---|---|---|---|---|---|'
    )
    for name in SHEETS:
        for distance in DISTANCES:
            boards = [Board(distance, *view, name=name) for view in VIEWS]
            rows = [row for board in boards if (row := _view(board, name, rays, rng))]
            if rows:
                corners, turn, place, direction, share, seconds = np.median(rows, axis=0)
                print(
                    f'| {name} | {distance} | {len(rows)}/{len(VIEWS)} | {corners:.1f} mm, '
                    f'{turn:.2f} deg | {place:.2f} mm, {direction:.2f} deg | {share:.1f} | '
                    f'{seconds:.2f} |',
                    flush=True,
                )


def _view(
    board: Board, name: str, rays: np.ndarray, rng: np.random.Generator
) -> tuple[float, ...] | None:
    target = replace(target_of(name), scale_error=0.0)
    light = board.look(rng)[0]
    gray = np.mean([gray_of(light, NOISE, rng) for _ in range(FRAMES)], axis=0)
    gray[gray >= 254] = np.nan
    tags = find_tags(target, gray)
    starts = poses_from(target, tags, rays) if tags else []
    begin = time.perf_counter()
    found = find_board(target, Gray(gray, rays), 0.0)
    seconds = time.perf_counter() - begin
    if isinstance(found, str) or not starts:
        return None
    middle = -found.pose.R.T @ found.pose.t
    sigma = np.sqrt(plane_covariance(found.pose, found.covariance, middle)[0, 0])
    along = abs(board.R[:, 2] @ (middle - board.t)) / sigma
    return *_errors(board, starts[0]), *_errors(board, found.pose), float(along), seconds


def _errors(board: Board, pose: Pose) -> tuple[float, float]:
    # Millimetres and degrees between normals.
    middle = -pose.R.T @ pose.t
    angle = np.degrees(np.arcsin(np.linalg.norm(np.cross(pose.R[2], board.R[:, 2]))))
    return float(np.linalg.norm(middle - board.t) * 1e3), float(angle)


if __name__ == '__main__':
    main()
