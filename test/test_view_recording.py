"""`flexx2 view` of recordings, and its ports and addresses before any page is open."""

import json
import signal
import socket
from urllib.parse import urlencode

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.cli.view_files import open_files
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording, open_recording
from flexx2_sim_ros.view.packing import UNIT
from flexx2_sim_ros.view.recorded import FrameReader, RecordedCamera
from made_bags import camera_entries, depths, write
import numpy as np
import pytest
from views import answer_of, EFFECTS, K, save_diagnosis, save_walk, serve_files, SIZE, USECASE


def packed_parts(body):
    """Return the head and the images, metres, of a frame."""
    length = int.from_bytes(body[:4], 'little')
    head = json.loads(body[4 : 4 + length])
    images = np.frombuffer(body[4 + length :], '<u2').reshape(-1, head['height'], head['width'])
    return head, list(images * UNIT)


@pytest.fixture
def walk(tmp_path):
    return save_walk(tmp_path / 'walk.npz')


def test_frames_come_in_any_order_and_few_stay_in_memory(tmp_path, walk):
    reader = open_recording(tmp_path / 'walk.npz')
    frames = FrameReader(reader, 3 * 2 * 4 * SIZE[0] * SIZE[1])
    for number in (0, 1, 2, 1, 9, 8, 3, 11, 0):
        images = frames.at(number)
        np.testing.assert_array_equal(images['depth'], walk['depth'][number])
        np.testing.assert_array_equal(images['clean_depth'], walk['clean_depth'][number])
        assert len(frames._kept) <= 3


def test_a_simulation_is_that_of_the_whole_sequence(tmp_path, walk):
    effects = parse_effects(EFFECTS)
    recorded = RecordedCamera(open_recording(tmp_path / 'walk.npz'), None, effects, 1 << 20)
    assert recorded.references == ['clean', 'simulated', 'effects']
    nanoseconds = np.rint(walk['stamp'] * 1e9).astype(np.int64)
    for key, chosen in (('simulated', ()), ('effects', effects)):
        camera = Camera(USECASE, effects=chosen, name='flexx2 view')
        whole = camera.capture(walk['clean_depth'], K, nanoseconds).depth
        for number in (0, 1, 2, 7, 8, 3):
            compared = recorded.frame(number, key).clean
            assert compared is not None
            np.testing.assert_array_equal(compared, whole[number])
    # The recording's own noise is another one.
    assert not np.allclose(
        recorded.frame(3, 'simulated').clean, walk['depth'][3], atol=1e-6, equal_nan=True
    )


def test_unknown_pixels_are_compared_with_nothing(tmp_path):
    known = np.ones(SIZE, bool)
    known[:, :20] = False
    save_walk(tmp_path / 'walk.npz', known=known)
    recorded = RecordedCamera(open_recording(tmp_path / 'walk.npz'), None, None, 1 << 20)
    for key in recorded.references:
        compared = recorded.frame(2, key).clean
        assert np.isnan(compared[:, :16]).all()
        assert np.isfinite(compared[:, 24:]).all()


@pytest.mark.parametrize(
    ('more', 'references', 'note'),
    [
        ({'usecase': np.array('Mode_X')}, ['clean'], 'no simulated depth: usecase: must be'),
        ({'clean_depth': np.float32(1)}, [], 'no clean_depth'),
    ],
)
def test_notes_say_what_depth_cannot_be_compared_with(tmp_path, more, references, note):
    arrays = save_walk(tmp_path / 'walk.npz', **more)
    if not references:
        np.savez(tmp_path / 'walk.npz', depth=arrays['depth'], K=K, stamp=arrays['stamp'])
    recorded = RecordedCamera(open_recording(tmp_path / 'walk.npz'), None, None, 1 << 20)
    assert recorded.references == references
    assert any(note in text for text in recorded.describe()['notes'])
    assert recorded.frame(0, 'simulated').clean is None


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Serve a bag of two cameras; return the address of its frames, and the bag."""
    entries = [
        entry
        for seed, name in enumerate(('left', 'right'))
        for entry in camera_entries(name, depths(5, 8, 9, seed), depths(5, 8, 9, seed + 2))
    ]
    folder = tmp_path_factory.mktemp('bag')
    path = write(folder / 'bag', sorted(entries, key=lambda entry: entry[2]))
    with serve_files(path) as origin:
        yield f'{origin}/frame', path


def get(url, **query):
    return answer_of(f'{url}?{urlencode(query)}')


@pytest.fixture(scope='module')
def planes(tmp_path_factory):
    """Serve a recording to draw on; return the page's origin and the file of planes."""
    folder = tmp_path_factory.mktemp('planes')
    save_walk(folder / 'walk.npz')
    with serve_files(folder / 'walk.npz', planes=folder / 'planes.yaml') as origin:
        yield origin, folder / 'planes.yaml'


def outline(corners, plane='left', recording=0):
    return json.dumps({'outline': [recording, plane, corners]}).encode()


def post(origin, body, **headers):
    code, said = answer_of(f'{origin}/outline', body, **{'Origin': origin} | headers)
    return code, said.decode()


TRIANGLE = [[1, 2], [30, 2], [30, 40]]


