"""Effects of other packages: the example everywhere, and plug-ins that cannot be used."""

import json
import logging
import os
import re

from bench.gap_campaigns import write_campaign
from boards import K
from campaigns import leaving, SMALL
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.effects_profiles import DRAW_PROFILE
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import load_effects, loadable, parse_effects, registry
from flexx2_sim_ros.effects.picture import Picture, PROFILES
from flexx2_sim_ros.effects.presets import markdown
from flexx2_sim_ros.errors import InputError
import numpy as np
from plug_in_sites import EXAMPLE, install_example, on_path, write_metadata
from programs import run_python
import pytest

ROOT = EXAMPLE.parent
PERIOD = 33_333_333
CLEAN = np.full((48, 64), 1.5, np.float32)


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    """Return where the example is installed."""
    return install_example(tmp_path_factory.mktemp('site'))


@pytest.fixture
def example(site):
    """Let this process find the example."""
    with on_path(site):
        yield


def swing(amplitude, period, rows):
    """Return (rows, 1) metres."""
    return amplitude * np.sin(2 * np.pi / period * np.arange(rows))[:, None]


@pytest.mark.usefixtures('example')
def test_the_camera_files_and_texts_have_it(tmp_path, capsys):
    effect = {'row_banding': {'amplitude': 0.05, 'period': 12.0}}
    with_it, without = (
        Camera(effects=effects, seed=1).capture(CLEAN, K, np.arange(3) * PERIOD).depth
        for effects in (effect, ())
    )
    change = np.broadcast_to(swing(0.05, 12.0, 48), with_it.shape)
    np.testing.assert_allclose(with_it - without, change, atol=1e-5)
    assert load_effects('row_banding') == parse_effects({'row_banding': None})
    path = tmp_path / 'banding.yaml'
    path.write_text('schema: 1\neffects: {row_banding: {period: 9}}\n')
    assert load_effects(path)[0].period == 9
    assert '* `amplitude` = 0.002 m (-0.1 to 0.1): of the swing' in markdown()
    assert main(['effects', '--sources']) == 0
    assert 'row_banding' in capsys.readouterr().out
    picture = tmp_path / 'banding.png'
    assert main(['effects', 'show', 'row_banding', '--out', str(picture)]) == 0
    assert picture.read_bytes().startswith(b'\x89PNG')


@pytest.mark.usefixtures('example')
def test_the_batch_runs_it(caplog):
    effects = [{'row_banding': {'amplitude': 0.05}}, {'offset': None}]
    cameras = BatchCamera(2, 'Mode_5_30fps', effects=effects, K=K, device='cpu')
    alone = [Camera('Mode_5_30fps', effects=own, seed=i) for i, own in enumerate(effects)]
    for step in range(2):
        seen = cameras(np.stack([CLEAN, CLEAN]))
        for i, camera in enumerate(alone):
            wanted = camera.capture(CLEAN, K, step * PERIOD).depth
            np.testing.assert_allclose(seen[i], wanted, rtol=0, atol=2e-5)
    assert caplog.text.count('row_banding: no kernel, 1 environments') == 1


@pytest.mark.usefixtures('ros', 'example')
def test_a_running_node_switches_it():
    streams = pytest.importorskip('streams')
    values = {'amplitude': 0.05, 'strength': 1.0}
    with streams.stream(streams.DEPTH) as seen:
        assert seen.set(**{f'effect.row_banding.{k}': v for k, v in values.items()}).successful
        refused = seen.set(**{'effect.row_banding.strength': 9.0})
        assert not refused.successful
        assert 'effect.row_banding.strength' in refused.reason
        clean = np.full((172, 224), 1.5, np.float32)
        assert seen.show(clean, streams.START)
        settings, matrix = seen.camera.settings, streams.FLEXX2.matrix
        camera = Camera(
            settings.usecase,
            effects={'row_banding': values},
            seed=settings.seed,
            name=settings.camera_name,
        )
        stamp = streams.nanoseconds(seen.messages(streams.DEPTH)[-1])
        wanted = camera.capture(clean, matrix, stamp).depth
        np.testing.assert_array_equal(seen.depths()[-1], wanted)


@pytest.mark.usefixtures('example')
def test_the_diagnosis_finds_it(tmp_path):
    campaign, out = tmp_path / 'campaign', tmp_path / 'out'
    write_campaign(campaign, seed=6, effects={'row_banding': {'amplitude': 0.002}}, **SMALL)
    # Of the plug-in's effect alone: all others are left out by name.
    options = leaving('row_banding', 'fixed_pattern', 'pose_error')
    words = ['gap', 'diagnose', str(campaign), '--out', str(out), '--jobs', '1', *options]
    assert main(words) == 0
    table = json.loads((out / 'diagnosis.json').read_text())
    assert table['verdict'] == 'identified'
    first = table['effects'][0]
    assert first['name'] == 'row_banding'
    assert first['parameters']['amplitude'] == pytest.approx(0.002, abs=4e-4)
    assert first['parameters']['period'] == 24.0
    assert load_effects(out / 'effects.yaml')[0].name == 'row_banding'


