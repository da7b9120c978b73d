"""Ground truth from a printed board: sheets to print, and recordings that show one."""

import re

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.recording.truth import read_truth
from flexx2_sim_ros.truth.board import read_board
from flexx2_sim_ros.truth.poses import Pose
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
import yaml

FRAMES, BIAS = 8, 0.008
LENS = np.array([-0.2, 0.05, 0.001, -0.001, 0.01])


def record(path, boards, rng, **changes):
    """Write a recording of a camera with an offset: of one board, or of one a frame."""
    lens = changes.pop('distortion', None)
    seen = [board.look(rng, lens=lens) for board in boards]
    light = np.stack([image for image, _ in seen])
    depth = np.stack([image for _, image in seen])
    if len(boards) == 1:
        light, depth = (np.repeat(image, FRAMES, axis=0) for image in (light, depth))
    stamp = 1000 + np.arange(len(depth)) / 5
    camera = Camera('Mode_9_5fps', effects={'offset': {'bias': BIAS}}, seed=3)
    arrays = {
        'depth': camera.capture(depth, K, stamp).depth,
        'K': K,
        'stamp': stamp,
        'usecase': 'Mode_9_5fps',
        'amplitude': gray_of(light, 0.02, rng),
        **({} if lens is None else {'distortion': lens}),
        **changes,
    }
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return boards[0]


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def board_yaml(tmp_path):
    path = tmp_path / 'target.yaml'
    path.write_text(target_of('A3').to_yaml())
    return path


def truth(tmp_path, board, *options):
    out = tmp_path / 'campaign'
    command = ['gap', 'truth', str(tmp_path / 'in'), '--board', str(board), '--out', str(out)]
    assert main([*command, '--jobs', '1', *options]) == 0
    return dict(yaml.safe_load((out / 'truth.yaml').read_text()))


def place_in_camera(row):
    """Return where a recording's board is, in the camera's frame."""
    pose = Pose.from_numbers(np.array(row['pose']))
    return -pose.R.T @ pose.t


def test_the_offset_of_depth_does_not_move_the_board(tmp_path, board_yaml, rng):
    (tmp_path / 'in').mkdir()
    boards = {
        'far.npz': record(tmp_path / 'in' / 'far.npz', [Board(1.5, -15, 20)], rng),
        'one.npz': record(tmp_path / 'in' / 'one.npz', [Board(1.0, 10, -25)], rng),
        'skew.npz': record(
            tmp_path / 'in' / 'skew.npz', [Board(0.8, 0, 15)], rng, distortion=LENS
        ),
    }
    table = truth(tmp_path, board_yaml)
    for row in table['recordings']:
        board = boards[row['name']]
        assert row['verdict'] == 'used', row['reasons']
        # Gray values alone say where it is: the offset stays in the difference.
        assert np.linalg.norm(place_in_camera(row) - board.t) < 0.002
        turned = Pose.from_numbers(np.array(row['pose'])).R @ board.R
        assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 0.3
        assert row['residual_mm'] == pytest.approx(BIAS * 1e3, abs=3)
    page = (tmp_path / 'campaign' / 'truth.html').read_text()
    assert 'outline of the board' in page


def test_truth_is_on_the_board_and_unknown_elsewhere(tmp_path, board_yaml, rng):
    (tmp_path / 'in').mkdir()
    board = record(tmp_path / 'in' / 'one.npz', [Board(1.0, 10, -25)], rng)
    truth(tmp_path, board_yaml)
    reader = open_recording(tmp_path / 'campaign' / 'one.npz')
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


def test_a_moving_camera_has_a_board_in_each_frame_that_shows_it(tmp_path, board_yaml, rng):
    (tmp_path / 'in').mkdir()
    distances = [0.9, 0.94, 0.98, 1.02]
    record(tmp_path / 'in' / 'walk.npz', [Board(d, 5, -10) for d in distances], rng)
    with np.load(tmp_path / 'in' / 'walk.npz') as file:
        arrays = dict(file)
    arrays['amplitude'][2] = 20  # a frame without light
    np.savez(tmp_path / 'in' / 'walk.npz', **arrays)
    (row,) = truth(tmp_path, board_yaml, '--motion', 'moving')['recordings']
    assert (row['frames'], row['frames_with_board']) == (4, 3)
    with np.load(tmp_path / 'campaign' / 'walk.npz') as file:
        known, clean = file['known'], file['clean_depth']
        assert file['pose_covariance'].shape == (6, 6)
    assert [bool(one.any()) for one in known] == [True, True, False, True]
    assert np.median(clean[3][known[3]]) - np.median(clean[0][known[0]]) == pytest.approx(
        0.12, abs=0.004
    )


