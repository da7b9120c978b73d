"""Ground truth from a printed board: sheets to print, and recordings that show one."""

import re

from campaigns import change
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.recording.truth import read_truth
from flexx2_sim_ros.truth.board import read_board
from flexx2_sim_ros.truth.target import draw_pdf, read_target, SHEETS, Target, target_of
import numpy as np
from printed_board import (
    april_grid,
    Board,
    charuco,
    chessboard,
    circles,
    expose_blind,
    gray_of,
    HEIGHT,
    K,
    WIDTH,
)
import pytest
from scans import refused, truth
import yaml

FRAMES, BIAS = 8, 0.008
A3 = target_of('A3').to_yaml()
LENS = np.array([-0.2, 0.05, 0.001, -0.001, 0.01])


def record(path, boards, rng, **changes):
    """Write a recording of a camera with an offset: of one board, or of one a frame."""
    path.parent.mkdir(exist_ok=True)
    lens = changes.get('distortion')
    seen = [board.look(rng, lens=lens) for board in boards]
    light = np.stack([image for image, _ in seen])
    depth = np.stack([image for _, image in seen])
    if len(boards) == 1:
        light, depth = (np.repeat(image, FRAMES, axis=0) for image in (light, depth))
    stamp = 1000 + np.arange(len(depth)) / 5
    camera = Camera('Mode_9_5fps', effects={'offset': {'bias': BIAS}}, seed=3)
    np.savez(
        path,
        depth=camera.capture(depth, K, stamp).depth,
        K=K,
        stamp=stamp,
        usecase='Mode_9_5fps',
        amplitude=gray_of(light, 0.02, rng),
        **changes,
    )
    return boards[0]


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def described(folder, board):
    """Return a board as --board has it: text of several lines is in a file."""
    if '\n' not in board:
        return '--board', board
    path = folder / 'board.yaml'
    path.write_text(board)
    return '--board', path


def make(folder, board, *options):
    """Make ground truth for recordings in `in`; return a row for each."""
    return truth(folder / 'out', folder / 'in', *described(folder, board), *options)['recordings']


def place_in_camera(row):
    """Return where a recording's board is, in the camera's frame."""
    pose = Pose.from_numbers(np.array(row['pose']))
    return -pose.R.T @ pose.t


@pytest.fixture(scope='module')
def standing(tmp_path_factory):
    """Return a folder with recordings of three boards and their ground truth, and the boards."""
    folder, rng = tmp_path_factory.mktemp('standing'), np.random.default_rng(7)
    boards = {
        'far.npz': record(folder / 'in' / 'far.npz', [Board(1.5, -15, 20)], rng),
        'one.npz': record(folder / 'in' / 'one.npz', [Board(1.0, 10, -25)], rng),
        'skew.npz': record(folder / 'in' / 'skew.npz', [Board(0.8, 0, 15)], rng, distortion=LENS),
    }
    make(folder, A3)
    return folder / 'out', boards


def test_the_offset_of_depth_does_not_move_the_board(standing):
    out, boards = standing
    for row in yaml.safe_load((out / 'truth.yaml').read_text())['recordings']:
        board = boards[row['name']]
        assert row['verdict'] == 'used', row['reasons']
        # Gray values alone say where it is: the offset stays in the difference.
        assert np.linalg.norm(place_in_camera(row) - board.t) < 0.002
        turned = Pose.from_numbers(np.array(row['pose'])).R @ board.R
        assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 0.3
        assert row['residual_mm'] == pytest.approx(BIAS * 1e3, abs=3)
    assert 'outline of the board' in (out / 'truth.html').read_text()


def test_truth_is_on_the_board_and_unknown_elsewhere(standing, rng):
    out, boards = standing
    board, reader = boards['one.npz'], open_recording(out / 'one.npz')
    said = read_truth(reader.path, reader.arrays, reader.shape)
    clean, real = reader.load().clean_depth, board.look(rng)[1]
    on_board = real < board.t[2] + 0.3
    assert clean is not None
    assert said.plane is not None
    assert not said.known[~on_board].any()
    assert said.known[on_board].mean() > 0.85
    assert np.abs(clean - real)[said.known].max() < 0.002
    assert (said.plane == said.known).all()
    # With a focal length within 0.3 % the board is known to 3 mm, and its size to 1 mm.
    assert said.plane_names == ('board',)
    assert 0.0025 < np.sqrt(said.plane_covariance[0, 0]) < 0.004
    reflectivity = reader.load().reflectivity
    assert np.percentile(reflectivity[said.known], [2, 98]) == pytest.approx([0.06, 0.8], abs=0.04)


def test_a_moving_camera_has_a_board_in_each_frame_that_shows_it(tmp_path, rng):
    distances, file = [0.9, 0.94, 0.98, 1.02], tmp_path / 'in' / 'walk.npz'
    record(file, [Board(d, 5, -10) for d in distances], rng)
    lit = np.array([True, True, False, True])[:, None, None]
    change(file, amplitude=lambda arrays: np.where(lit, arrays['amplitude'], np.uint8(20)))
    (row,) = make(tmp_path, A3, '--motion', 'moving')
    assert (row['frames'], row['frames_with_board']) == (4, 3)
    with np.load(tmp_path / 'out' / 'walk.npz') as archive:
        known, clean = archive['known'], archive['clean_depth']
        assert archive['pose_covariance'].shape == (6, 6)
    assert [bool(one.any()) for one in known] == [True, True, False, True]
    assert np.median(clean[3][known[3]]) - np.median(clean[0][known[0]]) == pytest.approx(
        0.12, abs=0.004
    )


