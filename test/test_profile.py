"""Camera profiles: read back as written, refused by name, run by library, CLI and node."""

from dataclasses import replace
import math

from flexx2_sim_ros.camera import Camera, flexx2, Intrinsics, Mode, NoiseModel, Profile
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.files import load_profile, ProfileFile, read_profile, save_profile
import numpy as np
import pytest
import yaml

NOISE = NoiseModel(0.004, -0.001, 0.002, 0.0005, 1.5, 0.7)
NARROW = Mode('Narrow', 12.5, 0.3, 4.0, (), 0, (1, 80000), NOISE, 'Narrow', 'profile')
LOUD = replace(NOISE, a=0.006)
WIDE = Mode('Wide.1+', 25.0, 0.2, 6.0, (100e6, 20e6), 9, (5, 400), LOUD, 'Wide.1+', 'profile')
LENS = Intrinsics(64, 48, 60.0, 61.0, 30.5, 24.25, (0.1, 0.0, 0.0, 0.0, 0.0))
OTHER = Profile('Kamera Ü', LENS, (NARROW, WIDE))
ERRORS, MEASURED = {'Narrow': {'a': 1e-5, 'n': 0.2}}, {'Narrow': {'frames': 300}}
WHOLE = ProfileFile(OTHER, ERRORS, MEASURED, {'date': '2026-01-31', 'notes': ['a note']})


@pytest.fixture
def path(tmp_path):
    save_profile(tmp_path / 'profile.yaml', WHOLE)
    return tmp_path / 'profile.yaml'


def test_a_profile_is_read_back_as_it_was_written(path):
    content = read_profile(path)
    assert content.profile.model == OTHER.model
    assert content.profile.intrinsics == OTHER.intrinsics
    assert content.profile.modes == OTHER.modes
    unknown = dict.fromkeys(('b', 'c', 'd', 'sigma_x'))
    assert content.standard_errors['Narrow'] == {'a': 1e-5, 'n': 0.2, **unknown}
    assert content.measured['Narrow'] == {'frames': 300}
    assert content.provenance == WHOLE.provenance
    save_profile(path.parent / 'again.yaml', content)
    assert (path.parent / 'again.yaml').read_text() == path.read_text()
    assert [file.name for file in sorted(path.parent.iterdir())] == ['again.yaml', 'profile.yaml']


def test_the_built_in_camera_is_a_profile_too(tmp_path):
    save_profile(tmp_path / 'flexx2.yaml', ProfileFile(flexx2()))
    loaded = load_profile(tmp_path / 'flexx2.yaml')
    assert loaded.intrinsics == flexx2().intrinsics
    for mode, own in zip(loaded.modes, flexx2().modes, strict=True):
        assert replace(mode, noise_of=own.noise_of, source=own.source) == own
    assert loaded.default_usecase == flexx2().default_usecase == 'Mode_9_30fps'
    assert OTHER.default_usecase == 'Narrow'


def moving(path, **fields):
    """Return frames of a wall that comes nearer, of a mode with other fields."""
    table = yaml.safe_load(path.read_text())
    table['modes']['Wide.1+'] |= fields
    changed = path.with_name('changed.yaml')
    changed.write_text(yaml.safe_dump(table))
    clean = np.broadcast_to(np.linspace(2.0, 1.9, 3)[:, None, None], (3, 48, 64))
    camera = Camera('Wide.1+', profile=load_profile(changed), effects={'motion_artefact': {}})
    return camera.capture(clean, OTHER.intrinsics.matrix, np.arange(3) * 40_000_000).depth


def test_raw_frames_take_no_longer_than_a_frame_if_their_exposure_is_not_known(path):
    # A readout takes 600 us: at 25 Hz this leaves 4400 us of exposure to each of eight.
    whole = moving(path, raw_frames=8, exposure_us=[1, 4400])
    np.testing.assert_array_equal(moving(path, raw_frames=8, exposure_us=None), whole)
    assert not np.array_equal(moving(path, raw_frames=8, exposure_us=[1, 2200]), whole)


def test_an_unknown_number_of_raw_frames_is_four_for_each_frequency(path):
    given = {'exposure_us': [1, 2200]}
    stated = moving(path, raw_frames=8, **given)
    np.testing.assert_array_equal(moving(path, raw_frames=None, **given), stated)
    assert not np.array_equal(moving(path, raw_frames=4, **given), stated)


@pytest.mark.parametrize('exposure', [[1, 2200], None])
@pytest.mark.parametrize('raw_frames', [8, None])
def test_an_exposure_is_kept_whether_raw_frames_are_known_or_not(raw_frames, exposure, path):
    table = yaml.safe_load(path.read_text())
    table['modes']['Wide.1+'] |= {'raw_frames': raw_frames, 'exposure_us': exposure}
    path.write_text(yaml.safe_dump(table))
    content = read_profile(path)
    save_profile(path.with_name('again.yaml'), content)
    written = yaml.safe_load(path.with_name('again.yaml').read_text())['modes']['Wide.1+']
    assert (written['raw_frames'], written['exposure_us']) == (raw_frames, exposure)
    assert read_profile(path.with_name('again.yaml')).profile == content.profile


