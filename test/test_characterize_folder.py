"""Folders as people have them: recordings that are wrong, in bags, of another camera."""

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
import re
import shlex

from boards import PLACES, recording_of
from flexx2_sim_ros.camera import flexx2, Intrinsics
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.characterize.conditions import parse_name
from flexx2_sim_ros.characterize.histogram import noise_histogram
from flexx2_sim_ros.characterize.noise_report import write_report
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.files import load_profile
from flexx2_sim_ros.profiles.sensor import DEFAULT_SENSOR
from flexx2_sim_ros.profiles.valid_mask import mask_of
from flexx2_sim_ros.recording.convert import convert
import numpy as np
from programs import call_flexx2
import pytest
from scipy.ndimage import gaussian_filter

MODE_9 = flexx2().mode('Mode_9_30fps')
PNG = b'\x89PNG'
SIZE = (60, 80)
# Boards of a camera that is not a Flexx2: metres, degrees.
VIEWS = ((0.6, 5), (0.9, 40), (1.3, 10), (1.8, 45))


def write(folder, name, **changes):
    """Write a recording that is right but for the changes."""
    condition = parse_name(Path(name))
    made = (
        {} if condition is None else {'distance': condition.distance, 'angle': condition.angle_deg}
    )
    np.savez(folder / name, **{**recording_of(**made), **changes})
    return folder / name


def good(folder):
    """Write five recordings that are right."""
    return [
        write(folder, f'Mode_9_30fps_{distance:.2f}m_{angle}deg.npz')
        for distance, angle in ((0.7, 0), (1.0, 30), (1.5, 0), (1.5, 50), (2.0, 30))
    ]


def tiny():
    depth = np.full((12, *SIZE), np.nan, np.float32)
    depth[:, 26:34, 36:44] = 1.0
    return depth


OTHER_K = np.array([[190.0, 0, 39.5], [0, 212.9, 29.5], [0, 0, 1]])
WRONG = {
    'other mode': (
        {'usecase': 'Mode_5_30fps'},
        'must be Mode_9_30fps, as the name says, got Mode_5_30fps',
    ),
    'other K': ({'K': OTHER_K}, 'got 80 x 60 pixels, fx 190'),
    'other lens': ({'distortion': np.array([0.1, 0, 0, 0, 0])}, 'distortion 0.1, 0, 0, 0, 0'),
    'other size': (recording_of(size=(50, 70)), 'must be 80 x 60 pixels'),
    'one frame': (
        {key: recording_of()[key][:1] for key in ('depth', 'stamp')},
        'must have several frames',
    ),
    'all invalid': (
        {'depth': np.full((12, *SIZE), np.nan, np.float32)},
        'got only invalid pixels',
    ),
    'a board that fills nothing': ({'depth': tiny()}, 'must have at least 100'),
    'no plane': (
        {'depth': np.random.default_rng(0).uniform(0.5, 5, (12, *SIZE)).astype('f4')},
        'board: must ',
    ),
    'elsewhere': (recording_of(1.6), 'as the name says, within'),
    'another angle': (recording_of(angle=40), 'must be at 15 degrees, as the name says'),
    'frozen': (
        {'depth': np.repeat(recording_of()['depth'][:1], 12, axis=0)},
        'must change from frame to frame, got 12 times the same frame',
    ),
    'no stamp': ({'stamp': np.array(['a'] * 12)}, 'stamp: must '),
}


@pytest.fixture(scope='module')
def mixed(tmp_path_factory):
    """Characterise right and wrong recordings together; return the result, and wrong paths."""
    folder = tmp_path_factory.mktemp('mixed')
    good(folder)
    # The same condition, written in another way in each name.
    paths = {
        kind: write(folder, f'Mode_9_30fps_1.{zeros * "0"}m_15deg.npz', **changes)
        for zeros, (kind, (changes, _)) in enumerate(WRONG.items(), 1)
    }
    return characterize(folder), paths


@pytest.mark.parametrize('kind', WRONG)
def test_a_wrong_recording_is_left_out(mixed, kind):
    result, paths = mixed
    (reason,) = (one for one in result.left_out if one.startswith(f'{paths[kind]}: '))
    assert WRONG[kind][1] in reason
    assert 'must ' in reason


def test_the_rest_of_a_folder_is_analysed(mixed):
    assert len(mixed[0].modes[0].cells) == 5


def test_two_frames_with_invalid_pixels_are_enough(tmp_path):
    for path in good(tmp_path):
        condition = parse_name(path)
        two = recording_of(condition.distance, condition.angle_deg, frames=2)
        lost = np.random.default_rng(4).uniform(size=two['depth'].shape) < 0.05
        two['depth'][lost] = np.nan
        write(tmp_path, path.name, **two)
    cells = characterize(tmp_path).modes[0].cells
    # 4000 pixels: the standard error of sigma is 1 %. Seven of them: below 1e-11 in five cells.
    assert [cell.sigma / cell.modelled for cell in cells] == pytest.approx([1.0] * 5, abs=0.07)