def test_a_print_of_the_wrong_size_is_doubtful(tmp_path, rng):
    for distance in (0.7, 1.1):
        board = Board(distance, 10, -20, size=0.95)
        record(tmp_path / 'in' / f'{distance}.npz', [board], rng)
    table = truth(tmp_path / 'out', tmp_path / 'in', *described(tmp_path, A3))
    assert table['depth_scale'] == pytest.approx(-0.05, abs=0.01)
    for row in table['recordings']:
        assert row['verdict'] == 'doubtful'
        assert 'measure the rulers' in row['reasons'][0]


SHAPE = FRAMES, HEIGHT, WIDTH
FLAT = np.full(SHAPE, 90, np.uint8)
NOISE = np.random.default_rng(3).integers(80, 100, SHAPE, np.uint16)


@pytest.mark.parametrize('board', [A3, 'acircles:4x11:0.02'])
@pytest.mark.parametrize(
    ('arrays', 'words'),
    [
        ({}, 'it has no gray image (amplitude)'),
        ({'amplitude': FLAT}, 'the board is not found'),
        ({'amplitude': NOISE}, 'the board is not found'),
    ],
)
def test_a_missing_board_is_reported_with_the_reason(tmp_path, capsys, arrays, words, board):
    depth, path = np.full(SHAPE, 1.2, np.float32), tmp_path / 'one.npz'
    np.savez(path, depth=depth, K=K, stamp=np.arange(FRAMES) / 5, **arrays)
    assert words in refused(capsys, tmp_path / 'out', path, *described(tmp_path, board))


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'tag': 0.2}, 'width: must be at least 0.66 m'),
        ({'tag': 115}, 'tag: must be a number from 0.01 to 2'),
        ({'columns': 2.5}, 'columns: must be a whole number'),
        ({'dictionary': 'DICT_7X7'}, 'dictionary: must be one of'),
        ({'colour': 'red'}, 'target.colour: must be one of'),
        ({'gap': 0.005}, 'gap: must be at least half a module'),
        ({'first_id': 48}, 'first_id: must be at most 44'),
    ],
)
def test_impossible_targets_are_refused(tmp_path, changes, words):
    table = yaml.safe_load(A3)
    table['target'] |= changes
    path = tmp_path / 'target.yaml'
    path.write_text(yaml.safe_dump(table))
    with pytest.raises(InputError, match=words):
        read_board(path)


@pytest.mark.parametrize('size', SHEETS)
def test_a_target_is_printed_true_to_scale(tmp_path, size):
    out = tmp_path / 'target.pdf'
    assert main(['gap', 'target', '--out', str(out), '--size', size]) == 0
    box = re.search(rb'/MediaBox ?\[ ?0 0 ([\d.]+) ([\d.]+) ?\]', out.read_bytes())
    points = [float(side) for side in box.groups()]
    assert np.array(points) * 0.0254 / 72 == pytest.approx(np.array(SHEETS[size][:2]), abs=1e-6)
    assert read_target(tmp_path / 'target.yaml') == target_of(size)
    before = (tmp_path / 'target.yaml').read_bytes(), out.read_bytes()
    assert main(['gap', 'target', '--out', str(out)]) == 2
    assert before == ((tmp_path / 'target.yaml').read_bytes(), out.read_bytes())


def test_the_pdf_shows_what_the_description_says():
    pdfium = pytest.importorskip('pypdfium2', reason='rasterises PDF')
    target = target_of('A3')
    step = 0.0254 / 72  # one pixel a point
    page = pdfium.PdfDocument(draw_pdf(target))[0].render(scale=1).to_numpy()[..., 0] / 255
    painted = target.paint(step)
    height, width = (min(a, b) for a, b in zip(page.shape, painted.shape, strict=True))
    apart = np.abs(page[:height, :width] - painted[:height, :width])
    # All but the edges of modules and the thin lines of the rulers.
    assert np.mean(apart > 0.5) < 0.005


def test_a_painted_sheet_has_the_area_of_its_tags():
    target = Target()
    step = 0.0007
    black = (1 - target.paint(step)).sum() * step**2
    modules = sum(target.modules(number).sum() for number in range(6))
    assert black == pytest.approx(modules * (target.tag / 6) ** 2, rel=1e-4)


KALIBR = """\
target_type: 'aprilgrid'
tagCols: 4
tagRows: 3
tagSize: 0.08
tagSpacing: 0.3
"""


