"""Folders as people have them: recordings that are wrong, in bags, of another camera."""

from html.parser import HTMLParser
from pathlib import Path
import re
import shlex

from boards import board
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.characterize import characterize
from flexx2_sim_ros.characterize.conditions import parse_name
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.files import load_profile
from flexx2_sim_ros.recording.convert import convert
import numpy as np
from programs import call_flexx2
import pytest
from scipy.ndimage import gaussian_filter

MODE_9 = flexx2().mode('Mode_9_30fps')
PNG = b'\x89PNG'


def content(distance=1.0, angle=15.0, frames=12, size=(60, 80), blur=0.0):
    """Make a recording of a board that fills the image; its noise may be blurred (pixels)."""
    target = board(distance, angle, size=size)
    sigma = MODE_9.noise.sigma_z(target.depth, target.incidence)
    generator = np.random.default_rng(round(1000 * distance + angle))
    noise = generator.standard_normal((frames, *size))
    if blur:
        spot = gaussian_filter(np.eye(41)[20], blur)
        noise = gaussian_filter(noise, (0, blur, blur), mode='wrap') / np.sum(spot**2)
    return {
        'depth': (target.depth + sigma * noise).astype(np.float32),
        'K': target.K,
        'stamp': np.arange(frames) / 30,
        'usecase': 'Mode_9_30fps',
    }


def write(folder, name, **changes):
    """Write a recording that is right but for the changes."""
    condition = parse_name(Path(name))
    made = (
        {} if condition is None else {'distance': condition.distance, 'angle': condition.angle_deg}
    )
    np.savez(folder / name, **{**content(**made), **changes})
    return folder / name


def good(folder):
    """Write five recordings that are right."""
    return [
        write(folder, f'Mode_9_30fps_{distance:.2f}m_{angle}deg.npz')
        for distance, angle in ((0.7, 0), (1.0, 30), (1.5, 0), (1.5, 50), (2.0, 30))
    ]


def tiny():
    depth = np.full((12, 60, 80), np.nan, np.float32)
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
    'other size': (content(1.0, 15, size=(50, 70)), 'must be 80 x 60 pixels'),
    'one frame': (
        {key: content()[key][:1] for key in ('depth', 'stamp')},
        'must have several frames',
    ),
    'all invalid': (
        {'depth': np.full((12, 60, 80), np.nan, np.float32)},
        'got only invalid pixels',
    ),
    'a board that fills nothing': ({'depth': tiny()}, 'must have at least 100'),
    'no plane': (
        {'depth': np.random.default_rng(0).uniform(0.5, 5, (12, 60, 80)).astype('f4')},
        'board: ',
    ),
    'elsewhere': (content(1.6, 15), 'as the name says, within'),
    'another angle': (content(1.0, 40), 'must be at 15 degrees, as the name says'),
    'frozen': (
        {'depth': np.repeat(content()['depth'][:1], 12, axis=0)},
        'must change from frame to frame, got 12 times the same frame',
    ),
    'no stamp': ({'stamp': np.array(['a'] * 12)}, 'stamp'),
}


@pytest.mark.parametrize('kind', WRONG)
def test_a_wrong_recording_is_left_out_and_the_rest_analysed(tmp_path, kind):
    good(tmp_path)
    changes, named = WRONG[kind]
    bad = write(tmp_path, 'Mode_9_30fps_1.00m_15deg.npz', **changes)
    result = characterize(tmp_path)
    assert len(result.left_out) == 1
    assert result.left_out[0].startswith(str(bad))
    assert named in result.left_out[0]
    assert 'must ' in result.left_out[0]
    assert len(result.modes[0].cells) == 5


def test_two_frames_with_invalid_pixels_are_enough(tmp_path):
    for path in good(tmp_path):
        condition = parse_name(path)
        two = content(condition.distance, condition.angle_deg, frames=2)
        lost = np.random.default_rng(4).uniform(size=two['depth'].shape) < 0.05
        two['depth'][lost] = np.nan
        write(tmp_path, path.name, **two)
    cells = characterize(tmp_path).modes[0].cells
    # 4000 pixels: the standard error of sigma is 1 %. Seven of them: below 1e-11 in five cells.
    assert [cell.sigma / cell.modelled for cell in cells] == pytest.approx([1.0] * 5, abs=0.07)


def test_pictures_of_somebody_else_stay(tmp_path):
    campaign, out = tmp_path / 'campaign', tmp_path / 'thesis'
    for folder in (campaign, out):
        folder.mkdir()
    good(campaign)
    (out / 'lateral.png').write_bytes(b'mine')
    assert main(['characterize', 'fit', str(campaign), '--out', str(out), '--jobs', '1']) == 0
    assert (out / 'lateral.png').read_bytes() == b'mine'


