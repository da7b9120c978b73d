"""Sets of effects in files and tables, right ones and wrong ones."""

import io
import json
import math
from pathlib import Path
import zipfile

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import load_effects, parse_effects, registry, save_effects
from flexx2_sim_ros.effects.presets import markdown, preset_files
from flexx2_sim_ros.effects.registry import for_reports
from flexx2_sim_ros.effects.tables import plain
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
from flexx2_sim_ros.physics.geometry import ray_length
import numpy as np
import pytest
from small_scenes import capture, same, scenes, SHADES, SMALL
import yaml

ROOT = Path(__file__).parent.parent


def test_sets_are_written_and_read_again(tmp_path):
    values = {'wiggling': {'a1': -0.001, 'b4': 1e-5}, 'low_signal_dropout': {'half': 1e-5}}
    values['quantisation'] = {'step': 0.1, 'strength': 0}
    effects = parse_effects(values)
    path = tmp_path / 'some.yaml'
    save_effects(path, effects, 'Two lines\nof comment: {not yaml}')
    assert load_effects(path) == effects
    assert path.read_text().startswith('# Two lines\n# of comment')
    in_order = ['wiggling', 'quantisation', 'low_signal_dropout']
    assert [effect.name for effect in effects] == in_order
    assert effects[1].step == 0.1
    save_effects(path, ())
    assert load_effects(path) == ()
    assert same(capture(path, scenes(1), 0), capture((), scenes(1), 0))
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match='cannot be written'):
        save_effects(tmp_path / 'nowhere' / 'some.yaml', effects)


def test_presets_are_what_the_registry_says():
    """Run `flexx2 effects --write-presets config/effects` when this fails."""
    folder = config_dir() / 'effects'
    assert {path.name: path.read_text() for path in folder.iterdir()} == preset_files()
    for name, kind in registry().items():
        assert load_effects(folder / f'{name}.yaml') == (kind(),)
        assert load_effects(name) == (kind(),)
    typical = load_effects('typical')
    assert {effect.strength for effect in typical} == {1.0}
    assert {'multipath', 'saturation', 'wiggling'} < {effect.name for effect in typical}
    frame = Camera(effects='typical').capture(scenes(1), SMALL, 0, SHADES)
    assert np.isfinite(frame.depth).mean() > 0.3


def test_the_documentation_is_what_the_registry_says():
    """Run `flexx2 effects --markdown > docs/effects.md` when this fails."""
    assert (ROOT / 'docs' / 'effects.md').read_text(encoding='utf-8') == markdown()


CURVES = {
    'offset': {'curve': {'knots': [0.0, 4.0], 'values': [0.01, 0.03]}},
    'wiggling': {'curve': {'knots': [0, 0.5, 1.0], 'values': [0, 1e-5, 0.004], 'period': 2.5}},
    'amplitude_bias': {'curve': {'knots': [-4.0, 0.0], 'values': [-0.02, 0.0]}},
    'warm_up_drift': {'curve': {'knots': [0.0, 600.0], 'values': [0.02, 0.0]}},
    'fixed_pattern': {'pattern': np.linspace(-0.01, 0.01, SHADES.size).reshape(SHADES.shape)},
    'low_signal_dropout': {'curve': {'knots': [-4.0, -3.0], 'values': [0.9, 0.0]}},
    'grazing_dropout': {'slant': {'knots': [-1.0, 1.0], 'values': [0.0, 0.6]}},
    'saturation': {'curve': {'knots': [-1.0, 0.0], 'values': [0.0, 0.7]}, 'bleed': 4.0},
    'flying_pixels': {'width': 1.0, 'mhz': 40.0},
    'multipath': {'mhz': 40.0},
    'stray_light': {'radius': 0.02, 'exponent': 1.2, 'frequency_factor': 0.5},
    'range_wrap': {'noise': 20.0},
    'temporal_filter': {'gate': 0.2},
    'spatial_filter': {'width': 1.5},
}


