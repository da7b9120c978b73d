"""Episodes of LeRobot data sets with depth as recordings: one of LeRobot's own, and made ones."""

import io
import json
from pathlib import Path
import tarfile

from flexx2_sim_ros import npz_arrays
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.depth_video import Coding
import made_images
from made_images import encoded
import numpy as np
from programs import convert, converted, refusal
import pytest

av = pytest.importorskip('av')
pa = pytest.importorskip('pyarrow')
pq = pytest.importorskip('pyarrow.parquet')
KEY, RATE, COUNT, SIZE = 'observation.images.front_depth', 30, 5, (24, 32)
LENS = ['--intrinsics', '20', '20', '15.5', '11.5']
CODING = {'depth_min': 0.01, 'depth_max': 10.0, 'shift': 3.5, 'use_log': True}


def counts(episode):
    return made_images.counts(episode, (COUNT, *SIZE))


def metres(episode):
    return made_images.metres(seed=episode, shape=(COUNT, *SIZE))


def pictures(images, form='PNG'):
    """Return a column of images as `datasets.Image` is stored."""
    kind = pa.struct([('bytes', pa.binary()), ('path', pa.string())])
    rows = [
        {'bytes': None if form is None else encoded(image, form), 'path': f'frame-{k:06d}.png'}
        for k, image in enumerate(images)
    ]
    return pa.array(rows, kind)


def lists(images):
    """Return a column of numbers as `datasets.Array3D` is stored."""
    column = pa.array(images.ravel())
    for size in images.shape[:0:-1]:
        offsets = np.arange(0, len(column) + 1, size, dtype=np.int32)
        column = pa.ListArray.from_arrays(pa.array(offsets), column)
    return column


def info_of(root, version, feature, more=None):
    features = {
        'action': {'dtype': 'float32', 'shape': [6], 'names': None},
        'observation.images.front': {'dtype': 'video', 'shape': [480, 640, 3]},
        KEY: feature,
        'timestamp': {'dtype': 'float32', 'shape': [1], 'names': None},
    }
    (root / 'meta').mkdir(parents=True, exist_ok=True)
    content = {'codebase_version': version, 'fps': RATE, 'features': features | (more or {})}
    (root / 'meta/info.json').write_text(json.dumps(content, indent=4))


def rows(episode, column=None):
    columns = {
        'action': pa.array([[0.0] * 6] * COUNT, pa.list_(pa.float32(), 6)),
        'timestamp': pa.array(np.arange(COUNT) / RATE, pa.float32()),
        'frame_index': pa.array(range(COUNT)),
        'episode_index': pa.array([episode] * COUNT),
    }
    return pa.table(columns if column is None else {**columns, KEY: column})


def v2(root, feature, *columns):
    """Write a data set of version 2.1: a table for each episode."""
    info_of(root, 'v2.1', feature)
    (root / 'data/chunk-000').mkdir(parents=True)
    for episode, column in enumerate(columns):
        pq.write_table(
            rows(episode, column), root / f'data/chunk-000/episode_{episode:06d}.parquet'
        )
    return root


def v3(root, feature, *columns):
    """Write a data set of version 3.0: all episodes in one table, the first two in one group."""
    info_of(root, 'v3.0', feature)
    for folder in ('data/chunk-000', 'meta/episodes/chunk-000'):
        (root / folder).mkdir(parents=True)
    tables = [rows(episode, column) for episode, column in enumerate(columns)]
    with pq.ParquetWriter(root / 'data/chunk-000/file-000.parquet', tables[0].schema) as file:
        for some in (tables[:2], *([table] for table in tables[2:])):
            file.write_table(pa.concat_tables(some))
    numbers = range(len(columns))
    episodes = {
        'episode_index': list(numbers),
        'data/chunk_index': [0 for _ in numbers],
        'data/file_index': [0 for _ in numbers],
        f'videos/{KEY}/chunk_index': [0 for _ in numbers],
        f'videos/{KEY}/file_index': [0 for _ in numbers],
        f'videos/{KEY}/from_timestamp': [COUNT / RATE * number for number in numbers],
    }
    pq.write_table(pa.table(episodes), root / 'meta/episodes/chunk-000/file-000.parquet')
    return root