def put(value, *keys):
    """Return a function that changes a field of a table; the value `...` leaves it out."""

    def change(table):
        *path, last = keys
        for key in path:
            table = table[key]
        table[last] = value
        if value is ...:
            del table[last]

    return change


def missing(*keys):
    """Return a function that leaves out a field of a table."""
    return put(..., *keys)


MODE = ('modes', 'Narrow')
DIP = {'a': 0.004, 'b': -0.01, 'c': 0.004, 'd': 0.0, 'n': 2.7, 'sigma_x': 1.0}
BAD = [
    *((missing(key), key) for key in ('model', 'intrinsics', 'modes')),
    *((missing('intrinsics', key), f'intrinsics.{key}') for key in ('width', 'fy', 'distortion')),
    *(
        (missing(*MODE, key), f'modes.Narrow.{key}')
        for key in ('rate_hz', 'range_m', 'modulation_hz', 'raw_frames', 'exposure_us', 'noise')
    ),
    *((missing(*MODE, 'noise', key), f'modes.Narrow.noise.{key}') for key in ('a', 'sigma_x')),
    (missing(*MODE, 'standard_errors', 'd'), 'modes.Narrow.standard_errors.d'),
    (put(1, *MODE, 'noise', 'e'), 'modes.Narrow.noise.e'),
    (put(2, 'schema'), 'schema'),
    (put('a\x07', 'model'), 'model'),
    (put('text', 'provenance'), 'provenance'),
    (put(0, 'intrinsics', 'width'), 'intrinsics.width'),
    (put(-60.0, 'intrinsics', 'fx'), 'intrinsics.fx'),
    (put([0.0] * 4, 'intrinsics', 'distortion'), 'intrinsics.distortion'),
    (put(0, *MODE, 'rate_hz'), 'modes.Narrow.rate_hz'),
    (put([4.0, 0.3], *MODE, 'range_m'), 'modes.Narrow.range_m'),
    (put([], *MODE, 'modulation_hz'), 'modes.Narrow.modulation_hz'),
    (put(2.5, *MODE, 'raw_frames'), 'modes.Narrow.raw_frames'),
    (put([400, 5], *MODE, 'exposure_us'), 'modes.Narrow.exposure_us'),
    (put(2.0, *MODE, 'noise', 'a'), 'modes.Narrow.noise.a'),
    (put(-0.1, *MODE, 'noise', 'sigma_x'), 'modes.Narrow.noise.sigma_x'),
    # Negative in the middle of the range only, and at its far end only.
    (put(DIP, *MODE, 'noise'), 'modes.Narrow.noise: sigma_z must be positive from'),
    (put(-0.01, *MODE, 'noise', 'b'), 'modes.Narrow.noise: sigma_z'),
    (put(0.9, *MODE, 'noise', 'd'), 'modes.Narrow.noise: sigma_z'),
    (put(-1.0, *MODE, 'standard_errors', 'a'), 'modes.Narrow.standard_errors.a'),
    (put(1, 'sensor', 'colour'), 'sensor.colour'),
    (put('radar', 'sensor', 'kind'), 'sensor.kind'),
    (put(90.0, 'sensor', 'incidence_cap_deg'), 'sensor.incidence_cap_deg'),
    (put(1.5, 'sensor', 'neighbourhood_px'), 'sensor.neighbourhood_px'),
    (put(math.inf, 'sensor', 'full_scale_amplitude'), 'sensor.full_scale_amplitude'),
    (put([[0, 0], [1, 1], [1]], 'sensor', 'valid_region_px'), 'sensor.valid_region_px'),
]


@pytest.mark.parametrize(('change', 'named'), BAD)
def test_a_bad_field_is_refused_by_name(path, change, named):
    table = yaml.safe_load(path.read_text(encoding='utf-8'))
    change(table)
    path.write_text(yaml.safe_dump(table), encoding='utf-8')
    with pytest.raises(InputError) as error:
        load_profile(path)
    assert str(error.value).startswith(f'{path}: {named}')
    assert 'must be' in str(error.value)


def test_what_the_simulation_does_not_need_may_be_left_out(path):
    table = yaml.safe_load(path.read_text(encoding='utf-8'))
    del table['provenance'], table['sensor']
    for mode in table['modes'].values():
        del mode['standard_errors'], mode['measured'], mode['noise_from']
    path.write_text(yaml.safe_dump(table), encoding='utf-8')
    content = read_profile(path)
    modes = tuple(replace(mode, noise_from='not_stated') for mode in OTHER.modes)
    assert content.profile.modes == modes
    assert set(content.standard_errors['Narrow'].values()) == {None}
    assert content.measured == {'Narrow': {}, 'Wide.1+': {}}
    assert content.provenance == {}


def test_all_missing_fields_are_named_at_once(path):
    table = yaml.safe_load(path.read_text(encoding='utf-8'))
    for key in ('rate_hz', 'raw_frames', 'noise'):
        del table['modes']['Narrow'][key]
    path.write_text(yaml.safe_dump(table), encoding='utf-8')
    said = r'Narrow\.rate_hz \(and also raw_frames, noise\): must be'
    with pytest.raises(InputError, match=said):
        load_profile(path)


