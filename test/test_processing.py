"""Processing of depth images: stages, chains, files, recordings."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
import re
from typing import ClassVar

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processing import Chain, chain, load_chain, parse_chain, Stage
from flexx2_sim_ros.recording import load_recording
import numpy as np
import pytest
import yaml

LENS = flexx2().intrinsics
SLOPE = 0.2
RNG = np.random.default_rng(4)
ALL = [
    {'crop': {'left': 3, 'bottom': 2}},
    {'decimate': {'factor': 2}},
    {'median': {'size': 3}},
    {'spatial': {'delta': 0.1, 'radius': 2}},
    {'smooth': {'alpha': 0.5, 'persistency': 3}},
    {'fill': {'method': 'temporal'}},
    {'fill': {'method': 'inpaint'}},
    'fill',
    {'resize': {'width': 20, 'height': 10, 'method': 'area'}},
    {'clip': {'low': 0.5, 'high': 2.0}},
    {'normalise': {'low': 0.5, 'high': 2.0}},
    {'rate': {'hz': 20.0}},
    {'delay': {'seconds': 0.1}},
]


def slope(lens):
    """Return depth (H, W) that is linear in the direction of the pixels."""
    across, down = (np.arange(lens.width) - lens.cx) / lens.fx, np.arange(lens.height) - lens.cy
    return np.float32(1 + SLOPE * across + SLOPE * (down / lens.fy)[:, np.newaxis])


def holes(count, height=40, width=50, share=0.2):
    """Return (T, H, W) noisy walls with invalid pixels."""
    images = RNG.normal(1.5, 0.2, (count, height, width)).astype(np.float32)
    images[RNG.random(images.shape) < share] = np.nan
    return images


@pytest.mark.parametrize(
    'stages',
    [
        [{'crop': {'left': 10, 'top': 3, 'right': 2}}],
        [{'resize': {'width': 112, 'height': 86, 'method': 'area'}}],
        [{'resize': {'width': 87, 'height': 58, 'method': 'area'}}],
        [{'resize': {'width': 300, 'height': 58, 'method': 'bilinear'}}],
        [{'decimate': {'factor': 3}}],
        [{'decimate': {'factor': 5}}, {'crop': {'left': 4}}, {'resize': {'method': 'bilinear'}}],
    ],
)
def test_the_lens_says_where_pixels_look(stages):
    made = parse_chain(stages)
    found, lens = made.step(slope(LENS), 0), made.lens(LENS)
    assert found.shape == (lens.height, lens.width)
    inner = slice(2, -2), slice(2, -2)  # beyond the outer pixel centres bilinear is constant
    np.testing.assert_allclose(found[inner], slope(lens)[inner], atol=1e-4)
    nearest = parse_chain([{'resize': {'width': 87, 'height': 58}}])
    tolerance = SLOPE * (1 / LENS.fx + 1 / LENS.fy) / 2 + 1e-5  # half a pixel each way
    np.testing.assert_allclose(
        nearest.step(slope(LENS), 0), slope(nearest.lens(LENS)), atol=tolerance
    )


def test_averages_are_of_valid_pixels():
    image = np.array([[1, 2, np.nan, np.nan], [3, np.nan, np.nan, 5]], np.float32)

    def small(**more):
        options = {'width': 2, 'height': 1, 'method': 'area', **more}
        return parse_chain([{'resize': options}]).step(image, 0)[0].tolist()

    assert small() == pytest.approx([2.0, np.nan], nan_ok=True)
    assert small(share=0.0) == pytest.approx([2.0, 5.0])
    assert small(share=1.0) == pytest.approx([np.nan, np.nan], nan_ok=True)
    assert parse_chain(['decimate']).step(image, 0)[0].tolist() == [2.0, 5.0]
    lonely = image.copy()
    lonely[0, 0] = 9.0
    found = parse_chain([{'median': {'size': 3}}]).step(lonely, 0)
    assert found[0].tolist() == pytest.approx([3, 3, np.nan, np.nan], nan_ok=True)


def test_ranges_and_holes():
    image = np.array([[0.2, 1.0, 3.0, np.nan]], np.float32)

    def row(*stages):
        return parse_chain(list(stages)).step(image, 0)[0].tolist()

    one = {'low': 0.5, 'high': 2.0}
    assert row({'clip': one}) == pytest.approx([0.5, 1.0, 2.0, np.nan], nan_ok=True)
    out = {**one, 'beyond': 'invalid'}
    assert row({'clip': out}) == pytest.approx([np.nan, 1, np.nan, np.nan], nan_ok=True)
    assert row({'clip': out}, 'fill') == [1, 1, 1, 1]
    assert row({'normalise': {**one, 'invalid': -1}})[1:] == pytest.approx([1 / 3, 5 / 3, -1])
    blind = np.full((2, 3), np.nan, np.float32)
    assert np.isnan(parse_chain(['fill']).step(blind, 0)).all()


# What librealsense 2.59.1 makes of `in_millimetres`, frame by frame: options, the sum of the last
# frame in millimetres, and its valid pixels.
LIBREALSENSE = (
    ('spatial', {}, 1572247, 1673),
    ('spatial', {'alpha': 0.25, 'delta': 0.008, 'iterations': 5}, 1571590, 1673),
    ('spatial', {'alpha': 0.6, 'delta': 0.05, 'iterations': 1, 'radius': 8}, 1854271, 1984),
    ('spatial', {'radius': 255}, 1876268, 1997),
    ('smooth', {}, 1565930, 1673),
    ('smooth', {'alpha': 0.1, 'delta': 0.1, 'persistency': 8}, 1852064, 1988),
    ('smooth', {'persistency': 1}, 1716020, 1833),
    ('smooth', {'persistency': 2}, 1727655, 1846),
    ('smooth', {'persistency': 3}, 1732186, 1851),
    ('smooth', {'persistency': 4}, 1803697, 1930),
    ('smooth', {'persistency': 5}, 1777711, 1901),
    ('smooth', {'persistency': 6}, 1828085, 1957),
    ('smooth', {'persistency': 7}, 1853304, 1985),
)


def in_millimetres():
    """Return (12, 40, 50) whole millimetres with jumps, holes and noise; 0 where invalid."""
    t, y, x = np.ogrid[:12, :40, :50]
    noise = (7919 * x + 104729 * y + 1299709 * t + x * y * (t + 3)) % 23
    depth = 900 + 2 * x + y + noise - 250 * ((x > 20) & (x < 33) & (y > 9))
    lost = (31 * x + 17 * y + 13 * t) % 11 == 0
    lost |= (y > 11) & (y < 22) & (x > 4) & (x < 25) & ((t * (x % 7 + 1) // 2 + y) % 5 > 0)
    return np.where(lost, 0, depth)


@pytest.mark.parametrize(('stage', 'options', 'total', 'valid'), LIBREALSENSE)
def test_the_filters_of_librealsense(stage, options, total, valid):
    images = in_millimetres()
    depth = np.where(images > 0, images / 1000, np.nan).astype(np.float32)
    made = parse_chain([{stage: {**options, 'step': 0.001}}])
    found = made.run(depth, np.arange(12))[0][-1]
    assert np.isfinite(found).sum() == valid
    assert round(1000 * float(np.nansum(found, dtype=float))) == total
    # Without its rounding, depth is as it is on average before.
    even = parse_chain([{stage: options}]).run(depth, np.arange(12))[0][-1]
    assert np.nanmean(even - depth[-1]) == pytest.approx(0, abs=0.001)


def test_a_smooth_fill_is_harmonic():
    y, x = np.mgrid[:40, :50] / 50.0
    true = np.float32(1 + x * x - y * y)  # Its differences cancel, also those of pixels.
    holed = true.copy()
    holed[8:30, 5:40] = np.nan
    found = parse_chain([{'fill': {'method': 'inpaint'}}]).step(holed, 0)
    np.testing.assert_allclose(found, true, atol=2e-4)
    rough = parse_chain([{'fill': {'method': 'inpaint', 'iterations': 1}}]).step(holed, 0)
    assert np.abs(rough - true).max() > 0.01
    corner = np.full((6, 7), np.nan, np.float32)
    corner[2:4, 3] = 1.0, 2.0
    found = parse_chain([{'fill': {'method': 'inpaint'}}]).step(corner, 0)
    assert np.isfinite(found).all()
    assert 1.0 <= found.min() <= found.max() <= 2.0


def test_what_is_kept_over_time():
    values = np.array([1, 2, np.nan, np.nan, np.nan, 6], np.float32)
    images = np.repeat(values, 6).reshape(6, 2, 3)
    stamps = np.arange(6) * 100_000_000

    def run(*stages):
        found, times = parse_chain(list(stages)).run(images, stamps)
        return found[:, 0, 0].tolist(), (times // 100_000_000).tolist()

    held = run({'fill': {'method': 'temporal', 'seconds': 0.2}})[0]
    assert held == pytest.approx([1, 2, 2, 2, np.nan, 6], nan_ok=True)
    late = run({'delay': {'seconds': 0.15}})[0]
    assert late == pytest.approx([1, 1, 1, 2, np.nan, np.nan], nan_ok=True)
    assert run({'rate': {'hz': 5.0}})[1] == [0, 2, 4]
    assert run({'rate': {'hz': 4.0}})[1] == [0, 3, 5]
    even = run({'smooth': {'alpha': 0.25, 'delta': 2.0}})[0]
    assert even[:2] == [1.0, 1.25]
    assert run({'smooth': {'alpha': 0.25, 'delta': 0.5}})[0][:2] == [1.0, 2.0]
    kept = run({'smooth': {'alpha': 1.0, 'delta': 2.0, 'persistency': 2}})[0]
    assert kept == pytest.approx([1, 2, 2, 2, np.nan, 6], nan_ok=True)
    made = parse_chain([{'rate': {'hz': 4.0}}, 'decimate'])
    np.testing.assert_array_equal(np.flatnonzero(made.kept(stamps)), [0, 3, 5])


def test_environments_are_processed_as_one_camera_is():
    images = np.stack([holes(9) for _ in range(3)], axis=1)  # (T, N, H, W)
    stamps = np.arange(9) * 50_000_000
    many = parse_chain(ALL)
    found = [many.step(one, stamp) for one, stamp in zip(images, stamps, strict=True)]
    for i in range(3):
        wanted, _ = parse_chain(ALL).run(images[:, i], stamps)
        np.testing.assert_allclose([one[i] for one in found], wanted, atol=1e-6)
    # After a reset, one environment is as at its start, and the others go on.
    many.reset(np.array([False, True, False]))
    again = many.step(images[0], 450_000_000)
    np.testing.assert_allclose(again[1], parse_chain(ALL).step(images[0, 1], 0), atol=1e-6)
    assert not np.array_equal(again[0], found[0][0])
    # Stamps that go back begin anew.
    np.testing.assert_array_equal(many.step(images[0], 0), found[0])


@pytest.mark.parametrize(
    ('stages', 'said'),
    [
        ({'crop': {}}, 'process: must be a list of at most 50 stages'),
        (['shrink'], 'process: must be stages out of crop, resize'),
        ([{'crop': {}, 'fill': {}}], 'each with a table of options'),
        ([{'crop': [1]}], 'process: crop: must be a table of options'),
        ([{'crop': {'middle': 1}}], 'crop.middle: must be one of left'),
        ([{'crop': {'left': 1.5}}], 'crop.left: must be a whole number from 0 to 8192'),
        ([{'crop': {'left': True}}], 'crop.left: must be'),
        ([{'resize': {'method': 'cubic'}}], 'resize.method: must be one of nearest'),
        ([{'clip': {'low': float('nan')}}], 'clip.low: must be a number'),
        ([{'normalise': {'low': 2.0}}], 'normalise.high: must be above 2'),
    ],
)
def test_wrong_chains_are_refused(stages, said):
    with pytest.raises(InputError, match=said):
        parse_chain(stages)


def test_images_that_are_too_small_are_refused(tmp_path):
    for stages in ([{'crop': {'left': 50}}], [{'decimate': {'factor': 16}}]):
        with pytest.raises(InputError, match='must'):
            parse_chain(stages).step(np.ones((8, 12), np.float32), 0)
    with pytest.raises(InputError, match='images: must be of shape'):
        Chain(()).step(np.ones(3, np.float32), 0)
    (tmp_path / 'c.yaml').write_text('schema: 1\nstages: []\n')
    with pytest.raises(InputError, match='must have schema and process'):
        load_chain(tmp_path / 'c.yaml')


@dataclass(frozen=True)
class Mirror(Stage):
    """A stage of another package."""

    name: ClassVar[str] = 'mirror'

    def apply(self, images, stamp, memory):
        """Return images with left and right exchanged."""
        return images[..., ::-1]


def test_stages_of_other_packages(monkeypatch, caplog):
    points = [
        EntryPoint('mirror', 'test_processing:Mirror', chain.GROUP),
        EntryPoint('again', 'test_processing:Mirror', chain.GROUP),
        EntryPoint('broken', 'test_processing:Nothing', chain.GROUP),
    ]
    monkeypatch.setattr(chain, 'entry_points', lambda group, leave_out: points)
    chain.stage_kinds.cache_clear()
    try:
        found = parse_chain(['mirror']).step(np.array([[1, 2]], np.float32), 0)
        assert found.tolist() == [[2, 1]]
        assert 'plug-in again is left out' in caplog.text
        assert 'plug-in broken is left out' in caplog.text
    finally:
        chain.stage_kinds.cache_clear()


def test_a_recording_is_processed_as_images_are(tmp_path):
    depth, stamps = holes(12, LENS.height, LENS.width), np.arange(12) * 50_000_000
    clean = np.broadcast_to(slope(LENS), depth.shape)
    np.savez(
        tmp_path / 'a.npz',
        depth=depth,
        K=LENS.matrix,
        stamp_ns=stamps,
        clean_depth=clean,
        reflectivity=slope(LENS) / 2,
        received=stamps * 1e-9 + 0.01,
    )
    (tmp_path / 'chain.yaml').write_text(yaml.safe_dump({'schema': 1, 'process': ALL}))
    given = ['--process', str(tmp_path / 'chain.yaml')]
    assert main(['convert', str(tmp_path / 'a.npz'), str(tmp_path / 'b.npz'), *given]) == 0
    made = load_chain(tmp_path / 'chain.yaml')
    wanted, kept = made.run(depth, stamps)
    found = load_recording(tmp_path / 'b.npz')
    np.testing.assert_array_equal(found.depth, wanted)
    np.testing.assert_array_equal(found.stamp_ns, kept)
    np.testing.assert_allclose(found.extra['received'], kept * 1e-9 + 0.01)
    lens = made.lens(LENS)
    np.testing.assert_allclose(found.K, lens.matrix)
    # Other images look where the depth does, to a pixel of the camera.
    pixel = SLOPE * 2 * (1 / LENS.fx + 1 / LENS.fy)
    np.testing.assert_allclose(
        found.clean_depth, np.broadcast_to(slope(lens), wanted.shape), atol=pixel
    )
    np.testing.assert_allclose(found.reflectivity, slope(lens) / 2, atol=pixel / 2)
    assert main(['convert', str(tmp_path / 'a.npz'), str(tmp_path / 'c.mcap'), *given]) == 0
    assert load_recording(tmp_path / 'c.mcap').depth.shape == wanted.shape


def test_the_documentation_runs(tmp_path, monkeypatch):
    page = (Path(__file__).resolve().parents[1] / 'docs' / 'recordings.md').read_text()
    text = page.split('## Your own processing')[1].split('\n## ')[0]
    monkeypatch.chdir(tmp_path)
    (chain_file,) = re.findall(r'```yaml\n(.*?)```', text, re.S)
    Path('chain.yaml').write_text(chain_file)
    (program,) = re.findall(r'```python\n(.*?)```', text, re.S)
    done = {}
    exec(compile(program, 'docs/recordings.md', 'exec'), done)  # noqa: S102
    assert done['images'].shape == (5, 58, 87)
    for name in load_chain('chain.yaml').stages:
        assert f'`{name.name}`' in text