def test_a_print_of_the_wrong_size_is_doubtful(tmp_path, board_yaml, rng):
    (tmp_path / 'in').mkdir()
    for distance in (0.7, 1.1):
        board = Board(distance, 10, -20, size=0.95)
        record(tmp_path / 'in' / f'{distance}.npz', [board], rng)
    table = truth(tmp_path, board_yaml)
    assert table['depth_scale'] == pytest.approx(-0.05, abs=0.01)
    for row in table['recordings']:
        assert row['verdict'] == 'doubtful'
        assert 'measure the rulers' in row['reasons'][0]


@pytest.mark.parametrize('described', ['', 'acircles:4x11:0.02'])
@pytest.mark.parametrize(
    ('amplitude', 'words'),
    [
        (None, 'it has no gray image (amplitude)'),
        (np.full((FRAMES, HEIGHT, WIDTH), 90, np.uint8), 'the board is not found'),
        (
            np.random.default_rng(3).integers(80, 100, (FRAMES, HEIGHT, WIDTH), np.uint16),
            'the board is not found',
        ),
    ],
)
def test_a_missing_board_is_reported_with_the_reason(
    tmp_path, board_yaml, rng, capsys, amplitude, words, described
):
    depth = np.full((FRAMES, HEIGHT, WIDTH), 1.2, np.float32)
    arrays = {'depth': depth, 'K': K, 'stamp': np.arange(FRAMES) / 5}
    arrays |= {} if amplitude is None else {'amplitude': amplitude}
    np.savez(tmp_path / 'one.npz', **arrays)
    out = tmp_path / 'out'
    command = ['gap', 'truth', str(tmp_path / 'one.npz'), '--board', described or str(board_yaml)]
    assert main([*command, '--out', str(out), '--jobs', '1']) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'tag': 0.2}, 'width: must be at least 0.66 m'),
        ({'tag': 115}, 'tag: must be a number, 0.01 to 2'),
        ({'columns': 2.5}, 'columns: must be a whole number'),
        ({'dictionary': 'DICT_7X7'}, 'dictionary: must be one of'),
        ({'colour': 'red'}, 'target: must have the fields'),
        ({'gap': 0.005}, 'gap: must be at least half a module'),
        ({'first_id': 48}, 'first_id: must be at most 44'),
    ],
)
def test_impossible_targets_are_refused(tmp_path, changes, words, capsys):
    table = yaml.safe_load(target_of('A3').to_yaml())
    table['target'] |= changes
    path = tmp_path / 'target.yaml'
    path.write_text(yaml.safe_dump(table))
    command = ['gap', 'truth', 'x.npz', '--board', str(path), '--out', str(tmp_path / 'out')]
    assert main(command) == 2
    assert words in capsys.readouterr().err


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
    ('picture', 'described', 'distance'),
    [
        (chessboard(), 'chessboard:9x6:0.03', 0.7),
        (1 - chessboard()[:, :-60], 'chessboard:8x6:0.03', 0.7),
        (charuco(), 'charuco:5x7:0.04:0.03:DICT_5X5_100', 0.5),
        (april_grid(), KALIBR, 0.8),
    ],
)
def test_boards_that_people_own_are_found(picture, described, distance, tmp_path, rng):
    (tmp_path / 'in').mkdir()
    boards = [Board(distance, -20, 25, picture=picture), Board(distance, 25, -15, picture=picture)]
    for number, board in enumerate(boards):
        record(tmp_path / f'in/{number}.npz', [board], rng)
    file = tmp_path / 'kalibr.yaml'
    file.write_text(described)
    table = truth(tmp_path, file if described is KALIBR else described)
    for board, row in zip(boards, table['recordings'], strict=True):
        assert row['verdict'] == 'used'
        assert place_in_camera(row) == pytest.approx(board.t, abs=0.0015)
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
    gray, depth = expose_blind(*board.look(rng), FRAMES, rng)
    arrays = {'depth': depth, 'amplitude': gray, 'K': K, 'stamp': np.arange(FRAMES) / 5}
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ('picture', 'described'),
    [
        (circles(7, 6, 0.03, 0.016, False), 'circles:7x6:0.03:0.016'),
        (circles(7, 6, 0.03, 0.016, False), 'circles:7x6:0.03'),
        (circles(4, 11, 0.02, 0.018, True), 'acircles:4x11:0.02:0.018'),
        (circles(4, 9, 0.025, 0.018, True), CIRCLES),
    ],
)
def test_grids_of_circles_are_found_in_gray_of_16_bits(picture, described, tmp_path, rng):
    (tmp_path / 'in').mkdir()
    boards = [Board(0.5, -20, 25, picture=picture), Board(0.6, 30, -20, picture=picture)]
    for number, board in enumerate(boards):
        record_blind(tmp_path / f'in/{number}.npz', board, rng)
    file = tmp_path / 'kalibr.yaml'
    file.write_text(described)
    table = truth(tmp_path, file if described is CIRCLES else described)
    for board, row in zip(boards, table['recordings'], strict=True):
        assert row['verdict'] == 'used', row['reasons']
        assert place_in_camera(row) == pytest.approx(board.t, abs=0.0015)
        assert abs(row['residual_mm']) < 1.5
        # Told the size of its circles, it knows how dark they are.
        assert described.count(':') != 3 or row['black_to_white'] == pytest.approx(0.07, abs=0.1)