_HEAD = """
from dataclasses import dataclass
from typing import ClassVar
from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid
from flexx2_sim_ros.physics.frame_state import Stage
import numpy as np

@dataclass(frozen=True)
class Good(Effect):
    name: ClassVar[str] = 'good'
    stage: ClassVar[Stage] = Stage.FILTER
    title: ClassVar[str] = 'a step [/dim] [bold'
    covariate: ClassVar[str] = 'none'
    changes: ClassVar[tuple] = ('bias',)
    source: ClassVar[str] = 'a test'

    step: float = parameter(0.5, 0.0, 1.0, 'm', 'added')

    def apply(self, state):
        state.measured = state.measured + np.float64(self.step * self.strength)
"""
_CLASS = '@dataclass(frozen=True)\nclass Bad(Good):\n    name: ClassVar[str] = "bad"\n    '
# What a plug-in's module says after the head, and what is said about it.
BAD = {
    'raises': ('raise RuntimeError("on import")', 'RuntimeError: on import'),
    'leaves': ('import sys; sys.exit(3)', 'SystemExit: 3'),
    'ruined': ('def', 'SyntaxError'),
    'lacks': ('', "AttributeError: module 'lacks' has no attribute 'Bad'"),
    'number': ('Bad = 7', 'must be a subclass of Effect, got 7'),
    'plain': ('class Bad(Good):\n    name = "bad"', 'must be a frozen dataclass'),
    'taken': (_CLASS + 'name: ClassVar[str] = "offset"', 'name: must be one that is not taken'),
    'unnamed': (
        _CLASS + 'name: ClassVar[str] = "Row\\n\\x1b[31mbanding"',
        r"name: must be an identifier in lower case, got 'Row\n\x1b[31mbanding'",
    ),
    'staged': (_CLASS + 'stage: ClassVar[int] = 3', 'stage: must be a Stage, got 3'),
    'channel': (_CLASS + 'changes: ClassVar[tuple] = ("smell",)', 'changes: must be some of bias'),
    'texts': (_CLASS + 'title: ClassVar[str] = "two\\nlines"', 'title: must be a text'),
    'stream': (_CLASS + 'stream: ClassVar[int] = 0', 'stream: must be left to be derived'),
    'role': (_CLASS + 'role: ClassVar[str] = "pose"', "role: must be empty, got 'pose'"),
    'default': (
        _CLASS + 'step: float = parameter(2.0, 0.0, 1.0, "m", "added")',
        'bad.step: must be a number from 0 to 1 m, got 2.0',
    ),
    'bare': (_CLASS + 'more: float = 1.0', 'more: must be made by parameter(...)'),
    'strong': (
        _CLASS + 'strength: float = parameter(1.0, 0.0, 9.0, "", "more")',
        'strength: must be left as it is',
    ),
    'grid': (
        _CLASS + 'hypotheses: ClassVar[tuple] = (grid("steps", (1.0,), 0.0, 2.0),)',
        'bad.steps: must be one of',
    ),
    'throws': (
        _CLASS + 'def apply(self, state):\n        raise ValueError("no")',
        'ValueError: no',
    ),
    'exits': (_CLASS + 'def apply(self, state):\n        raise SystemExit', 'SystemExit'),
    'early': (_CLASS + 'stage: ClassVar[Stage] = Stage.PHASOR', 'TypeError'),
    'shape': (
        _CLASS + 'def apply(self, state):\n        state.measured = state.measured[1:]',
        'measured: must have shape (12, 16), got (11, 16)',
    ),
    'shifts': (
        _CLASS + 'def apply(self, state):\n        state.shifts = []',
        'shifts: must be 2 images, got 0',
    ),
    'endless': (
        _CLASS + 'def apply(self, state):\n        raise ValueError("x" * 100_000)',
        'ValueError: ' + 'x' * 50,
    ),
}


@pytest.fixture(scope='module')
def bad_site(tmp_path_factory):
    """Return where plug-ins are installed that cannot be used, and one good one."""
    site = tmp_path_factory.mktemp('bad')
    for name, (text, _) in BAD.items():
        (site / f'{name}.py').write_text(_HEAD + text + '\n')
    (site / 'good.py').write_text(_HEAD)
    points = {name: f'{name}:Bad' for name in BAD}
    write_metadata(site, 'bad', **points, missing='nowhere:Bad', good='good:Good', odd='a b c')
    ruined = write_metadata(site, 'ruined-metadata')
    (ruined / 'entry_points.txt').write_text('[flexx2_sim_ros.effects]\nno equals sign\n')
    return site


