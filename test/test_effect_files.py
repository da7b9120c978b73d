"""Sets of effects in files and tables, right ones and wrong ones."""

from collections.abc import Iterator
import math
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import Effect, load_effects, parse_effects, registry, save_effects
from flexx2_sim_ros.effects.presets import markdown, preset_files
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.paths import config_dir
import numpy as np
import pytest
from small_scenes import capture, same, scenes, SHADES, SMALL
import yaml

ROOT = Path(__file__).parent.parent


def test_sets_are_written_and_read_again(tmp_path: Path) -> None:
    values = {
        'wiggling': {'a1': -0.001, 'b4': 1e-5},
        'low_signal_dropout': {'half': 1e-5},
        'quantisation': {'step': 0.1, 'strength': 0},
    }
    effects = parse_effects(values)
    path = tmp_path / 'some.yaml'
    save_effects(path, effects, 'Two lines\nof comment: {not yaml}')
    assert load_effects(path) == effects
    assert path.read_text().startswith('# Two lines\n# of comment')
    assert [effect.name for effect in effects] == [
        'wiggling',
        'quantisation',
        'low_signal_dropout',
    ]
    assert effects[1].step == 0.1
    save_effects(path, ())
    assert load_effects(path) == ()
    assert same(capture(path, scenes(1), 0), capture((), scenes(1), 0))
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match='cannot be written'):
        save_effects(tmp_path / 'nowhere' / 'some.yaml', effects)


def test_presets_are_what_the_registry_says() -> None:
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


def test_the_documentation_is_what_the_registry_says() -> None:
    """Run `flexx2 effects --markdown > docs/effects.md` when this fails."""
    assert (ROOT / 'docs' / 'effects.md').read_text(encoding='utf-8') == markdown()


def bad_tables() -> Iterator[tuple[Any, str]]:
    """Return tables that cannot be used, and what the error must name."""
    yield {'blur': None}, 'blur'
    yield {5: None}, '5'
    yield {'offset': 3}, 'offset'
    yield {'offset': [0.1]}, 'offset'
    yield {'offset': {'bis': 0.1}}, r'offset\.bis.*bias'
    yield {'offset': {7: 0.1}}, r'offset\.7'
    for value in (0.3, -1, math.nan, math.inf, '0.1', None, True, [0.1], {}, 10**400):
        yield {'offset': {'bias': value}}, r'offset\.bias: must be .* -0.2 to 0.2 m, got'
    for value in (-0.1, 4.1, 'on'):
        yield {'range_wrap': {'strength': value}}, r'range_wrap\.strength: must be .* 0 to 4, got'


@pytest.mark.parametrize(('table', 'named'), list(bad_tables()))
def test_what_cannot_be_used_is_named(table: Any, named: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f'^effects: {named}'):
        parse_effects(table)
    with pytest.raises(InputError, match=f'^effects: {named}'):
        Camera(effects=table)
    path = tmp_path / 'bad.yaml'
    path.write_text(yaml.safe_dump({'schema': 1, 'effects': table}))
    with pytest.raises(InputError, match=f'bad.yaml: effects: {named}'):
        load_effects(path)


@pytest.mark.parametrize(
    'text',
    [
        '',
        'schema: 2\neffects: {}',
        'schema: 1',
        '- 1',
        'effects: {}',
        'schema: 1\neffects: [',
        'schema: 1\neffects: 5',
        'schema: 1\neffects: [offset]',
        '\x00',
    ],
)
def test_a_ruined_file_is_named(text: str, tmp_path: Path) -> None:
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    for use in (load_effects, lambda path: Camera(effects=path)):
        with pytest.raises(InputError, match=r'bad\.yaml'):
            use(path)
    with pytest.raises(InputError, match=r'missing\.yaml'):
        load_effects(tmp_path / 'missing.yaml')


@pytest.mark.parametrize('effects', [5, [5], ['offset'], None, [registry()['offset']]])
def test_what_is_no_effect_is_refused(effects: Any) -> None:
    with pytest.raises(InputError, match='^effects: must be'):
        Camera(effects=effects)


def test_numbers_are_made_floats() -> None:
    offset = registry()['offset']
    for number in (0, np.float32(0.0), np.int8(0)):
        effect = offset(bias=number)
        assert type(effect.bias) is float
        assert effect == offset(bias=0.0)
    assert isinstance(offset(), Effect)
