"""Cameras drawn from what a diagnosis knows: the file, the draws, and those who draw."""

from contextlib import contextmanager
import json
from pathlib import Path
import re
import shlex

from boards import K
from campaigns import write_diagnosis
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import (
    load_effects,
    load_randomisation,
    parse_effects,
    save_randomisation,
)
from flexx2_sim_ros.effects.time_offset import time_offset_of
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import randomise
from flexx2_sim_ros.recording import load_recording
import numpy as np
import pytest
from scipy import stats
import yaml

DOCS = Path(__file__).resolve().parents[1] / 'docs' / 'robots.md'
CLEAN = np.linspace(1.0, 1.6, 48 * 64, dtype=np.float32).reshape(48, 64)
NORMAL = {'mean': 0.01, 'sd': 0.002, 'low': -0.2, 'high': 0.2}
DRAWN = {
    'effects': {
        'offset': {'parameters': {'bias': NORMAL}},
        'heavy_tails': {'probability': 0.4, 'parameters': {'share': 0.02}},
        'excess_noise': {
            'parameters': {'factor': {'mean': 1.2, 'sd': 0.05, 'low': 0.5, 'high': 4.0}}
        },
        'low_signal_dropout': {'parameters': {'strength': {'low': 0.5, 'high': 1.5}}},
    },
    'correlations': [['excess_noise.factor', 'offset.bias', -0.8]],
}


@contextmanager
def changed(folder):
    """Change the table of a diagnosis."""
    path = folder / 'diagnosis.json'
    table = json.loads(path.read_text())
    yield table
    path.write_text(json.dumps(table))


def write(path, table):
    """Write a file of distributions."""
    path.write_text(yaml.safe_dump({'schema': 1, 'randomisation': table}))
    return path


def bias_of(distribution):
    """Return the table of an offset whose bias is drawn."""
    return {'effects': {'offset': {'parameters': {'bias': distribution}}}}


def correlated(*correlation):
    """Return the usual table with another correlation."""
    return {**DRAWN, 'correlations': [list(correlation)]}


def test_draws_have_the_distributions_of_the_file(tmp_path):
    one = load_randomisation(write(tmp_path / 'r.yaml', DRAWN))
    save_randomisation(tmp_path / 'again.yaml', one, 'a comment')
    again = load_randomisation(tmp_path / 'again.yaml')
    assert again.plain() == one.plain()
    values, on = one.values(4000, seed=3)
    names = [item.name for item in one.distributions]
    bias, factor, strength = (
        values[:, names.index(name)]
        for name in ('offset.bias', 'excess_noise.factor', 'low_signal_dropout.strength')
    )
    # Six standard errors: false failures below 1e-8 each.
    assert abs(bias.mean() - 0.01) < 6 * 0.002 / 4000**0.5
    assert abs(bias.std() / 0.002 - 1) < 6 / 8000**0.5
    assert abs(np.corrcoef(bias, factor)[0, 1] + 0.8) < 6 * 0.36 / 4000**0.5
    assert 0.5 <= strength.min() < 0.51 < 1.49 < strength.max() <= 1.5
    order = [effect.name for effect in one.effects]
    assert abs(on[:, order.index('heavy_tails')].mean() - 0.4) < 6 * 0.49 / 4000**0.5
    assert on[:, order.index('offset')].all()
    np.testing.assert_array_equal(one.values(10, seed=3)[0], values[:10])


@pytest.mark.parametrize(
    ('table', 'said'),
    [
        ({'effects': {'radar': {}}}, 'radar: must be an effect'),
        ({'effects': {'offset': {'probability': 2}}}, 'probability: must be a number from 0 to 1'),
        (bias_of({'low': 0}), 'must have low and high'),
        (bias_of({'low': 0.1, 'high': 0.0}), 'low: must be below high'),
        (bias_of({'low': 0.0, 'high': 99.0}), 'offset.bias: must be a number'),
        (bias_of({**NORMAL, 'sd': 10**400}), 'sd: must be a number'),
        ({'effects': {'offset': {'parameters': {'gain': 1}}}}, 'gain: must be one of'),
        (correlated('a', 'b', 0.1), 'correlations: must be two parameters'),
        (correlated(['a'], 'b', 0.1), 'correlations: must be two parameters'),
        (correlated('offset.bias', 'excess_noise.factor', 1.5), 'must be a number from -1 to 1'),
        ({**DRAWN, 'correlation': []}, 'must be a table of effects and correlations'),
    ],
)
def test_wrong_files_are_refused(table, said, tmp_path):
    with pytest.raises(InputError, match=said):
        load_randomisation(write(tmp_path / 'wrong.yaml', table))


