"""What a gap costs in what reads depth on a robot, from files to files; and bad consumers."""

from html import unescape
import json
from pathlib import Path
import re
import shlex

from bench.gap_campaigns import write_campaign
from campaigns import leaving, run_diagnose, save, write_diagnosis
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.consumers.comparison import compare
from flexx2_sim_ros.consumers.loading import load, sources
from flexx2_sim_ros.consumers.running import Result
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import cost
from flexx2_sim_ros.gap.cost import compared
from flexx2_sim_ros.gap.data.campaign import check as check_recording
from flexx2_sim_ros.gap.data.campaign import read
from flexx2_sim_ros.gap.report.cost_page import headline, sentences
from flexx2_sim_ros.recording import load_recording
import numpy as np
from plug_in_sites import on_path, write_metadata
import pytest

DOCS = Path(__file__).resolve().parents[1] / 'docs' / 'robots.md'
EFFECTS = {'low_signal_dropout': {}, 'offset': {'bias': 0.05}}
SETTINGS = {'pose_prior': [0.002, 0.125]}
SIZE = {'seed': 104, 'recordings': 3, 'frames': 3, 'scale': 0.35, 'moving': 1}
BAD = """
import os
import time

import numpy as np


class Text(str):
    pass


class Good:
    '''Counts depths.'''

    name = Text('good')
    measures = {Text('missing'): Text('%')}

    def look(self, view):
        print('a consumer may print')
        os.write(1, b'and so may a library in C')
        return sum(len(view.points(t)) for t in range(len(view.depth)))

    def errors(self, seen, true):
        return {'missing': 100 * (1 - seen / true)}


class Raises(Good):
    name = 'raises'

    def look(self, view):
        raise RuntimeError('no \\x1b[31m map')


class NotANumber(Good):
    name = 'not_a_number'

    def errors(self, seen, true):
        return {'missing': float('nan')}


class NoPicture(Good):
    name = 'no_picture'

    def picture(self, seen, true):
        return np.zeros((0, 5))


class Slow(Good):
    name = 'slow'

    def look(self, view):
        time.sleep(1000)


class Ends(Good):
    name = 'ends'

    def look(self, view):
        os._exit(3)


class Nameless:
    pass
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with recordings, a diagnosis, and consumers in files."""
    folder = tmp_path_factory.mktemp('cost')
    write_campaign(folder / 'recordings', effects=EFFECTS, **SIZE)
    write_diagnosis(folder / 'diagnosis', EFFECTS, SETTINGS)
    code = re.search(r'```python\n(.*?)```', DOCS.read_text(), re.S)
    (folder / 'my.py').write_text(code[1])
    (folder / 'bad.py').write_text(BAD)
    return folder


@pytest.mark.parametrize('number', [0, 1])
def test_the_commands_of_the_documentation_run(number, folder, monkeypatch, capsys):
    pytest.importorskip('pyoctomap')
    monkeypatch.chdir(folder)
    command = re.findall(r'```bash\n(.*?)\n```', DOCS.read_text(), re.S)[number]
    assert main([*shlex.split(command)[1:], '--jobs', '1']) == 0
    said = capsys.readouterr().err
    assert 'takes away' in said
    table = json.loads((folder / 'cost' / 'cost.json').read_text())
    named = {row['name']: row for row in table['consumers']}
    built_in = {'height_grid', 'elevation_map', 'occupancy_map', 'nearest_obstacle'}
    assert set(named) == (built_in if number == 0 else {'highest', 'height_grid'})
    assert table['faults'] == []
    assert [row['effects_from'] for row in table['recordings']] == ['other recordings'] * 3
    # The camera measures 5 cm too far: the ground seems low, and the offset explains it.
    name = 'elevation_map' if number == 0 else 'highest'
    (height,) = (one for one in named[name]['measures'] if one['name'] == 'height_error')
    assert height['significant']
    assert height['real'] > height['simulated']
    assert height['effects']['offset']['share'] > 0.5
    assert height['all_effects']['share'] > 0.5
    assert height['effects']['low_signal_dropout']['share'] < 0.5
    low, high = height['effects']['offset']['interval']
    assert low <= height['effects']['offset']['share'] <= high
    page = (folder / 'cost' / 'cost.html').read_text()
    assert 'Modelling' in page
    assert page.count('data:image/png') >= 3  # recorded, as simulated, with all effects


