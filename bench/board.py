"""
How accurate a printed board's pose is, and what it costs: ``python -m bench.board [--diagnose]``.

Boards are drawn by a renderer that shares no code with the package: blurred by 0.6 pixels, seen in
the mean of 20 frames of an 8-bit gray image with 2 % of noise. Each line: the sheet, its distance,
how many of six views show tags, and medians over these views of the error of the board's place and
of its direction from corners of tags (PnP) and from gray values, of that along the board's normal
in its own standard deviations, and of the seconds of one view.

With ``--diagnose``: what the diagnosis says of six boards at 0.6 to 1.6 m, recorded without an
effect and with an offset. Each line: the offset, the error of the lens that ground truth is told
(``--lens-error``; the lens itself is exact), ``residual_mm`` of ``truth.yaml``, and the diagnosis:
its verdict, the effects that it names with their parameters, and what it cannot decide.
"""

import argparse
from dataclasses import replace
from pathlib import Path
import tempfile
import time
from typing import Any

from bench.printed_board import Board, gray_of, HEIGHT, K, SHEETS, WIDTH
from flexx2_sim_ros.camera import Camera, Intrinsics
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.truth import BoardRequest, make_board_truth
from flexx2_sim_ros.truth.board import find_board, find_tags, plane_covariance, poses_from
from flexx2_sim_ros.truth.gray import Gray
from flexx2_sim_ros.truth.poses import Pose
from flexx2_sim_ros.truth.target import target_of
import numpy as np

DISTANCES = 0.5, 1.0, 1.5, 2.0, 2.5
VIEWS = (0, 0), (10, -5), (20, -25), (-15, 30), (35, 10), (-5, -40)  # degrees about x and y
FRAMES, NOISE, SEED = 20, 0.02, 1
MODE, RATE = 'Mode_9_5fps', 5.0
DIAGNOSED = 0.6, 0.8, 1.0, 1.2, 1.4, 1.6  # metres, one for each of VIEWS
OFFSETS, LENS_ERRORS = (0.0, 0.008), (0.003, 0.001)  # metres; fractions


def main() -> None:
    """Print one of the tables."""
    parser = argparse.ArgumentParser(description='Measure ground truth from a printed board.')
    parser.add_argument('--diagnose', action='store_true', help='diagnose six boards')
    if parser.parse_args().diagnose:
        _print_diagnoses()
    else:
        _print_accuracy()


def _print_diagnoses() -> None:
    print('| offset | lens error | residual_mm | verdict | named | not decidable |')
    print('|---|---|---|---|---|---|')
    for offset in OFFSETS:
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            (folder / 'in').mkdir()
            rng = np.random.default_rng(SEED)
            for distance, view in zip(DIAGNOSED, VIEWS, strict=True):
                _record(folder / 'in' / f'{distance}.npz', Board(distance, *view), offset, rng)
            (folder / 'target.yaml').write_text(target_of('A3').to_yaml())
            for error in LENS_ERRORS:
                print(
                    f'| {offset * 1e3:g} mm | {error} | {_diagnosis(folder, error)} |', flush=True
                )


def _record(path: Path, board: Board, bias: float, rng: np.random.Generator) -> None:
    light, depth = (np.repeat(image[None], FRAMES, axis=0) for image in board.look(rng))
    stamp = 1000 + np.arange(FRAMES) / RATE
    camera = Camera(MODE, effects={'offset': {'bias': bias}}, seed=int(rng.integers(1000)))
    np.savez(
        path,
        depth=camera.capture(depth, K, stamp).depth,
        K=K,
        stamp=stamp,
        usecase=MODE,
        amplitude=gray_of(light, NOISE, rng),
    )


def _diagnosis(folder: Path, lens_error: float) -> str:
    out = folder / str(lens_error)
    request = BoardRequest(
        recordings=(folder / 'in',), board=folder / 'target.yaml', out=out, lens_error=lens_error
    )
    residuals = [row['residual_mm'] for row in make_board_truth(request)['recordings']]
    found = diagnose(out)
    cells = [
        f'{min(residuals):.1f} to {max(residuals):.1f}',
        found['verdict'],
        ', '.join(map(named, found['effects'])),
        ', '.join(row['name'] for row in found['not_decidable']),
    ]
    return ' | '.join(cells)


def named(effect: dict[str, Any]) -> str:
    """Return an effect of a diagnosis and its parameters in words."""
    numbers = ', '.join(f'{name} {value:.3g}' for name, value in effect['parameters'].items())
    return f'{effect["name"]} ({numbers})'


def _print_accuracy() -> None:
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
                corners, turn, place, direction, sigmas, seconds = np.median(rows, axis=0)
                print(
                    f'| {name} | {distance} | {len(rows)}/{len(VIEWS)} | {corners:.1f} mm, '
                    f'{turn:.2f} deg | {place:.2f} mm, {direction:.2f} deg | {sigmas:.1f} | '
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