@pytest.mark.parametrize(
    ('body', 'headers', 'code', 'said'),
    [
        (outline(TRIANGLE), {'Origin': 'http://elsewhere.example'}, 403, 'Origin'),
        (outline(TRIANGLE), {'Origin': ''}, 403, 'Origin'),
        (outline(TRIANGLE), {'Host': 'elsewhere.example'}, 403, 'Host'),
        (outline(TRIANGLE[:2]), {}, 400, 'outline: must be a list of 3 to 100 corners'),
        (outline([[1, 2]] * 101), {}, 400, 'outline: must be a list of 3 to 100 corners'),
        (outline([[1, 'x']] * 3), {}, 400, 'message: must be JSON as the page sends it'),
        (outline(TRIANGLE, recording=1), {}, 400, 'must be the outline of a plane'),
        (outline(TRIANGLE, plane=''), {}, 400, 'name: must be a text of 1 to 60 letters'),
        (b'{"drawn": "a"}', {}, 400, 'must be the outline of a plane'),
        (b'\xff', {}, 400, 'message: must be JSON as the page sends it'),
    ],
)
def test_what_is_no_outline_of_the_page_is_refused(planes, body, headers, code, said):
    origin, path = planes
    found = post(origin, body, **headers)
    assert found[0] == code
    assert said in found[1]
    assert not path.exists()


def test_nothing_is_saved_without_a_file(bag):
    assert post(bag[0].removesuffix('/frame'), outline(TRIANGLE))[0] == 405


def test_each_camera_of_a_bag_is_served(bag):
    url, path = bag
    for number, name in enumerate(('left', 'right')):
        recording = load_recording(path, name)
        for frame in (4, 0):
            code, body = get(url, recording=0, camera=number, number=frame, reference='clean')
            head, images = packed_parts(body)
            assert (code, head['camera']) == (200, name)
            for image, wanted in zip(
                images, (recording.depth[frame], recording.clean_depth[frame]), strict=True
            ):
                np.testing.assert_allclose(image, wanted, atol=UNIT)


@pytest.mark.parametrize(
    'query',
    [
        {'recording': 0, 'camera': 0},
        {'recording': 1, 'camera': 0, 'number': 0},
        {'recording': 0, 'camera': 2, 'number': 0},
        {'recording': 0, 'camera': 0, 'number': 5},
        {'recording': 0, 'camera': 0, 'number': -1},
        {'recording': 0, 'camera': 0, 'number': '٣'},
        {'recording': 0, 'camera': 0, 'number': 5000 * '1'},
        {'recording': 0, 'camera': 0, 'number': 0, 'reference': '../x'},
    ],
)
def test_wrong_requests_are_refused(bag, query):
    code, body = get(bag[0], **query)
    assert code == 400
    assert body.count(b'\n') == 1


def test_a_file_that_breaks_while_it_is_shown_is_reported(bag):
    _, path = bag
    (file,) = path.glob('*.mcap')
    content = file.read_bytes()
    with serve_files(path) as origin:
        file.write_bytes(b'')
        code, body = get(f'{origin}/frame', recording=0, camera=0, number=3)
        assert code == 500
        assert str(path) in body.decode()
        assert b'\n' not in body
        file.write_bytes(content)
        assert get(f'{origin}/frame', recording=0, camera=0, number=3)[0] == 200


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['{}/none.npz'], 'none.npz: must be an .npz archive, got no file'),
        (['{}/none'], 'none: must be'),
        (['{}/walk.npz', '{}/walk.npz'], 'PATH: must be a diagnosis if there is a CAMPAIGN'),
        (['{}/diagnosis'], 'CAMPAIGN: must be the folder of the recordings'),
        (['{}/odd', '{}/walk.npz'], 'diagnosis.json: must be what flexx2 gap diagnose writes'),
        (['{}/walk.npz', '--demo'], '--demo: must be left out with PATH'),
        (['{}/broken'], 'one.npz: '),
        (['{}/walk.npz', '--profile', 'no_camera'], 'profile: must be one of'),
        (['--scene', 'lab'], '--scene: must be left out without --demo, got'),
        (['--port', '70000'], '--port: must be a whole number from 0 to 65535'),
        (['--host', '203.0.113.1'], "--host: must be an address of this machine, got '203.0.113"),
        (['--host', 'no.such.host.invalid'], "got 'no.such.host.invalid'"),
    ],
)
def test_what_cannot_be_shown_ends_with_one_sentence(
    tmp_path, walk, capsys, monkeypatch, words, said
):
    # Or a page that is served by mistake would be served for ever.
    monkeypatch.setattr(signal, 'pause', lambda: pytest.fail('it is shown'))
    (tmp_path / 'broken').mkdir()
    (tmp_path / 'broken' / 'one.npz').write_bytes((tmp_path / 'walk.npz').read_bytes()[:2000])
    save_diagnosis(tmp_path / 'diagnosis')
    save_diagnosis(tmp_path / 'odd', verdict='gap', effects=[{}])
    paths = [word.format(tmp_path) for word in words]
    assert main(['view', '--no-browser', '--port', '0', *paths]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count('\n') == 1


def test_a_broken_recording_of_a_folder_is_left_out(tmp_path, capsys):
    (tmp_path / 'folder').mkdir()
    save_walk(tmp_path / 'folder' / 'walk.npz')
    (tmp_path / 'folder' / 'broken.npz').write_bytes(b'PK')
    recordings, _ = open_files(tmp_path / 'folder', None, [], '')
    assert list(recordings) == ['walk.npz']
    assert 'left out: ' in capsys.readouterr().err
    with pytest.raises(InputError, match='broken.npz'):
        open_files(tmp_path / 'folder' / 'broken.npz', None, [], '')


def test_a_port_in_use_is_reported_before_anything_starts(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    with socket.create_server(('127.0.0.1', 0)) as other:
        port = other.getsockname()[1]
        assert main(['view', '--demo', '--no-browser', '--port', str(port)]) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert said.err == (
        f'flexx2: error: --port: must be free, or 0 for any, got {port}, which is in use '
        'on 127.0.0.1\n'
    )
    assert list(tmp_path.iterdir()) == []