def test_the_report_of_a_diagnosis_has_the_cost(tmp_path, capsys):
    recordings = tmp_path / 'recordings'
    write_campaign(recordings, effects={**EFFECTS, 'offset': {'bias': 0.02}}, **SIZE)
    table = run_diagnose(recordings, tmp_path / 'out', '--cost', *leaving(*EFFECTS))['cost']
    assert 'Modelling offset' in capsys.readouterr().err.replace('\n', ' ')
    assert [row['effect'] for row in table['ranking']][0] == 'offset'
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert 'What the gap costs a robot' in page
    assert headline(table) in unescape(page)


def test_a_diagnosis_without_effects_says_why_it_has_no_cost(tmp_path, capsys):
    write_campaign(tmp_path / 'same', seed=104, recordings=2, frames=4, scale=0.25)
    run_diagnose(tmp_path / 'same', tmp_path / 'out', '--cost', *leaving())
    assert 'No cost: no effect that changes images is named.' in capsys.readouterr().err


def test_a_consumer_that_fails_is_named_and_the_rest_goes_on(folder, tmp_path, capfd):
    names = ['Raises', 'NotANumber', 'NoPicture', 'Slow', 'Ends', 'Good']
    options = [f'--consumer={folder}/bad.py:{name}' for name in names]
    command = ['gap', 'cost', str(folder / 'recordings'), '--diagnosis', str(folder / 'diagnosis')]
    command += ['--out', str(tmp_path), '--json', '--limit', '5', '--jobs', '2', *options]
    assert main(command) == 0
    table = json.loads(capfd.readouterr().out)  # what a consumer prints is not in it
    assert [row['name'] for row in table['consumers']] == ['good']
    reasons = {row['consumer'].rpartition(':')[2]: row['reason'] for row in table['faults']}
    assert 'RuntimeError: no \\x1b[31m map' in reasons['raises']
    assert 'missing (real): must be a finite number below 1e+100' in reasons['not_a_number']
    assert 'picture: must be (h, w)' in reasons['no_picture']
    assert 'took longer than 5 s' in reasons['slow']
    assert 'ended its process' in reasons['ends']


@pytest.mark.parametrize(
    ('name', 'said'), [('Nameless', 'name: must be an identifier'), ('Absent', 'must have Absent')]
)
def test_a_class_that_is_no_consumer_is_refused(folder, name, said):
    (source,) = sources([f'{folder}/bad.py:{name}'], lambda name, error: None)
    with pytest.raises(InputError, match=said):
        load(source)


def test_effects_fitted_without_a_recording_are_used_for_it(folder, tmp_path):
    # The effects of the diagnosis do nothing; those fitted without each recording are right.
    rows = []
    for path in sorted((folder / 'recordings').iterdir()):
        checksum = read(check_recording(path, None), None).checksum
        row = {'name': path.name, 'used': True, 'checksum': checksum}
        rows.append({**row, 'effects_without': EFFECTS})
    del rows[2]['effects_without']
    off = {name: {'strength': 0.0} for name in EFFECTS}
    write_diagnosis(tmp_path / 'diagnosis', off, SETTINGS, recordings=rows)
    table = cost(folder / 'recordings', tmp_path / 'diagnosis', consumers=['height_grid'])
    origin = [row['effects_from'] for row in table['recordings']]
    assert origin == ['other recordings', 'other recordings', 'this recording']
    (height,) = (one for one in table['consumers'][0]['measures'] if one['name'] == 'height_error')
    assert 0.2 < height['effects']['offset']['share'] < 1


