"""`flexx2 effects` and `flexx2 simulate --effects`: what they print, write and refuse."""

from pathlib import Path
import re

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli import effects_view
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import load_effects, parse_effects, registry, save_effects
from flexx2_sim_ros.effects.presets import markdown, preset_files
import numpy as np
import pytest

K = np.array([[52.0, 0.0, 27.5], [0.0, 53.0, 21.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def printed(monkeypatch, capsys):
    """Return what a command, which has to succeed, prints on a terminal of 80 columns."""
    monkeypatch.setenv('COLUMNS', '80')

    def run(*words):
        assert main(list(words)) == 0
        return capsys.readouterr().out

    return run


def test_the_table_of_parameters(printed):
    text = printed('effects')
    assert max(map(len, text.splitlines())) <= 80
    assert '…' not in text
    rows = [line.split() for line in text.splitlines()]
    for kind in registry().values():
        start = next(i for i, row in enumerate(rows) if row[:1] == [kind.name])
        assert rows[start][1] == kind.stage.name.lower()
        items = [item for item in kind.parameters() if item.name != 'strength']
        for offset, item in enumerate(items):
            numbers = f'{item.default:g} {item.low:g} to {item.high:g}'
            wanted = f'{item.name} {numbers} {item.unit}'.split()
            assert rows[start + offset][-len(wanted) :] == wanted


def test_the_table_of_sources(printed):
    text = printed('effects', '--sources')
    assert max(map(len, text.splitlines())) <= 80
    words = ' '.join(text.split())
    for kind in registry().values():
        assert f'{kind.name} {kind.title} {kind.source}' in words


def test_the_page_and_the_presets(printed, tmp_path):
    assert printed('effects', '--markdown') == markdown()
    folder = tmp_path / 'new' / 'effects'
    printed('effects', '--write-presets', str(folder))
    assert {path.name: path.read_text() for path in folder.iterdir()} == preset_files()


@pytest.mark.parametrize('name', ['pose_error', 'offset'])
def test_show_writes_a_picture(name, printed, tmp_path, monkeypatch):
    monkeypatch.setattr(effects_view, '_FRAMES', 9)
    monkeypatch.chdir(tmp_path)
    out = () if name == 'offset' else ('--out', 'picture')
    text = printed('effects', 'show', name, *out)
    path = Path(f'{name}.png' if name == 'offset' else 'picture')
    assert path.read_bytes().startswith(b'\x89PNG')
    kind = registry()[name]
    assert kind.title in ' '.join(text.split())
    assert all(re.search(rf'^{item.name} ', text, re.M) for item in kind.parameters())


def simulate(folder, *options, **arrays):
    """Run flexx2 simulate on a small scene and read what it wrote."""
    np.savez(folder / 'in.npz', clean_depth=np.full((43, 56), 1.5), K=K, **arrays)
    files = [f'{folder}/in.npz', f'{folder}/out.npz']
    assert main(['simulate', *files, '--frames', '70', *options]) == 0
    with np.load(folder / 'out.npz', allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def test_simulate_with_effects(tmp_path):
    path = tmp_path / 'mine.yaml'
    effects = parse_effects({'temporal_filter': None, 'warm_up_drift': {'tau': 1.0}})
    save_effects(path, effects)
    out = simulate(tmp_path, '--effects', str(path), '--usecase', 'Mode_5_30fps', '--seed', '7')
    camera = Camera('Mode_5_30fps', effects=effects, seed=7)
    wanted = camera.capture(np.full((43, 56), 1.5), K, out['stamp'])
    np.testing.assert_array_equal(out['depth'], wanted.depth)
    again = tmp_path / 'again.yaml'
    again.write_text(str(out['effects']))
    assert load_effects(again) == effects
    typical = simulate(tmp_path, '--effects', 'typical')
    assert 'multipath:' in str(typical['effects'])
    # What the scene was once recorded with is not what it is recorded with now.
    plain = simulate(tmp_path, effects='schema: 1')
    assert 'effects' not in plain
    assert not np.array_equal(plain['depth'], typical['depth'])


@pytest.mark.parametrize(
    ('words', 'named'),
    [
        (('effects', 'show', 'blur'), 'NAME: must be one of pose_error'),
        (('effects', 'show', 'offset', '--out', '{folder}/no/where.png'), 'cannot be written'),
        (('effects', '--write-presets', '{folder}/in.npz'), 'must be a folder, got a file'),
        (
            ('simulate', '{folder}/in.npz', '{folder}/out.npz', '--effects', '{folder}/bad.yaml'),
            'bad.yaml: effects: offset.bias: must be',
        ),
    ],
)
def test_what_cannot_be_used_is_named(words, named, tmp_path, capsys):
    np.savez(tmp_path / 'in.npz', clean_depth=np.full((43, 56), 1.5), K=K)
    (tmp_path / 'bad.yaml').write_text('schema: 1\neffects: {offset: {bias: 3}}')
    assert main([word.format(folder=tmp_path) for word in words]) == 2
    error = capsys.readouterr().err
    assert error.startswith('flexx2: error: ')
    assert named in error
    assert not (tmp_path / 'out.npz').exists()