def test_without_usable_recordings_every_reason_is_listed(tmp_path, capsys):
    (tmp_path / 'a.npz').write_bytes(b'no archive')
    write(tmp_path, 'b.npz', depth=np.zeros((12, 60, 80), np.float32))
    assert main(['characterize', 'fit', str(tmp_path), '--jobs', '1']) == 2
    printed = capsys.readouterr().err
    assert 'none of its 2 recordings' in printed
    assert 'a.npz: cannot be read' in printed
    assert 'b.npz: depth: must have a board in view' in printed
    assert 'Traceback' not in printed
    assert not (tmp_path / 'characterization').exists()


class Page(HTMLParser):
    """Collects what a page refers to, and its text."""

    def __init__(self):
        """Start with nothing."""
        super().__init__()
        self.links = []
        self.tags = []
        self.text = ''

    def handle_starttag(self, tag, attrs):
        """Keep links."""
        self.tags.append(tag)
        self.links += [value or '' for key, value in attrs if key in ('src', 'href')]

    def handle_data(self, data):
        """Keep text."""
        self.text += data


def test_the_command_writes_a_page_figures_and_a_profile(tmp_path, capsys):
    """Assert the page is whole in itself and nothing in a file's name gets into its markup."""
    good(tmp_path)
    hostile = write(tmp_path, 'Mode_9_30fps_1.00m_15deg.npz', usecase='<b>x&y')
    (tmp_path / '<b>x.npz').write_bytes(b'no recording')
    write(tmp_path, '<b>y&amp;.npz')
    out = tmp_path / 'out <i>'
    words = f'{tmp_path} --out {shlex.quote(str(out))} --jobs 1 --model Cam'
    call_flexx2(f'characterize fit {words}')
    printed = capsys.readouterr()
    assert 'left out' in printed.err
    assert str(hostile) in printed.err
    for name in ('sigma_z', 'histogram', 'bias'):
        assert (out / f'{name}.png').read_bytes().startswith(PNG)
    # No edge of the board is in the image.
    assert not (out / 'lateral.png').exists()
    page = Page()
    source = (out / 'report.html').read_text(encoding='utf-8')
    page.feed(source)
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
    ):
        assert text in page.text, text
    profile = load_profile(out / 'profile.yaml')
    assert profile.model == 'Cam'
    assert profile.names == ['Mode_9_30fps']
    assert profile.mode('Mode_9_30fps').noise.sigma_x == 0.0
    # Again, with what is there now; nothing is left of the run before.
    (out / 'lateral.png').write_bytes(b'old')
    assert main(['characterize', 'fit', str(tmp_path), '--out', str(out), '--jobs', '1']) == 0
    assert not (out / 'lateral.png').exists()


def test_a_modes_name_is_text_wherever_it_is_shown(tmp_path):
    """Assert a name full of markup does no harm, and that no profile can have it."""
    good(tmp_path)
    hostile = r'<i>$\nothing{'
    for number, distance in enumerate((0.8, 1.2, 1.6)):
        np.savez(tmp_path / f'view{number}.npz', **content(distance, 20) | {'usecase': hostile})
    out = tmp_path / 'out'
    assert main(['characterize', 'fit', str(tmp_path), '--out', str(out), '--jobs', '1']) == 0
    page = Page()
    page.feed((out / 'report.html').read_text(encoding='utf-8'))
    assert 'i' not in page.tags
    assert hostile in page.text
    assert f'{hostile}: left out of the profile' in page.text
    assert load_profile(out / 'profile.yaml').names == ['Mode_9_30fps']


def test_a_truncated_bag_is_measured_and_reported(tmp_path):
    arrays, bags = tmp_path / 'arrays', tmp_path / 'bags'
    arrays.mkdir()
    bags.mkdir()
    for path in good(arrays):
        convert(path, bags / path.stem)
    (cut,) = (bags / 'Mode_9_30fps_0.70m_0deg').glob('*.mcap')
    cut.write_bytes(cut.read_bytes()[: int(0.6 * cut.stat().st_size)])
    out = tmp_path / 'out'
    assert main(['characterize', 'fit', str(bags), '--out', str(out), '--jobs', '1']) == 0
    frames = [cell.measurement.frames for cell in characterize(bags).modes[0].cells]
    assert 1 < frames[0] < 12
    assert frames[1:] == [12] * 4
    page = Page()
    page.feed((out / 'report.html').read_text(encoding='utf-8'))
    notes = page.text.partition('Notes')[2].partition('How it was measured')[0]
    assert 'Mode_9_30fps_0.70m_0deg' in notes