@pytest.mark.parametrize(
    ('picture', 'board', 'place'),
    [
        (chessboard(), 'chessboard:9x6:0.03', (0.7, -20, 25)),
        (1 - chessboard()[:, :-60], 'chessboard:8x6:0.03', (0.7, 25, -15)),
        (charuco(), 'charuco:5x7:0.04:0.03:DICT_5X5_100', (0.5, -20, 25)),
        (april_grid(), KALIBR, (0.8, -20, 25)),
    ],
)
def test_boards_that_people_own_are_found(picture, board, place, tmp_path, rng):
    there = record(tmp_path / 'in/0.npz', [Board(*place, picture=picture)], rng)
    (row,) = make(tmp_path, board)
    assert row['verdict'] == 'used'
    assert place_in_camera(row) == pytest.approx(there.t, abs=0.0015)
    assert row['residual_mm'] == pytest.approx(BIAS * 1e3, abs=2.5)


CIRCLES = """\
target_type: 'circlegrid'
targetCols: 4
targetRows: 9
spacingMeters: 0.025
asymmetricGrid: True
"""


def record_blind(path, board, rng):
    """Write what the blind camera sees of a board."""
    path.parent.mkdir(exist_ok=True)
    gray, depth = expose_blind(*board.look(rng), FRAMES, rng)
    np.savez(path, depth=depth, amplitude=gray, K=K, stamp=np.arange(FRAMES) / 5)


@pytest.mark.parametrize(
    ('picture', 'board', 'place'),
    [
        (circles(7, 6, 0.03, 0.016, False), 'circles:7x6:0.03:0.016', (0.5, -20, 25)),
        (circles(7, 6, 0.03, 0.016, False), 'circles:7x6:0.03', (0.6, 30, -20)),
        (circles(4, 11, 0.02, 0.018, True), 'acircles:4x11:0.02:0.018', (0.6, 30, -20)),
        (circles(4, 9, 0.025, 0.018, True), CIRCLES, (0.5, -20, 25)),
    ],
)
def test_grids_of_circles_are_found_in_gray_of_16_bits(picture, board, place, tmp_path, rng):
    there = Board(*place, picture=picture)
    record_blind(tmp_path / 'in/0.npz', there, rng)
    (row,) = make(tmp_path, board)
    assert row['verdict'] == 'used', row['reasons']
    assert place_in_camera(row) == pytest.approx(there.t, abs=0.0015)
    assert abs(row['residual_mm']) < 1.5
    # Told the size of its circles, it knows how dark they are.
    assert board.count(':') != 3 or row['black_to_white'] == pytest.approx(0.07, abs=0.1)


def partly_seen(picture):
    """Return a board that is partly out of the image."""
    board = Board(0.6, -20, 25, picture=picture)
    board.t[0] = -0.4
    return board


def test_a_board_partly_out_of_the_image_is_found_by_its_tags(tmp_path, rng):
    board = partly_seen(april_grid())
    record_blind(tmp_path / 'in/0.npz', board, rng)
    # One gray image for all frames.
    change(tmp_path / 'in/0.npz', amplitude=lambda arrays: arrays['amplitude'].mean(axis=0))
    (row,) = make(tmp_path, KALIBR)
    assert row['verdict'] == 'used'
    assert place_in_camera(row) == pytest.approx(board.t, abs=0.002)


def test_a_board_without_tags_partly_out_of_the_image_is_not_found(tmp_path, rng, capsys):
    record_blind(tmp_path / 'in/0.npz', partly_seen(circles(7, 6, 0.03, 0.016, False)), rng)
    said = refused(capsys, tmp_path / 'out', tmp_path / 'in', '--board', 'circles:7x6:0.03')
    assert 'the board is not found in its gray image' in said


@pytest.mark.parametrize(
    ('board', 'said'),
    [
        ('chessboard:9', '--board: must be chessboard:9x6:0.03 (inner corners, metres), charuco:'),
        ('charuco:5x7:0.04:0.03:DICT_ME', '--board: must be chessboard:9x6:0.03'),
        ('circles:7x6:0.03:0.03', '--board: must be chessboard:9x6:0.03'),
        ('target_type: circlegrid\n', 'must be a target of Kalibr, got'),
        (
            'target_type: dots\n',
            'target_type: must be one of aprilgrid, checkerboard, circlegrid,',
        ),
        ('target_type: aprilgrid\n', 'must be a target of Kalibr, got'),
    ],
)
def test_impossible_boards_are_refused(board, said, tmp_path):
    _, path = described(tmp_path, board)
    with pytest.raises(InputError) as error:
        read_board(path)
    assert said in str(error.value)


@pytest.mark.parametrize('glued', [True, False])
def test_the_wall_that_a_board_is_on_is_known_if_asked(tmp_path, rng, glued):
    board = record(tmp_path / 'in/0.npz', [Board(1.0, 10, 25, glued=glued)], rng)
    (row,) = make(tmp_path, A3, '--wall')
    assert row['verdict'] == 'used'
    with np.load(tmp_path / 'out/0.npz') as archive:
        _, depth = board.look(rng)
        error = (archive['clean_depth'] - depth)[archive['known']]
    assert np.abs(error).max() < 0.004
    if glued:
        assert row['known'] > 0.9
        assert make(tmp_path, A3)[0]['known'] < 0.35
    else:
        assert row['known'] < 0.35