def test_what_cannot_be_used_is_named_and_left_out(bad_site, caplog):
    before = list(registry())
    with on_path(bad_site):
        assert set(registry()) == {*before, 'good'}
        registry()  # says nothing again
        seen = Camera(effects={'good': None}, seed=1).capture(CLEAN, K, 0).depth
    plain = Camera(seed=1).capture(CLEAN, K, 0).depth
    np.testing.assert_allclose(seen, plain + 0.5, atol=1e-5)
    assert seen.dtype == np.float32
    lines = [record.getMessage() for record in caplog.records]
    for name, (_, said) in {**BAD, 'missing': ('', 'ModuleNotFoundError')}.items():
        (line,) = [one for one in lines if f'plug-in {name} is left out' in one]
        assert said in line
    assert sum('ruined_metadata' in line for line in lines) == 1
    assert len(lines) == len(BAD) + 3
    assert all(line.isprintable() and len(line) < 400 for line in lines)


def test_the_command_line_works_beside_broken_plug_ins(bad_site):
    start = 'from flexx2_sim_ros.cli.main import main; raise SystemExit(main())'
    path = {'PYTHONPATH': f'{bad_site}{os.pathsep}{ROOT}', 'COLUMNS': '200'}
    done = run_python('-c', start, 'effects', '--sources', env={**os.environ, **path})
    assert done.returncode == 0
    assert '[/dim] [bold' in done.stdout
    assert 'wiggling' in done.stdout
    assert 'good' in done.stdout
    assert len(done.stderr.splitlines()) == len(BAD) + 3
    assert 'Traceback' not in done.stderr


_LATE = """
    def apply(self, state):
        frames = state.memory.kept.setdefault(self.name, [])
        frames.append(0)
        state.measured[:] = 9.0
        if len(frames) > 2:
            raise RuntimeError('tired')
"""


def test_a_plug_in_that_fails_later_is_reported_once_and_switched_off(tmp_path, caplog):
    (tmp_path / 'late.py').write_text(_HEAD.replace("'good'", "'late'") + _LATE)
    write_metadata(tmp_path, 'late', late='late:Good')
    with on_path(tmp_path), caplog.at_level(logging.WARNING):
        stamps = np.arange(5) * PERIOD
        camera = Camera('Mode_5_30fps', effects={'late': None, 'temporal_filter': None})
        seen = camera.capture(np.full((8, 9), 1.5), K, stamps).depth
        usual = Camera('Mode_5_30fps', effects={'temporal_filter': None})
    wanted = usual.capture(np.full((8, 9), 1.5), K, stamps).depth
    assert not np.isclose(seen[0], wanted[0], equal_nan=True).all()
    np.testing.assert_allclose(seen[4], wanted[4], atol=0.05)
    assert [record.getMessage() for record in caplog.records] == [
        'effects: plug-in late is left out: RuntimeError: tired'
    ]


def test_no_module_but_its_own_names_an_effect():
    """
    Assert it of strings.

    Kernels of the batch are launched for the effects that they compute. Ground truth names the
    effects that it fits or takes away, and free forms the effects that they belong to.
    """
    apart = 'batch/', 'truth/', 'gap/forms/'
    # The offset of a plane is no effect.
    own = {'patch.py': 'residual_patch', 'ray.py': 'along_ray', 'words.py': 'offset'}
    package = ROOT / 'flexx2_sim_ros'
    name = re.compile(f"""['"]({'|'.join(loadable())})['":.]""")
    for path in sorted(package.rglob('*.py')):
        place = path.relative_to(package).as_posix()
        if not place.startswith(apart):
            found = set(name.findall(path.read_text()))
            assert found <= {path.stem, own.get(path.name)}, place


def test_counts_in_the_documents():
    count = len(registry())
    said = []
    for page in (ROOT / 'README.md', ROOT / 'docs' / 'nodes.md', ROOT / 'docs' / 'effects.md'):
        said += re.findall(r'(\d+) (?:effects \(|(?:effects of|things) a real)', page.read_text())
    assert len(said) >= 3
    assert set(map(int, said)) == {count}
    kernels = sum(kind.batched is not None for kind in registry().values())
    batch = (ROOT / 'docs' / 'batch.md').read_text()
    said_there = f'All {count}' if kernels == count else f'{kernels} of the {count}'
    assert f'{said_there} effects run in kernels' in batch


def test_every_kind_of_picture_can_be_drawn():
    assert set(DRAW_PROFILE) == set(PROFILES)
    with pytest.raises(InputError, match='picture.profile: must be one of covariate, .* got'):
        Picture('oil on canvas')


def test_random_numbers_are_each_effects_own():
    streams = [kind.stream for kind in loadable().values()]
    assert len(set(streams)) == len(streams)
    assert {name: registry()[name].stream for name in ('fixed_pattern', 'saturation')} == {
        'fixed_pattern': 3,
        'saturation': 8,
    }
    # The same on every machine, for ever.
    assert registry()['offset'].stream == 1894100510