@pytest.mark.parametrize(
    ('picture', 'described', 'found'),
    [(circles(7, 6, 0.03, 0.016, False), 'circles:7x6:0.03', False), (april_grid(), KALIBR, True)],
)
def test_a_board_partly_out_of_the_image_is_found_by_its_tags_only(
    picture, described, found, tmp_path, rng, capsys
):
    board = Board(0.6, -20, 25, picture=picture)
    board.t[0] = -0.4
    record_blind(tmp_path / 'one.npz', board, rng)
    file = tmp_path / 'kalibr.yaml'
    file.write_text(described)
    command = ['gap', 'truth', str(tmp_path / 'one.npz'), '--board']
    command += [str(file) if described is KALIBR else described, '--out', str(tmp_path / 'out')]
    assert main([*command, '--jobs', '1']) == (0 if found else 2)
    if found:
        (row,) = yaml.safe_load((tmp_path / 'out/truth.yaml').read_text())['recordings']
        assert row['verdict'] == 'used'
        assert place_in_camera(row) == pytest.approx(board.t, abs=0.002)
    else:
        assert 'the board is not found in its gray image' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('described', 'said'),
    [
        ('chessboard:9', '--board: must be chessboard:9x6:0.03 (inner corners, metres), charuco:'),
        ('charuco:5x7:0.04:0.03:DICT_ME', '--board: must be chessboard:9x6:0.03'),
        ('circles:7x6:0.03:0.03', '--board: must be chessboard:9x6:0.03'),
        ('target_type: circlegrid', 'must be a target of Kalibr, got'),
        ('target_type: dots', 'target_type: must be one of aprilgrid, checkerboard, circlegrid,'),
        ('target_type: aprilgrid', 'must be a target of Kalibr, got'),
    ],
)
def test_impossible_boards_are_refused(described, said, tmp_path):
    file = tmp_path / 'kalibr.yaml'
    file.write_text(described)
    with pytest.raises(InputError) as error:
        read_board(file if ': ' in described else described)
    assert said in str(error.value)


def test_the_wall_around_a_board_is_known_if_asked(tmp_path, board_yaml, rng):
    (tmp_path / 'in').mkdir()
    board = record(tmp_path / 'in/0.npz', [Board(1.0, 10, 25, glued=True)], rng)
    (alone,) = truth(tmp_path, board_yaml)['recordings']
    (row,) = truth(tmp_path, board_yaml, '--wall')['recordings']
    assert alone['known'] < 0.35
    assert row['known'] > 0.9
    assert row['verdict'] == 'used'
    with np.load(tmp_path / 'campaign/0.npz') as file:
        _, depth = board.look(rng)
        error = (file['clean_depth'] - depth)[file['known']]
    assert np.abs(error).max() < 0.004


def test_a_wall_behind_a_board_stays_unknown(tmp_path, board_yaml, rng):
    (tmp_path / 'in').mkdir()
    record(tmp_path / 'in/0.npz', [Board(1.0, 10, 25)], rng)
    (row,) = truth(tmp_path, board_yaml, '--wall')['recordings']
    assert row['known'] < 0.35