def bad_tables():
    """Return tables that cannot be used, and what the error must name."""
    yield {'blur': None}, 'blur'
    yield {5: None}, '5'
    yield {'offset': 3}, 'offset'
    yield {'offset': [0.1]}, 'offset'
    yield {'offset': {'bis': 0.1}}, r'offset\.bis.*bias'
    yield {'offset': {7: 0.1}}, r'offset\.7'
    for value in (0.3, math.nan, math.inf, '0.1', None, True, [0.1], {}, 10**400):
        yield {'offset': {'bias': value}}, r'offset\.bias: must be .* -0.2 to 0.2 m, got'
    for value in (-0.1, 4.1):
        yield {'range_wrap': {'strength': value}}, r'range_wrap\.strength: must be .* 0 to 4, got'
    good = CURVES['wiggling']['curve']
    for value in (3, [1, 2], {}, {'knots': [1]}, {**good, 'more': 1}):
        yield {'wiggling': {'curve': value}}, r'wiggling\.curve: must be a table of knots'
    for knots in ([0, 0, 1], [1, 0, 2]):
        yield {'wiggling': {'curve': {**good, 'knots': knots}}}, r'wiggling\.curve\.knots: must r'
    for knots in ([], 'abc', [0, 'x', 2], [0, math.nan, 1], [True, 2, 3], list(range(401))):
        yield {'wiggling': {'curve': {**good, 'knots': knots}}}, r'wiggling\.curve\.knots: must be'
    yield {'wiggling': {'curve': {**good, 'values': [0, 1]}}}, r'wiggling\.curve\.values: .* 3,'
    yield {'wiggling': {'curve': {**good, 'values': [0, 1, 0]}}}, r'wiggling\..* -0.2 to 0.2 m,'
    yield {'wiggling': {'curve': {**good, 'period': 0.9}}}, r'wiggling\.curve\.period: must be'
    yield {'saturation': {'curve': {'knots': [1], 'values': [1.1]}}}, r'saturation\..* 0 to 1, go'
    yield {'along_ray': {'curve': good}}, r'along_ray\.curve: must be one of'
    maps = np.zeros(3), np.zeros((2, 2), int), np.full((2, 2), 0.3), np.full((2, 2), np.nan)
    for value in maps:
        yield {'fixed_pattern': {'pattern': value}}, r'fixed_pattern\.pattern: must be'


@pytest.mark.parametrize(('table', 'named'), list(bad_tables()))
def test_what_cannot_be_used_is_named(table, named):
    with pytest.raises(InputError, match=f'^effects: {named}') as error:
        parse_effects(table)
    assert len(str(error.value)) < 500


RUINED = '', '- 1', 'schema: 1', 'schema: 2\neffects: {}', 'effects: {}', 'schema: 1\neffects: ['
RUINED += 'schema: 1\neffects: 5', 'schema: 1\neffects: [offset]', '\x00'


@pytest.mark.parametrize('text', RUINED)
def test_a_ruined_file_is_named(text, tmp_path):
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    for use in (load_effects, lambda path: Camera(effects=path)):
        with pytest.raises(InputError, match=r'bad\.yaml'):
            use(path)
    with pytest.raises(InputError, match=r'missing\.yaml'):
        load_effects(tmp_path / 'missing.yaml')


@pytest.mark.parametrize('effects', [5, [5], ['offset'], None, [registry()['offset']]])
def test_what_is_no_effect_is_refused(effects):
    with pytest.raises(InputError, match='^effects: must be'):
        Camera(effects=effects)


@pytest.mark.parametrize('name', list(CURVES))
def test_a_curve_map_or_number_takes_the_place_of_the_formula(name, tmp_path):
    own = parse_effects({name: CURVES[name]})
    path = tmp_path / 'calibrated.yaml'
    save_effects(path, own)
    assert load_effects(path) == own
    stamps = np.arange(2) / 30.0
    seen = capture(path, scenes(2), stamps)
    assert same(seen, capture({name: CURVES[name]}, scenes(2), stamps))
    for other in ((), (registry()[name](),)):
        assert not same(seen, capture(other, scenes(2), stamps))
    # As in the JSON files of a diagnosis.
    text = json.dumps({name: plain(own[0].settings)})
    assert parse_effects(json.loads(text)) == own


@pytest.mark.filterwarnings('error')
def test_pixels_without_a_return_cause_no_warning():
    for table in (*({name: value} for name, value in CURVES.items()), {'wiggling': {'mhz': 40.0}}):
        frame = capture(table, scenes(2), np.arange(2) / 30.0)
        assert np.isnan(frame.depth).any()