def test_without_usable_recordings_every_reason_is_listed(tmp_path, capsys):
    (tmp_path / 'a.npz').write_bytes(b'no archive')
    write(tmp_path, 'b.npz', depth=np.zeros((12, *SIZE), np.float32))
    assert main(['characterize', 'fit', str(tmp_path), '--jobs', '1']) == 2
    printed = capsys.readouterr().err
    assert 'none of its 2 recordings' in printed
    assert 'a.npz: cannot be read' in printed
    assert 'b.npz: depth: must have a board in view' in printed
    assert not (tmp_path / 'characterization').exists()


class Page(HTMLParser):
    """What a page refers to, and its text."""

    def __init__(self, path):
        """Read it."""
        super().__init__()
        self.links = []
        self.tags = []
        self.classes = []
        self.text = ''
        self.feed(path.read_text(encoding='utf-8'))

    def handle_starttag(self, tag, attrs):
        """Keep links and classes."""
        self.tags.append(tag)
        self.links += [value or '' for key, value in attrs if key in ('src', 'href')]
        self.classes += [value for key, value in attrs if key == 'class']

    def handle_data(self, data):
        """Keep text."""
        self.text += data


def report(result, out):
    """Write a result's report and profile; return the page and the profile."""
    out.mkdir()
    profile = to_profile(result)
    return Page(write_report(result, profile, out)), profile


def test_the_command_writes_a_page_figures_and_a_profile(tmp_path, capsys):
    """Assert the page is whole in itself and no name, of a file or mode, is markup in it."""
    good(tmp_path)
    hostile = write(tmp_path, 'Mode_9_30fps_1.00m_15deg.npz', usecase='<b>x&y')
    (tmp_path / '<b>x.npz').write_bytes(b'no recording')
    write(tmp_path, '<b>y&amp;.npz')
    mode = r'<i>$\nothing{'
    for number, distance in enumerate((0.8, 1.2, 1.6)):
        write(tmp_path, f'view{number}.npz', **recording_of(distance, 20) | {'usecase': mode})
    out = tmp_path / 'out <i>'
    out.mkdir()
    (out / 'lateral.png').write_bytes(b'of somebody else')
    words = f'{tmp_path} --out {shlex.quote(str(out))} --jobs 1 --model Cam'
    call_flexx2(f'characterize fit {words}')
    printed = capsys.readouterr()
    assert 'left out' in printed.err
    assert str(hostile) in printed.err
    for name in ('sigma_z', 'histogram', 'bias'):
        assert (out / f'{name}.png').read_bytes().startswith(PNG)
    # No edge of the board is in the image.
    assert (out / 'lateral.png').read_bytes() == b'of somebody else'
    page = Page(out / 'report.html')
    assert page.links
    assert all(link.startswith('data:image/png;base64,') for link in page.links)
    assert not {'b', 'i', 'script', 'link', 'iframe'} & set(page.tags)
    for text in (
        'Mode_9_30fps',
        'Axial noise',
        'Lateral noise',
        'not measured',
        'paper',
        '2 recordings were left out',
        'Left out: 2',
        'All recordings',
        'must be Mode_9_30fps, as the name says, got <b>x&y',
        '<b>x.npz: cannot be read',
        '<b>y&amp;.npz',
        'sigma_x: not measured',
        f'{mode}: left out of the profile',
    ):
        assert text in page.text, text
    profile = load_profile(out / 'profile.yaml')
    assert profile.model == 'Cam'
    assert profile.names == ['Mode_9_30fps']
    assert profile.mode('Mode_9_30fps').noise.sigma_x == 0.0
    # Again: a picture of the run before, which is not drawn now, is removed.
    call_flexx2(f'characterize fit {words}')
    assert not (out / 'lateral.png').exists()


def test_a_truncated_bag_is_measured_and_reported(tmp_path):
    arrays, bags = tmp_path / 'arrays', tmp_path / 'bags'
    arrays.mkdir()
    bags.mkdir()
    for path in good(arrays):
        convert(path, bags / path.stem)
    (cut,) = (bags / 'Mode_9_30fps_0.70m_0deg').glob('*.mcap')
    cut.write_bytes(cut.read_bytes()[: int(0.6 * cut.stat().st_size)])
    result = characterize(bags)
    frames = [cell.measurement.frames for cell in result.modes[0].cells]
    assert 1 < frames[0] < 12
    assert frames[1:] == [12] * 4
    page, _ = report(result, tmp_path / 'out')
    notes = page.text.partition('Notes')[2].partition('How it was measured')[0]
    assert 'Mode_9_30fps_0.70m_0deg' in notes