def test_a_file_of_distributions_needs_a_seed(tmp_path):
    path = write(tmp_path / 'r.yaml', DRAWN)
    with pytest.raises(InputError, match=r'r.yaml#7'):
        load_effects(path)
    drawn = load_effects(f'{path}#7')
    assert drawn == load_randomisation(path).draw(1, 7)[0] != load_effects(f'{path}#8')
    # The node's parameter `effects` and `Camera` take the same text.
    assert Camera(effects=f'{path}#7').effects == drawn
    with pytest.raises(InputError, match='got no such file'):
        load_effects(f'{"a" * 300}#7')


def diagnosed(folder, rows, effects):
    """Write a diagnosis whose fits without each recording scatter."""
    rng = np.random.default_rng(1)
    recordings = []
    for k in range(rows):
        wrong = rng.standard_normal()
        own = {
            'offset': {'bias': 0.02 + 0.001 * wrong},
            'excess_noise': {'factor': 1.5 - 0.01 * wrong + 0.003 * rng.standard_normal()},
        }
        recordings.append(
            {'name': f'{k}.npz', 'used': True, 'checksum': str(k), 'effects_without': own}
        )
    known = {'known': {'temporal_filter': {'share': 0.3}}}
    hidden = [{'name': 'wiggling', 'absorbed': 0.9, 'settled_by': []}]
    return write_diagnosis(
        folder, effects, known, verdict='partly', recordings=recordings, not_decidable=hidden
    )


FITTED = {'offset': {'bias': 0.02}, 'excess_noise': {'factor': 1.5}}


def test_distributions_are_those_of_the_diagnosis(tmp_path):
    folder = diagnosed(tmp_path / 'diagnosis', 8, FITTED)
    found = randomise(folder, tmp_path / 'r.yaml')
    assert found.named == ('offset', 'excess_noise')
    assert found.undecided == ('wiggling',)
    one = load_randomisation(tmp_path / 'r.yaml')
    sure = dict.fromkeys(('offset', 'excess_noise', 'temporal_filter'), 1.0)
    assert one.probabilities == {**sure, 'wiggling': 0.5}
    by_name = {item.name: item for item in one.distributions}
    assert set(by_name) == {'offset.bias', 'excess_noise.factor', 'wiggling.strength'}
    # The jackknife's standard error, with the tails of Student's t for 8 recordings, and 10 % that
    # all recordings share.
    rows = json.loads((folder / 'diagnosis.json').read_text())['recordings']
    biases = np.array([row['effects_without']['offset']['bias'] for row in rows])
    error = np.sqrt(7 / 8 * ((biases - biases.mean()) ** 2).sum())
    wide = stats.t.ppf(0.95, 7) / stats.norm.ppf(0.95)
    assert by_name['offset.bias'].mean == 0.02
    assert by_name['offset.bias'].sd == pytest.approx(np.hypot(wide * error, 0.1 * 0.02))
    i, j = (list(by_name).index(name) for name in ('offset.bias', 'excess_noise.factor'))
    assert -0.8 < one.correlation[i, j] < 0
    assert found.narrower['offset.bias'] > 1
    (given,) = (effect for effect in one.effects if effect.name == 'temporal_filter')
    assert given.settings['share'] == 0.3