def test_curves_are_metres_along_the_ray_and_maps_metres_of_depth():
    clean = np.linspace(1.0, 1.4, 32) * np.ones((24, 1))
    length = ray_length(SMALL, clean.shape)

    def shifts_by(table, wanted):
        change = capture(table, clean, 0).depth - capture((), clean, 0).depth
        return np.allclose(change, wanted, atol=1e-6)

    there = clean * length
    flat = {'curve': {'knots': [1.0], 'values': [0.02]}}
    assert shifts_by({'offset': flat}, 0.02 / length)
    rising = (0.01 + 0.005 * np.minimum(there, 4.0)) / length
    assert shifts_by({'offset': CURVES['offset']}, rising)
    assert shifts_by({'offset': {**flat, 'strength': 0.5}}, 0.01 / length)
    pattern = CURVES['fixed_pattern']
    assert shifts_by({'fixed_pattern': pattern}, pattern['pattern'])
    warm = {'warm_up_drift': {**CURVES['warm_up_drift'], 'uptime': 300.0}}
    assert shifts_by(warm, 0.01 / length)


def test_curves_of_dropouts_are_chances():
    """200 frames of 100 or more pixels: the share is known to 0.005, 8 of these are 0.04."""
    clean = np.full(SHADES.shape, 1.0, np.float32)
    stamps = np.arange(200) / 30.0
    for strength, wanted in ((1.0, 0.6), (2.0, 0.84)):
        curve = {'knots': [-3.0, -2.99], 'values': [0.6, 0.0]}
        table = {'low_signal_dropout': {'curve': curve, 'strength': strength}}
        lost = np.isnan(capture(table, clean, stamps).depth).mean(axis=0)
        assert lost[:, 0].mean() == pytest.approx(wanted, abs=0.04)
        assert lost[:, -1].max() == 0


def test_a_map_comes_from_one_array_beside_the_file(tmp_path):
    path, side = tmp_path / 'some.yaml', tmp_path / 'pattern.npz'

    def refused(name):
        table = {'schema': 1, 'effects': {'fixed_pattern': {'pattern': name}}}
        path.write_text(yaml.safe_dump(table))
        where = r'some\.yaml: effects: fixed_pattern\.pattern: '
        with pytest.raises(InputError, match=where) as error:
            load_effects(path)
        return str(error.value)

    for name in ('../pattern.npz', 'pattern.txt', 5, str(side)):
        assert 'must be the name of an .npz file beside this file' in refused(name)
    assert 'got no file' in refused(side.name)
    side.write_bytes(b'no archive')
    assert 'cannot be read' in refused(side.name)
    np.savez(side, map=np.array([{}], object))
    assert 'cannot be read' in refused(side.name)
    np.savez(side, map=np.zeros((2, 2)), more=np.zeros(1))
    assert 'must have one array, map' in refused(side.name)
    np.savez_compressed(side, map=np.zeros((4000, 4000)))
    assert 'must be at most' in refused(side.name)
    np.savez_compressed(side, map=np.random.default_rng(0).normal(size=(50, 50)))
    damaged = bytearray(side.read_bytes())
    damaged[60:100] = b'\xff' * 40  # zlib refuses this; the checksum is not looked at.
    side.write_bytes(damaged)
    assert 'cannot be read' in refused(side.name)
    # A header of 1.6 TB over no content.
    head = io.BytesIO()
    shape = {'descr': '<f4', 'fortran_order': False, 'shape': (200_000, 2_000_000)}
    np.lib.format.write_array_header_1_0(head, shape)
    with zipfile.ZipFile(side, 'w') as archive:
        archive.writestr('map.npy', head.getvalue())
    assert 'cannot be read' in refused(side.name)
    assert len(refused('n' * 5000 + '.npz')) < 700


def test_a_map_of_another_size_than_the_image_is_named():
    effects = parse_effects({'fixed_pattern': {'pattern': np.zeros((5, 4))}})
    with pytest.raises(InputError, match=r'pattern: must have the size.*\(24, 32\)'):
        capture(effects, scenes(1), 0)


def test_a_report_names_the_file_of_a_map(tmp_path):
    curve = {'knots': [0.0, 1.0], 'values': [0.0, 0.01]}
    camera = {'fixed_pattern': {'pattern': np.full((3, 4), 0.01)}, 'offset': {'curve': curve}}
    effects = parse_effects(camera)
    save_effects(tmp_path / 'effects.yaml', effects)
    told = json.loads(json.dumps(for_reports({one.name: one.settings for one in effects})))
    assert (tmp_path / told['fixed_pattern']['pattern']).is_file()
    assert told['offset']['curve'] == curve