def test_crops_of_one_image_are_one_camera(tmp_path):
    """Assert recordings that differ in crop alone are kept, another focal length is not."""
    crops = ((0, 0, 60, 50), (10, 0, 80, 60), (0, 5, 70, 60), (20, 10, 80, 55))
    for number, (x0, y0, x1, y1) in enumerate(crops):
        whole = recording_of(0.8 + 0.4 * number, 10 + 10 * number)
        matrix = whole['K'].copy()
        matrix[:2, 2] -= x0, y0
        np.savez(
            tmp_path / f'view{number}.npz',
            **whole | {'depth': whole['depth'][:, y0:y1, x0:x1], 'K': matrix, 'usecase': 'tof'},
        )
    other = write(tmp_path, 'z.npz', K=OTHER_K)
    result = characterize(tmp_path)
    (reason,) = result.left_out
    assert 'got 80 x 60 pixels, fx 190' in reason
    assert f'{other}: K: must be fx 210.6, fy 212.9, as 4 of the 5 recordings have' in reason
    page, written = report(result, tmp_path / 'out')
    size = written.profile.intrinsics
    assert (size.width, size.height, size.cx, size.cy) == (80, 60, 39.5, 29.5)
    assert '4 recordings, 48 frames of crops of 80 x 60 pixels' in page.text


def test_another_camera_and_mode_make_a_profile(tmp_path, capsys):
    """Assert what is not known or not assumed is said, and the profile can be run."""
    generator = np.random.default_rng(3)
    for number, (distance, angle) in enumerate(VIEWS):
        made = recording_of(distance, angle, size=(96, 128))
        made['depth'][generator.random(made['depth'].shape) < 0.02] = np.nan
        made |= {'stamp': np.arange(12) / 15, 'usecase': 'tof'}
        np.savez(tmp_path / f'view{number}.npz', **made)
    out = tmp_path / 'out'
    assert main(['characterize', 'fit', str(tmp_path), '--out', str(out), '--jobs', '1']) == 0
    said = 'tof: assumption does not hold: there are no invalid pixels on the board'
    assert said in capsys.readouterr().out
    mode = load_profile(out / 'profile.yaml').mode('tof')
    assert mode.rate_hz == pytest.approx(15.0)
    assert 0.3 < mode.range_min < 0.6 < 1.8 < mode.range_max < 4.0
    assert mode.modulation_hz == ()
    assert load_profile(out / 'profile.yaml').intrinsics.width == 128
    text = (out / 'profile.yaml').read_text()
    assert 'modulation, raw frames and exposure are not known' in re.sub(r'\s+', ' ', text)
    assert 'the true distance is not known' in Page(out / 'report.html').text
    assert not (out / 'bias.png').exists()


def smooth(noise):
    """Blur white noise, so that neighbours correlate by 0.7, and leave its variance as it is."""
    spot = gaussian_filter(np.eye(41)[20], 0.85)
    return gaussian_filter(noise, (0, 0.85, 0.85), mode='wrap') / np.sum(spot**2)


@pytest.mark.parametrize('distort', [None, smooth])
def test_single_frames_are_measured_in_space_and_reported(distort, tmp_path):
    """
    Assert sigma within 6 %, of independent pixels and of such that correlate by 0.7.

    Some 280 tiles of 17 (61 if independent) degrees of freedom know it to 1 %: chance fails it
    with a probability below 1e-8.
    """
    for number, (distance, angle) in enumerate(VIEWS):
        made = recording_of(distance, angle, frames=1, distort=distort)
        np.savez(tmp_path / f'view{number}.npz', **made)
    result = characterize(tmp_path)
    page, written = report(result, tmp_path / 'out')
    assert 'Single frames: the noise is the deviation of each frame from fitted' in page.text
    assert 'needs recordings of at least 20 frames, got 1' in page.text
    assert 'from fitted planes' in written.measured['Mode_9_30fps']['noise']
    tiles = [cell.measurement.tiles for cell in result.modes[0].cells]
    ratios = [t.variance.mean() / np.mean(MODE_9.noise.sigma_z(t.z, t.theta) ** 2) for t in tiles]
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1, rel=0.06)