def image(**info):
    return {'dtype': 'image', 'shape': [*SIZE, 1], 'info': {'is_depth_map': True, **info}}


def video(**info):
    told = {f'video.{key}': value for key, value in (CODING | info).items() if value is not None}
    told |= {'is_depth_map': True, 'video.extra_options': {'x265-params': 'lossless=1'}}
    return {'dtype': 'video', 'shape': [*SIZE, 1], 'info': told}


def write_video(path, images, form='gray12le'):
    """Encode codes of 12 bits without loss."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), 'w') as file:
        options = {'x265-params': 'lossless=1:log-level=none', 'g': '2'}
        stream = file.add_stream('libx265', rate=RATE, options=options)
        stream.pix_fmt, stream.height, stream.width = form, *images.shape[1:]
        for one in images:
            frame = av.VideoFrame.from_ndarray(one, format='gray12le').reformat(format=form)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def check(found, episode):
    """Assert that a recording is that of an episode."""
    np.testing.assert_array_equal(found.depth, metres(episode))
    np.testing.assert_allclose(found.stamp, np.arange(COUNT) / RATE, atol=1e-7)
    np.testing.assert_array_equal(found.K, [[20, 0, 15.5], [0, 20, 11.5], [0, 0, 1]])
    assert found.extra['camera'] == 'front_depth'


@pytest.mark.parametrize(
    ('kind', 'camera', 'step'),
    [
        ('image', 'cam_depth', 0),
        ('image', 'arr_depth', 0),
        ('video', 'cam_depth', 0.0021),  # at 2.9 m
        ('video', 'arr_depth', 0),
    ],
)
def test_what_lerobot_has_written_is_read(kind, camera, step, tmp_path):
    # By LeRobotDataset.create, add_frame and save_episode of version 0.6.1: two features of the
    # same uint16 millimetres, the first of them as images, or as a video in the usual coding.
    with tarfile.open(Path(__file__).with_name('lerobot_0_6_1.tar.xz')) as packed:
        packed.extractall(tmp_path, filter='data')
    out = tmp_path / 'out'
    assert convert(tmp_path / kind, out, '--views', '--camera', camera, *LENS) == 0
    for episode in (0, 1):
        found = load_recording(out / f'episode_{episode:06d}.npz')
        frame, row, column = np.ogrid[:4, :24, :32]
        depth = (400 + 1000 * episode + 100 * frame + 40 * row + 7 * column).astype(np.uint16)
        wanted = depth * np.float32(0.001)
        wanted[:, 3, 4] = np.nan
        np.testing.assert_allclose(found.depth, wanted, rtol=0, atol=step / 2)
        np.testing.assert_allclose(found.stamp, np.arange(4) / RATE, atol=1e-7)


@pytest.mark.parametrize(('written', 'form'), [(v2, 'TIFF'), (v3, 'PNG')])
def test_an_episode_of_images_becomes_a_recording(written, form, tmp_path):
    columns = [pictures(counts(episode), form) for episode in range(3)]
    root = written(tmp_path / 'set', image(depth_unit='mm'), *columns)
    check(converted(root, '--episode', '1', '--usecase', 'm', *LENS), 1)
    assert convert(root, tmp_path / 'all', '--views', *LENS) == 0
    for episode in range(3):
        check(load_recording(tmp_path / f'all/episode_{episode:06d}.npz'), episode)


def test_start_leads_from_a_data_set_to_its_recordings(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    v3(Path('set'), image(depth_unit='mm'), pictures(counts(0)), pictures(counts(1)))
    words = ['gap', 'start', 'set', '--profile', 'kinect_v2', '--planes', 'planes.yaml']
    monkeypatch.setattr('sys.stdin', io.StringIO('\n20 20 15.5 11.5\n'))
    assert main(words) == 0
    command = 'flexx2 convert set gap/recordings --views --usecase depth_30fps'
    assert f'$ {command} {" ".join(LENS)} --profile kinect_v2' in capfd.readouterr().err
    for episode in (0, 1):
        check(load_recording(Path(f'gap/recordings/episode_{episode:06d}.npz')), episode)
    assert 'episode_000001' in Path('planes.yaml').read_text()
    monkeypatch.setattr('sys.stdin', io.StringIO('\nmy lens.yaml\n'))
    assert main(words) == 2
    assert "--calibration 'my lens.yaml'" in capfd.readouterr().err


@pytest.mark.parametrize('written', [v2, v3])
def test_an_episode_of_numbers_becomes_a_recording(written, tmp_path):
    whole = {'dtype': 'uint16', 'shape': [*SIZE, 1]}
    root = written(tmp_path / 'set', whole, *(lists(counts(one)[..., None]) for one in (0, 1)))
    check(converted(root, '--episode', '1', '--camera', 'front_depth', *LENS), 1)
    # Metres, in images of one dimension less; a bag has the camera's name.
    root = written(tmp_path / 'm', {'dtype': 'float32', 'shape': [*SIZE]}, lists(metres(0)))
    assert convert(root, tmp_path / 'bag', *LENS) == 0
    found = load_recording(tmp_path / 'bag')
    np.testing.assert_array_equal(found.depth, metres(0))
    assert found.camera == 'front_depth'


@pytest.mark.parametrize('use_log', [True, False])
def test_a_video_gives_the_depth_of_its_codes(use_log, tmp_path, capsys):
    # The depth of a code by LeRobot's formula, the other way round.
    shift = 3.5 if use_log else 0.0
    apart = np.stack([counts(0), counts(1)]).reshape(-1, *SIZE) / 1000

    def scale(depth):
        return np.log(depth + shift) if use_log else depth

    share = (scale(apart) - scale(0.01)) / (scale(10.0) - scale(0.01))
    codes = np.rint(4095 * share).clip(0, 4095).astype(np.uint16)
    root = v3(tmp_path / 'set', video(use_log=use_log), None, None)
    write_video(root / 'videos' / KEY / 'chunk-000/file-000.mp4', codes)
    for episode in (0, 1):
        found = converted(root, '--episode', episode, *LENS).depth
        step = (13.5 if use_log else 10.0) / 4095 * (np.log(13.5 / 3.51) if use_log else 1.0)
        np.testing.assert_allclose(found, metres(episode), atol=step / 2)
    said = ' '.join(capsys.readouterr().err.split())
    assert f'depth is in steps of {"1.5" if use_log else "2.4"} mm at 1 m' in said
    assert 'with loss' not in said


def test_a_video_of_version_2_may_be_with_loss(tmp_path, capsys):
    feature = video()
    del feature['info']['video.extra_options']
    root = v2(tmp_path / 'set', feature, None)
    path = root / 'videos/chunk-000' / KEY / 'episode_000000.mp4'
    codes = np.tile(np.arange(2000, 2032, dtype=np.uint16), (COUNT, SIZE[0], 1))
    write_video(path, codes)
    depth = converted(root, *LENS).depth
    np.testing.assert_array_equal(depth, Coding(**CODING).table()[codes])
    assert 'may be with loss' in capsys.readouterr().err
    out = tmp_path / 'out.npz'
    write_video(path, codes[:-1])
    assert 'must have an image at 0.1333 s, got none' in refusal(capsys, root, out, *LENS)
    write_video(path, codes, 'yuv420p12le')
    said = refusal(capsys, root, out, *LENS)
    assert 'must be 32 x 24 pixels of gray12le, got 32 x 24 of yuv' in said
    path.write_bytes(b'#EXTM3U\nfile:///etc/passwd\n')
    assert 'episode_000000.mp4: cannot be read' in refusal(capsys, root, out, *LENS)


@pytest.mark.parametrize(
    ('feature', 'words', 'said'),
    [
        (image(), ['--camera', 'rear'], f"--camera: must be one of {KEY}, got 'rear'"),
        (image(), ['--camera', 'action'], 'action: shape: must be [H, W] or [H, W, 1], got [6]'),
        (image(), ['--episode', '2'], '--episode: must be one of the 2 from 0 to 1 (or'),
        (image(), [], '(or --views for all), got none'),
        (image(), ['--episode', '0', '--key', 'depth=x'], '--key: must be left out'),
        (image() | {'shape': [*SIZE, 3]}, [], 'shape: must be [H, W] or [H, W, 1], got'),
        (image() | {'shape': [10**6, 10**6]}, [], 'shape: must be at most'),
        (image() | {'shape': [24, 33]}, ['--episode', '0'], 'must be 33 x 24 pixels as in meta'),
        (image() | {'dtype': 'string'}, [], 'dtype: must be image, video or numbers'),
        (video(depth_min=None), ['--episode', '0'], 'video.depth_min: must be metres'),
        (video(depth_max=0.0), ['--episode', '0'], 'video.depth_max: must be above'),
        (video(shift=-1), ['--episode', '0'], 'video.shift: must be above -0.01'),
        (video(use_log=3), ['--episode', '0'], 'video.use_log: must be true or false, got 3'),
        (video(), ['--episode', '0', '--unit', '1'], '--unit: must be left out for a video'),
        (video(), ['--episode', '0'], 'must be a video, got no file'),
        ({'dtype': 'uint16', 'shape': [*SIZE]}, ['--episode', '0'], 'must be 32 x 24 numbers'),
    ],
)
def test_data_sets_that_cannot_be_used_are_refused(feature, words, said, tmp_path, capsys):
    root = v3(tmp_path / 'set', feature, pictures(counts(0)), pictures(counts(1)))
    assert said in refusal(capsys, root, tmp_path / 'out.npz', *LENS, *words)
    assert not (tmp_path / 'out.npz').exists()


def test_damaged_and_hostile_files_are_refused(tmp_path, capsys, monkeypatch):
    out = tmp_path / 'out.npz'

    def said(*words):
        return refusal(capsys, root, out, *LENS, *words)

    root = v2(tmp_path / 'set', image(), pictures(counts(0)))
    table, info = root / 'data/chunk-000/episode_000000.parquet', root / 'meta/info.json'
    assert '--intrinsics: must come with a LeRobot data set' in refusal(capsys, root, out)
    assert '--views, got 0' in said('--views', '--episode', '0')
    eight = counts(0).astype(np.uint8)
    pq.write_table(rows(0, pictures(eight)), table)
    assert 'image 0: must be a gray PNG of 16 bits a pixel, got 8 bits' in said()
    pq.write_table(rows(7, pictures(counts(0))), table)
    assert 'must have episode 0, got others' in said()
    pq.write_table(rows(0, pictures(counts(0), None)), table)
    assert 'image 0: must be an image, or' in said()
    pq.write_table(rows(0), table)
    assert f'{KEY}: must be a column' in said()
    monkeypatch.setenv(npz_arrays.LIMIT, '1')
    nothing = np.zeros((COUNT, 600, 800), np.float32)  # some kilobytes in the file
    info_of(root, 'v2.1', {'dtype': 'float32', 'shape': [600, 800]})
    pq.write_table(rows(0, lists(nothing)), table, compression='zstd')
    assert 'must not decompress to more than' in said()
    table.write_bytes(table.read_bytes()[:-20])
    assert 'episode_000000.parquet: must be a Parquet table, got another' in said()
    for content in (b'', bytes(9), b'\xff' * 400 + b'\x90\x01\0\0PAR1', b'\x19\x2c' + bytes(6)):
        table.write_bytes(content)
        assert 'episode_000000.parquet: ' in said()
    table.unlink()
    assert 'must have episodes, got none' in said()
    info_of(root, 'v2.1', image(), {'../../front_depth': image()})
    assert "features: must be names, got '../../front_depth'" in said(
        '--camera', '../../front_depth'
    )
    info_of(root, 'v4.0', image())
    assert 'codebase_version: must be v2 or v3, got v4.0' in said()
    info.write_text('[' * 10**6)
    assert 'info.json: cannot be read' in said()
    info.write_text('{"features": []}')
    assert 'features: must be a table, got []' in said()