def test_crops_of_one_image_are_one_camera(tmp_path, capsys):
    """Assert recordings that differ in crop alone are kept, another focal length is not."""
    crops = ((0, 0, 60, 50), (10, 0, 80, 60), (0, 5, 70, 60), (20, 10, 80, 55))
    for number, (x0, y0, x1, y1) in enumerate(crops):
        whole = content(0.8 + 0.4 * number, 10 + 10 * number)
        matrix = whole['K'].copy()
        matrix[:2, 2] -= x0, y0
        np.savez(
            tmp_path / f'view{number}.npz',
            **whole | {'depth': whole['depth'][:, y0:y1, x0:x1], 'K': matrix, 'usecase': 'tof'},
        )
    other = write(tmp_path, 'z.npz', K=OTHER_K)
    out = tmp_path / 'out'
    assert main(['characterize', 'fit', str(tmp_path), '--out', str(out), '--jobs', '1']) == 0
    printed = capsys.readouterr().err
    assert printed.count('left out') == 1
    assert 'got 80 x 60 pixels, fx 190' in printed
    assert f'{other}: K: must be fx 210.6, fy 212.9, as 4 of the 5 recordings have' in printed
    size = load_profile(out / 'profile.yaml').intrinsics
    assert (size.width, size.height, size.cx, size.cy) == (80, 60, 39.5, 29.5)
    page = (out / 'report.html').read_text(encoding='utf-8')
    assert '4 recordings, 48 frames of crops of 80 x 60 pixels' in page


def test_another_camera_and_mode_make_a_profile(tmp_path):
    """Assert what is not known is said, and the profile can be run."""
    for number, (distance, angle) in enumerate(((0.6, 5), (0.9, 40), (1.3, 10), (1.8, 45))):
        made = content(distance, angle, size=(96, 128))
        made['stamp'] = np.arange(12) / 15
        np.savez(tmp_path / f'view{number}.npz', **made | {'usecase': 'tof'})
    out = tmp_path / 'out'
    assert main(['characterize', 'fit', str(tmp_path), '--out', str(out), '--jobs', '1']) == 0
    mode = load_profile(out / 'profile.yaml').mode('tof')
    assert mode.rate_hz == pytest.approx(15.0)
    assert 0.3 < mode.range_min < 0.6 < 1.8 < mode.range_max < 4.0
    assert mode.modulation_hz == ()
    assert load_profile(out / 'profile.yaml').intrinsics.width == 128
    text = (out / 'profile.yaml').read_text()
    assert 'modulation, raw frames and exposure are not known' in re.sub(r'\s+', ' ', text)
    page = (out / 'report.html').read_text(encoding='utf-8')
    assert 'the true distance is not known' in page
    assert not (out / 'bias.png').exists()


@pytest.mark.parametrize('blur', [0.0, 0.85])
def test_single_frames_are_measured_in_space_and_reported(blur, tmp_path):
    """
    Assert sigma within 6 %, of independent pixels and of such that correlate by 0.7.

    Some 280 tiles of 17 (61 if independent) degrees of freedom know it to 1 %: chance fails it
    with a probability below 1e-8.
    """
    for number, (distance, angle) in enumerate(((0.6, 5), (0.9, 40), (1.3, 10), (1.8, 45))):
        made = content(distance, angle, frames=1, blur=blur)
        np.savez(tmp_path / f'view{number}.npz', **made)
    out = tmp_path / 'out'
    assert main(['characterize', 'fit', str(tmp_path), '--out', str(out), '--jobs', '1']) == 0
    page = (out / 'report.html').read_text(encoding='utf-8')
    assert 'Single frames: the noise is the deviation of each frame from fitted planes' in page
    assert 'needs recordings of at least 20 frames, got 1' in page
    assert 'from fitted planes' in re.sub(r'\s+', ' ', (out / 'profile.yaml').read_text())
    tiles = [cell.measurement.tiles for cell in characterize(tmp_path).modes[0].cells]
    ratios = [t.variance.mean() / np.mean(MODE_9.noise.sigma_z(t.z, t.theta) ** 2) for t in tiles]
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1, rel=0.06)


def test_a_box_says_where_the_board_is(tmp_path):
    """Assert a board in a corner is measured there; false failures: sigma is known to 0.6 %."""
    near, far = content(1.0, 15), content(2.5, 0)
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