def test_a_number_that_yaml_takes_for_a_text_is_explained(path):
    text = path.read_text(encoding='utf-8').replace('100000000.0', '100e6')
    path.write_text(text, encoding='utf-8')
    with pytest.raises(InputError, match=r'100e6 for a text; write 100000000\.0$'):
        load_profile(path)


BAD_NAMES = ['', ' ', '9fps', 'a b', 'ä', 'x' * 65, '../m', 'm:=1']


@pytest.mark.parametrize(
    ('name', 'said'),
    [*((name, 'modes: names must be') for name in BAD_NAMES), ('WIDE.1+', 'case')],
)
def test_a_bad_mode_name_is_refused(path, name, said):
    table = yaml.safe_load(path.read_text(encoding='utf-8'))
    table['modes'][name] = table['modes'].pop('Narrow')
    path.write_text(yaml.safe_dump(table), encoding='utf-8')
    with pytest.raises(InputError, match=said):
        load_profile(path)


@pytest.mark.parametrize('content', [b'', b'- 1', b'\xff\xfe', b'schema: [', b'!!python/object:x'])
def test_a_file_that_is_not_a_profile_is_refused(path, content):
    path.write_bytes(content)
    with pytest.raises(InputError, match=r'profile\.yaml'):
        load_profile(path)
    path.unlink()
    with pytest.raises(InputError, match=r'profile\.yaml'):
        load_profile(path)


def test_a_bad_profile_is_not_written(tmp_path):
    falling = replace(NARROW, noise=replace(NOISE, b=-0.01))
    target = tmp_path / 'profile.yaml'
    target.write_text('precious')
    with pytest.raises(InputError, match=r'profile\.yaml: modes\.Narrow\.noise'):
        save_profile(target, replace(WHOLE, profile=replace(OTHER, modes=(falling,))))
    assert target.read_text() == 'precious'
    assert list(tmp_path.iterdir()) == [target]
    with pytest.raises(InputError, match='cannot be written'):
        save_profile(tmp_path / 'no' / 'such.yaml', WHOLE)


def test_the_library_runs_it(path):
    """Assert the realised noise; 400 x 3,072 samples know sigma to 0.06 %: 0.5 % is 7.8 of it."""
    profile = load_profile(path)
    scene = np.full((48, 64), 2.0, np.float32)
    camera = Camera('wide.1+', profile=profile, seed=3)
    frames = camera.capture(scene, profile.intrinsics.matrix, np.arange(400))
    assert camera.usecase == 'Wide.1+'
    modelled = float(np.sqrt(np.mean(frames.sigma[0].astype(float) ** 2)))
    realised = np.sqrt(frames.depth.astype(float).var(axis=0).mean())
    assert realised == pytest.approx(modelled, rel=0.005)
    middle = WIDE.noise.sigma_z(2.0, 0.0)
    assert frames.sigma[0, 24, 30] == pytest.approx(float(middle), rel=1e-3)
    with pytest.raises(InputError, match='must be one of Narrow, Wide'):
        Camera('Mode_9_30fps', profile=profile)


def test_the_command_line_runs_it(path, tmp_path, capsys):
    scene, out = str(tmp_path / 'scene.npz'), str(tmp_path / 'out.npz')
    np.savez(scene, clean_depth=np.full((48, 64), 2.0), K=OTHER.intrinsics.matrix)
    assert main(['simulate', scene, out, '--profile', str(path), '--frames', '4']) == 0
    with np.load(out, allow_pickle=False) as recording:
        assert recording['usecase'] == 'Narrow'
        np.testing.assert_allclose(np.diff(recording['stamp']), 1 / 12.5)
    path.write_text(path.read_text().replace('sigma_x: 0.7', 'sigma_x: -0.7'))
    assert main(['simulate', scene, out, '--profile', str(path)]) == 2
    assert 'modes.Narrow.noise.sigma_x: must be' in capsys.readouterr().err


def test_the_node_runs_it(ros, path):
    from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
    from rclpy.parameter import Parameter

    node = Flexx2Camera(parameter_overrides=[Parameter('profile', value=str(path))])
    try:

        def value(name):
            return node.get_parameter(name).value

        assert list(value('available_usecases')) == ['Narrow', 'Wide.1+']
        assert value('usecase') == 'Narrow'
        assert value('model') == 'Kamera Ü'
        assert (value('fx'), value('cy')) == (60.0, 24.25)
        assert node.settings.intrinsics == OTHER.intrinsics
        # Not known: no longer than a frame.
        assert value('exposure_time_0') == 80000
        assert node.set_parameters([Parameter('usecase', value='wide.1+')])[0].successful
        assert value('usecase') == 'Wide.1+'
        assert value('exposure_time_0') == 400
        answer = node.set_parameters([Parameter('usecase', value='Mode_9_30fps')])[0]
        assert not answer.successful
        assert 'Narrow, Wide.1+' in answer.reason
    finally:
        node.destroy_node()