def test_curves_and_maps_that_are_taken_as_given_are_written(tmp_path):
    folder = diagnosed(tmp_path / 'diagnosis', 8, FITTED)
    known = {
        'fixed_pattern': {'pattern': [[0.0, 0.01], [0.02, 0.0]]},
        'amplitude_bias': {'curve': {'knots': [1.0, 9.0], 'values': [0.0, 0.01]}},
    }
    with changed(folder) as table:
        table['settings'] = {'known': known}
    randomise(folder, tmp_path / 'r.yaml')
    (drawn,) = load_randomisation(tmp_path / 'r.yaml').draw(1, 1)
    assert {*parse_effects(known)} <= {*drawn}
    # Neither the map of another file nor anything else is written over.
    with changed(folder) as table:
        table['settings']['known']['fixed_pattern']['pattern'] = [[0.1, 0.0], [0.0, 0.0]]
    randomise(folder, tmp_path / 'other.yaml')
    assert load_randomisation(tmp_path / 'r.yaml').draw(1, 1)[0] == drawn
    np.savez(tmp_path / 'again_fixed_pattern.npz', depth=np.ones((2, 3, 4)))
    with pytest.raises(InputError, match=r'fixed_pattern\.npz: must be free for the map'):
        randomise(folder, tmp_path / 'again.yaml')


def with_age(folder, age, undecided='wiggling'):
    """Add the age of images to a diagnosis, and what it could not decide."""
    with changed(folder) as table:
        table['age'] = age
        table['not_decidable'] = [{'name': undecided, 'absorbed': 0.9, 'settled_by': []}]
    return folder


def test_cameras_are_as_late_as_the_frames_were(tmp_path):
    age = {'latency': 0.0, 'delay': {'median': 0.08, 'low': 0.06, 'high': 0.1}}
    folder = with_age(diagnosed(tmp_path / 'diagnosis', 8, FITTED), age, 'time_offset')
    found = randomise(folder).randomisation
    late = [time_offset_of(own) for own in found.draw(2000, 1)]
    delays = np.array([one.delay_ns for one in late]) / 1e9
    # The standard error of a quantile is 0.6 ms: six of them.
    assert np.quantile(delays, [0.05, 0.5, 0.95]) == pytest.approx([0.06, 0.08, 0.1], abs=0.004)
    # The latency, which is not known, does not change the delay.
    latencies = np.array([one.latency_ns for one in late]) / 1e9
    assert np.abs(latencies).max() <= 0.04
    assert latencies.std() > 0.02


@pytest.mark.parametrize('decided', [True, False])
def test_a_delay_that_is_taken_as_given_stays_beside_a_latency(decided, tmp_path):
    named = {'time_offset': {'latency': 0.05}}
    folder = diagnosed(tmp_path / 'diagnosis', 8, named if decided else FITTED)
    with changed(folder) as table:
        table['settings']['known'] = {'time_offset': {'latency': 0.0, 'delay': 0.04}}
        for k, row in enumerate(table['recordings']):
            row['effects_without'] |= {'time_offset': {'latency': 0.05 + 0.001 * k}}
        table['not_decidable'] = [] if decided else [{'name': 'time_offset', 'absorbed': 0.9}]
    found = randomise(folder)
    assert ('time_offset' in found.named) == decided
    assert ('time_offset' in found.undecided) == (not decided)
    late = [time_offset_of(own) for own in found.randomisation.draw(200, 1)]
    assert {one.delay_ns for one in late} == {40_000_000}
    assert np.std([one.latency_ns for one in late]) > 1e6


@pytest.mark.parametrize(
    'age', [3, {}, {'delay': [1]}, {'delay': {'median': 0.1, 'low': 0.2, 'high': 0.3}}]
)
def test_an_age_that_no_diagnosis_writes_is_refused(age, tmp_path):
    folder = with_age(diagnosed(tmp_path / 'diagnosis', 8, FITTED), age)
    with pytest.raises(InputError, match='diagnosis.json: age'):
        randomise(folder)


def test_a_file_is_written_over_only_by_force(tmp_path, capsys):
    out = tmp_path / 'mine.yaml'
    out.write_text('mine')
    folder = diagnosed(tmp_path / 'diagnosis', 3, {'offset': {'bias': 0.01}})
    command = ['gap', 'randomise', str(folder), '--out', str(out)]
    assert main(command) == 2
    assert out.read_text() == 'mine'
    assert '--force' in capsys.readouterr().err
    assert main([*command, '--force']) == 0
    assert out.read_text() != 'mine'