def test_recordings_without_ground_need_the_mounting(folder, tmp_path):
    one = load_recording(folder / 'recordings' / 'scene_00.npz')
    shape = one.depth.shape[1:]
    (tmp_path / 'walls').mkdir()
    for name in ('near', 'far'):
        depth, clean = np.full((3, *shape), 1.52, 'f4'), np.full(shape, 1.5, 'f4')
        save(tmp_path / 'walls' / f'{name}.npz', depth, clean, one.K)
    arguments = tmp_path / 'walls', folder / 'diagnosis'
    with pytest.raises(InputError, match='must show the ground') as refused:
        cost(*arguments, consumers=['nearest_obstacle'])
    assert str(refused.value).endswith('(the same for 1 more)')
    table = cost(*arguments, consumers=['nearest_obstacle'], mounting=(0.5, 0.0))
    assert table['settings']['mounting'] == [0.5, 0.0]


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--consumer', 'radar'], 'consumer: must be'),
        (['--consumer', 'none.py:Grid'], 'must be a Python file that exists'),
        (['--mounting', '-1', '0'], 'mounting: must be metres above 0'),
        (['--mounting', '1', '89'], 'degrees from -80 to 80'),
    ],
)
def test_wrong_options_are_refused(options, said, folder, tmp_path, capsys):
    command = ['gap', 'cost', str(folder / 'recordings'), '--diagnosis', str(folder / 'diagnosis')]
    assert main([*command, '--out', str(tmp_path / 'out'), *options]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_other_packages_offer_consumers(folder, tmp_path):
    (tmp_path / 'their_map.py').write_text((folder / 'my.py').read_text())
    group = 'flexx2_sim_ros.consumers'
    write_metadata(tmp_path, 'their-map', group, highest='their_map:Grid')
    write_metadata(tmp_path, 'broken-map', group, broken='not_there:Grid')
    with on_path(tmp_path):
        known = {one.label: one for one in sources([], lambda name, error: None)}
        assert load(known['highest']).name == 'highest'
        with pytest.raises(ModuleNotFoundError):
            load(known['broken'])


def test_effects_that_recordings_cannot_order_are_said():
    # Five recordings show one effect, three the other; both together change as much everywhere.
    errors = []
    for k in range(8):
        row = {'real': 10.0, 'simulated': 0.0, 'again': 0.1, 'all effects': 10.0}
        row |= {'first': 9.0 * (k < 5), 'second': 9.0 * (k >= 5), 'weak': 1.5}
        errors.append({name: {'steps': value} for name, value in row.items()})
    results = [Result('grid', '', {'steps': ''}, errors)]
    table = {
        'effects': {},
        **compared(results, ['weak', 'second', 'first']),
        'recordings': [{'used': True, 'effects_from': ''}] * 8,
        'damaged_packages': [],
        'settings': {'delay': 0.0},
    }
    first, second, weak = table['ranking']
    assert (first['effect'], second['effect'], weak['effect']) == ('first', 'second', 'weak')
    assert first['ahead_of'] == ['weak']
    assert second['ahead_of'] == []
    assert 'Modelling first takes away' in headline(table)
    assert headline(table).endswith('These recordings cannot order first and second.')
    assert 'These recordings cannot order second and weak.' in sentences(table)
    late = {**table, 'settings': {'delay': 0.071}}
    assert any('delay of the images, 71 ms, is not in the cost' in one for one in sentences(late))
    clear = compared(results, ['weak', 'first'])['ranking']
    assert 'cannot order' not in headline({**table, 'ranking': clear})


def test_shares_and_their_intervals():
    rows = []
    for real in np.random.default_rng(0).uniform(8, 12, 20):
        row = {'real': real, 'simulated': 0.0, 'again': 0.1}
        row |= {'a': 0.7 * real, 'b': -0.5 * real, 'all effects': 0.5 * real}
        rows.append({name: {'steps': value} for name, value in row.items()})
    one = compare(rows, 'steps', ['a', 'b'])
    assert one.significant
    assert one.null == pytest.approx(0.1)
    assert one.effects['a'].share == pytest.approx(0.7)
    assert one.effects['b'].share == pytest.approx(-0.5)
    assert one.effects['a'].interval == pytest.approx((0.7, 0.7))
    # Both move by 0.5 together: a alone by 0.7, b by 0.5 the other way.
    assert [one.effects[name].part for name in ('a', 'b')] == pytest.approx([0.6, -1.0])
    assert one.all_effects.part == pytest.approx(1.0)
    few = compare(rows[:2], 'steps', ['a'])
    assert few.interval is None
    assert not few.significant
    assert compare(rows, 'holes', ['a']) is None
    # Nothing but noise is not significant.
    same = [{**row, 'real': {'steps': 0.1 * (-1) ** k}} for k, row in enumerate(rows)]
    noise = compare(same, 'steps', ['a'])
    assert not noise.significant