def test_a_box_says_where_the_board_is(tmp_path):
    """Assert a board in a corner is measured there; false failures: sigma is known to 0.6 %."""
    near, far = recording_of(1.0, 15), recording_of(2.5, 0)
    depth = far['depth'].copy()
    depth[:, :30, :40] = near['depth'][:, :30, :40]
    np.savez(tmp_path / 'one.npz', **near | {'depth': depth})
    result = characterize(tmp_path, box=(2, 2, 36, 26))
    m = result.modes[0].measurements[0]
    assert m.pixels.count == 34 * 24
    assert m.distance == pytest.approx(1.0, rel=0.05)
    # The board goes on behind the sides of a box: they are no edges.
    np.savez(tmp_path / 'one.npz', **near)
    inner = characterize(tmp_path, box=(20, 5, 60, 55)).modes[0].measurements[0]
    assert inner.edges == ()
    with pytest.raises(InputError, match='box: must be x0 y0 x1 y1 within 80 x 60, got'):
        characterize(tmp_path, box=(2, 2, 90, 26))


@pytest.mark.parametrize('kind', ['known', 'known in each frame', 'profile'])
def test_masked_pixels_are_neither_invalid_nor_noise(tmp_path, kind):
    """
    Assert the share of invalid pixels among those that the mask leaves in, and their histogram.

    4000 pixels of 12 frames know a share of 3 % to 0.08 %.
    """
    generator = np.random.default_rng(5)
    left_in = generator.uniform(size=SIZE) > 0.15
    masked = np.broadcast_to(~left_in, (12, *SIZE))
    known = {} if kind == 'profile' else {'known': left_in}
    if kind == 'known in each frame':
        known['known'] = np.broadcast_to(left_in, (12, *SIZE)).copy()
        known['known'][::3] = True
        masked = ~known['known']
    profile = flexx2()
    if kind == 'profile':
        camera = Intrinsics.from_matrix(recording_of()['K'], *SIZE[::-1])
        sensor = replace(DEFAULT_SENSOR, valid_mask=mask_of(left_in, camera))
        modes = tuple(replace(mode, sensor=sensor) for mode in profile.modes)
        profile = replace(profile, modes=modes)
    for distance, angle in PLACES:
        made = recording_of(distance, angle)
        depth = made['depth']
        depth[generator.uniform(size=depth.shape) < 0.03] = np.nan
        depth[masked] += 0.01  # The noise is some 4 mm.
        depth[masked & (generator.uniform(size=depth.shape) < 0.5)] = np.nan
        name = f'Mode_9_30fps_{distance:.2f}m_{angle}deg.npz'
        np.savez(tmp_path / name, **made | known, amplitude=np.full(depth.shape, 100.0))
    result = characterize(tmp_path, profile=profile)
    for m in result.modes[0].measurements:
        assert m.pixels.invalid == pytest.approx(0.03, abs=0.006)
        share = m.amplitude.invalid.sum() / m.amplitude.pixels.sum()
        assert share == pytest.approx(0.03, abs=0.006)
    histogram = noise_histogram(result)
    middles = (histogram.edges[1:] + histogram.edges[:-1]) / 2
    # The mean of 3000 values is known to 0.02 sigma.
    assert abs(np.average(middles, weights=histogram.counts)) < 0.15 * histogram.sigma


@pytest.mark.parametrize(
    ('spellings', 'name'),
    [(['MODE_9_30FPS', 'Mode_9_30fps'], 'Mode_9_30fps'), (['TOF', 'tof', 'ToF'], 'tof')],
)
def test_a_mode_is_the_same_in_upper_and_lower_case(tmp_path, spellings, name):
    for number, (distance, angle) in enumerate(PLACES):
        made = recording_of(distance, angle) | {'usecase': spellings[number % len(spellings)]}
        np.savez(tmp_path / f'{number}.npz', **made)
    page, written = report(characterize(tmp_path), tmp_path / 'out')
    assert written.profile.names == [name]
    assert written.standard_errors[name]['a'] is not None
    assert written.measured[name]['recordings'] == len(PLACES)
    assert ('paper' in page.classes) == (name == 'Mode_9_30fps')


@pytest.mark.parametrize('stamps', [{}, {'stamp': np.zeros(12)}])
def test_what_stamps_and_boards_do_not_tell_is_said_to_be_assumed(tmp_path, stamps):
    """Assert it of the rate; and of a range that noise does not leave, of one distance."""
    for number in range(3):
        made = recording_of(1.0, 0) | {'usecase': 'tof'}
        del made['stamp']
        np.savez(tmp_path / f'{number}.npz', **made, **stamps)
    written = to_profile(characterize(tmp_path))
    mode = written.profile.mode('tof')
    assert mode.rate_hz == 30.0
    said = [note for note in written.provenance['notes'] if 'rate_hz' in note]
    assert said == [
        'tof: rate_hz: unknown, needs several frames with stamps that rise; assumed 30'
    ]
    assert mode.range_min == pytest.approx(0.9, abs=0.01)
    assert mode.range_max == pytest.approx(1.1, abs=0.01)