def test_the_documentation_runs(tmp_path, monkeypatch):
    text = DOCS.read_text().split('## Random cameras for training')[1].split('\n## ')[0]
    monkeypatch.chdir(tmp_path)
    diagnosed(tmp_path / 'diagnosis', 4, FITTED)
    np.savez(tmp_path / 'scene.npz', clean_depth=CLEAN, K=K)
    (block,) = re.findall(r'```bash\n(.*?)```', text, re.S)
    first, second = block.strip().splitlines()
    assert main(shlex.split(first)[1:]) == 0
    simulate = [*shlex.split(second)[1:], '--frames', '2']
    for seed, name in (('7', 'a'), ('7', 'b'), ('8', 'c')):
        draw = [f'{name}.npz' if word == 'out.npz' else word for word in simulate]
        draw[draw.index('--draw') + 1] = seed
        assert main(draw) == 0
    a, b, c = (load_recording(tmp_path / f'{name}.npz') for name in 'abc')
    np.testing.assert_array_equal(a.depth, b.depth)
    assert not np.array_equal(a.depth, c.depth, equal_nan=True)
    assert str(a.extra['effects']) != str(c.extra['effects'])
    assert main(['simulate', 'scene.npz', 'd.npz', '--draw', '7']) == 2  # without --effects
    (code,) = re.findall(r'```python\n(.*?)```', text, re.S)
    names = {}
    exec(code, names)  # noqa: S102 - the documentation's own
    assert {effect.name for effect in names['effects']} >= {'offset', 'excess_noise'}
    (file,) = re.findall(r'```yaml\n(.*?)```', text, re.S)
    (tmp_path / 'own.yaml').write_text(file)
    assert len(load_randomisation(tmp_path / 'own.yaml').distributions) == 2


@pytest.mark.parametrize(
    ('rows', 'effects', 'said'),
    [
        (2, FITTED, 'from at least 3 recordings'),
        (8, {'offset': {'curve': {'knots': [1.0, 2.0], 'values': [0.0, 0.01]}}}, 'another form'),
        (8, {'residual_patch': {}}, 'with a cause, got residual_patch'),
    ],
)
def test_diagnoses_that_cannot_be_randomised(rows, effects, said, tmp_path):
    folder = diagnosed(tmp_path / 'diagnosis', rows, effects)
    with pytest.raises(InputError, match=said):
        randomise(folder, tmp_path / 'r.yaml')
    assert not (tmp_path / 'r.yaml').exists()


def test_numbers_that_a_diagnosis_has_fitted_are_drawn(tmp_path):
    """Assert it of raw frames, whose stamp the form of the catalogue has at the other end."""
    before, name = {'stretch': 0.6, 'stamp_at': 1.0}, 'motion_artefact'
    folder = diagnosed(tmp_path / 'diagnosis', 8, {name: {'stretch': 1.1, 'stamp_at': 0.0}})
    with changed(folder) as table:
        table['calibration'] = {'effects': [{'name': name, 'typical': before}]}
        for k, row in enumerate(table['recordings']):
            row['effects_without'][name] = {**before, 'stretch': 0.6 + 0.1 * (-1) ** k}
            row['forms_without'] = {name: {'stretch': 1.1 + 0.02 * (-1) ** k, 'stamp_at': 0.0}}
    found = randomise(folder, tmp_path / 'r.yaml')
    (one,) = (item for item in found.randomisation.distributions if item.effect == name)
    assert (one.parameter, one.mean) == ('stretch', 1.1)
    assert one.sd < 0.3
    for drawn in load_randomisation(tmp_path / 'r.yaml').draw(3, 1):
        (effect,) = (each for each in drawn if each.name == name)
        assert effect.settings['stamp_at'] == 0.0


def test_the_folder_of_a_calibration_is_named_as_such(tmp_path):
    folder = diagnosed(tmp_path / 'diagnosis', 8, FITTED)
    with changed(folder) as table:
        for row in table['recordings']:
            del row['effects_without']
    with pytest.raises(InputError, match='use the folder of flexx2 gap diagnose'):
        randomise(folder)
