"""The report of a diagnosis: what it says of the gap, its causes and its size."""

from flexx2_sim_ros.gap.features.confirm import parts
from flexx2_sim_ros.gap.features.physical import NOISE
from flexx2_sim_ros.gap.report.places import difference, finding
from flexx2_sim_ros.gap.report.sizes import attribution, lengths, shown_by_one
from flexx2_sim_ros.gap.report.table import makes_larger, verdict_of
from flexx2_sim_ros.gap.report.text import short
from flexx2_sim_ros.gap.report.words import (
    blames_poses,
    headline,
    on_recordings,
    reduction,
    sentences,
)
from flexx2_sim_ros.gap.report.writing import comment
from flexx2_sim_ros.html_drawing import curves
import numpy as np
import pytest

PARTS = 'distance', 'mm', 'invalid_percent', 'noise'


def row(covariate, channel='bias', **more):
    return {
        'covariate': covariate,
        'low': None,
        'high': None,
        'unit': '',
        'detail': '',
        'channel': channel,
        'size': 12.0,
        'unit_size': 'mm',
        'q_value': 0.0,
        **more,
    }


def identified(*names, **gap):
    """Return what the words of a report need of a diagnosis with these effects."""
    size = {'before': 5.0, 'after': 2.0, 'null': 1.0, 'tolerance': 1.0}
    usual = {
        'shrink': 0.6,
        'interval': [0.4, 0.8],
        'noise_factor': 1.0,
        'measured_by': 'distance',
        'held_out': False,
        'worse': [],
        'at_fitted_poses': {'shrink': 0.6},
        **dict.fromkeys(('wasserstein_mm', 'invalid_rate', 'distance', *NOISE), size),
        'absorbed_by_poses': dict.fromkeys(PARTS, {'mean': 0.0, 'interval': None}),
        'not_explained': {
            'distance': {'mean': 3.0, 'interval': None},
            'mm': {'mean': 1.0, 'interval': None},
            'invalid_percent': {'mean': 100.0, 'interval': None},
            'noise': {'mean': 60.0, 'interval': [50.0, 70.0]},
        },
    }
    return {
        'verdict': 'identified',
        'effects': [{'name': name, 'confidence': 0.9} for name in names],
        'gap': usual | gap,
        'calibration': None,
        'alternatives': [],
        'unexplained': [],
        'not_decidable': [],
        'where': [],
        'disagree': None,
        'recordings': [],
        'settings': {'pose_stated': False},
        'age': {'latency': 0.0, 'delay': None},
    }


def test_a_note_on_several_recordings_is_said_once():
    rows = [
        {'name': name, 'used': True, 'notes': [f'bags/{name}: usecase: not in the file', 'late']}
        for name in ('one', 'two', 'three')
    ]
    rows += [{'name': name, 'used': False, 'reason': f'bags/{name}: cut off'} for name in 'xy']
    assert on_recordings([*rows, {'name': 'four', 'used': True, 'notes': ['long']}]) == [
        'Left out: bags/x: cut off (the same for 1 more).',
        'Note: bags/one: usecase: not in the file (the same for 2 more).',
        'Note: late (the same for 2 more).',
        'Note: long.',
    ]


@pytest.mark.parametrize(
    ('cell', 'said'),
    [
        (row('all', size=-3.0), 'all surfaces read 3 mm too near'),
        (
            row('distance', 'invalid', low=2.0, high=3.0, unit='m', size=0.46, unit_size=''),
            'surfaces at a distance from 2 to 3 m have no depth in 46 % more of their pixels',
        ),
        (
            row('amplitude', 'log_variance', high=0.05, unit='1/m^2', size=1.3863, unit_size='ln'),
            'surfaces darker than a wall of reflectivity 0.2 at 2 m have 2 times the noise of the '
            'simulation',
        ),
        (
            row('all', 'log_variance', size=2 * np.log(250.0), unit_size='ln'),
            'all surfaces have 250 times the noise of the simulation',
        ),
        (row('amplitude', low=0.05, unit='1/m^2'), 'brighter than a wall of reflectivity 0.2 at'),
        (row('speed', high=-0.8, unit='m/s'), 'surfaces that come nearer (below -0.8 m/s) read'),
        (row('speed', low=0.03, high=0.4, unit='m/s'), 'surfaces that move away (from 0.03 to'),
        (row('speed', low=-0.03, high=0.03, unit='m/s'), 'surfaces at a speed (from -0.03 to'),
        (row('recording', low=2, high=2, detail='a.npz'), 'surfaces in recording a.npz read'),
        (row('structure', 'row_common', unit_size=''), 'everywhere: noise common to a row'),
    ],
)
def test_the_first_row_is_a_sentence(cell, said):
    assert said in finding(cell)


def measured(before, after, null):
    return {'before': before, 'after': after, 'null': null, 'tolerance': 0.008}


@pytest.mark.parametrize(
    ('interval', 'measured_by', 'said', 'unsaid'),
    [
        ([0.61, 0.98], 'distance', ['61 % to 98 %', '100 % would be'], 'larger'),
        ([-0.5, 1.0], 'distance', ['-50 % to 100 %', 'make the gap larger'], 'too few'),
        (None, 'distance', ['too few for an interval'], 'expect'),
        ([0.61, 0.98], 'loss', ['improvement of the fit'], '100 % would be'),
    ],
)
def test_the_reduction_is_explained(interval, measured_by, said, unsaid):
    gap = {
        'wasserstein_mm': measured(1230.0, 5.4, 1.7),
        'invalid_rate': measured(1.0, 0.02, 0.001),
        'held_out': True,
        'interval': interval,
        'measured_by': measured_by,
        'worse': [],
    }
    text = ' '.join(reduction(gap))
    assert 'depth errors 1230 mm, invalid pixels 100 %. With the effects it is: ' in text
    assert 'depth errors 5.4 mm, invalid pixels 2 %.' in text
    for words in said:
        assert words in text
    assert unsaid not in text


@pytest.mark.parametrize(
    ('channel', 'size', 'unit', 'said'),
    [
        ('bias', 12.3, 'mm', 'depth +12.30 mm'),
        ('row_invalid', -0.012, 'fraction', 'rows without any depth -1.2 %'),
        ('row_common', 0.31, 'fraction of variance', 'common to a row +0.31 of the variance'),
        ('lag', 0.62, 'correlation', 'correlation with the frame before +0.62'),
    ],
)
def test_a_difference_has_its_unit(channel, size, unit, said):
    assert difference(row('all', channel, size=size, unit_size=unit)).endswith(said)


@pytest.mark.parametrize(
    ('number', 'text'),
    [
        (0.0123, '0.012'),
        (99.4, '99'),
        (99.7, '100'),
        (-667.0, '-667'),
        (0, '0'),
        (2.76e-5, '0.000028'),
        (-1e-9, '0'),
    ],
)
def test_short_numbers_have_no_exponent(number, text):
    assert short(number) == text


@pytest.mark.parametrize(
    ('names', 'shrink', 'blamed'),
    [
        (['pose_error'], 0.0, True),
        (['pose_error', 'offset'], 0.04, True),
        (['pose_error', 'offset'], 0.4, False),
        (['offset', 'pose_error'], 0.04, False),
    ],
)
def test_poses_are_blamed_where_other_effects_do_little(names, shrink, blamed):
    assert blames_poses(identified(*names, at_fitted_poses={'shrink': shrink})) == blamed


@pytest.mark.parametrize(
    ('verdict', 'names', 'shrink', 'fitted', 'left', 'said'),
    [
        ('identified', ['offset'], 0.9, 0.9, 0.9, 'identified'),
        ('identified', ['offset'], 0.75, 0.9, 0.9, 'partly'),
        ('identified', ['offset'], 0.9, 0.9, 1.1, 'partly'),
        ('identified', ['pose_error'], 0.0, 0.0, 1.1, 'identified'),
        ('identified', ['offset', 'pose_error'], 0.2, 0.9, 0.9, 'identified'),
        ('identified', ['offset', 'pose_error'], 0.2, 0.9, 1.1, 'partly'),
        ('identified', ['offset', 'pose_error'], 0.2, 0.4, 0.9, 'partly'),
        ('unknown', ['offset'], 0.0, 0.0, 0.0, 'unknown'),
    ],
)
def test_effects_that_close_less_than_four_fifths_of_the_gap_explain_it_partly(
    verdict, names, shrink, fitted, left, said
):
    """Or that leave more than the tolerance, a distance of 1."""
    distance = {'after': 0.5 + left, 'null': 0.5, 'tolerance': 1.0}
    gap = {'shrink': shrink, 'at_fitted_poses': {'shrink': fitted, **distance}}
    table = identified(*names, **gap, held_out=True, distance=distance)
    table['verdict'] = verdict
    assert verdict_of(table) == said
    # One recording cannot tell what it shares with others.
    alone = verdict_of(table | {'gap': table['gap'] | {'held_out': False}})
    assert alone != 'identified' or names[0] == 'pose_error'
    # Nor can recordings that disagree.
    unlike = verdict_of(table | {'disagree': {'name': 'offset', 'has': ['a'], 'lacks': ['b']}})
    assert unlike != 'identified' or names[0] == 'pose_error'
    # A form that is a constant is as good as any other cause that does the same.
    row = {'name': 'offset', 'taken': True, 'varies': 0.01}
    table['calibration'] = {'effects': [row]}
    assert verdict_of(table) != 'identified' or names[0] == 'pose_error'


@pytest.mark.parametrize(
    ('confidences', 'words'),
    [
        ([0.8], 'is due to offset:'),
        ([0.3], 'may be due to offset:'),
        ([0.06, 0.8], 'is due to wiggling, and may be due to offset as well:'),
        ([0.06, 0.3], 'may be due to offset and wiggling:'),
    ],
)
def test_the_headline_says_how_sure_each_cause_is(confidences, words):
    table = identified('offset', 'wiggling')
    table['effects'] = table['effects'][: len(confidences)]
    for row, confidence in zip(table['effects'], confidences, strict=True):
        row['confidence'] = confidence
    assert headline(table).startswith(f'The gap {words} adding')


@pytest.mark.parametrize(
    ('names', 'shrink', 'by', 'said'),
    [
        (['pose_error'], 0.9, 'distance', 'The poses of the cameras are wrong: correct them'),
        (['offset'], 0.9, 'distance', 'removes 90 % of the gap: depth errors 8.4 -> 2.1 mm.'),
        (['offset'], -0.2, 'distance', 'the gap in depth and invalid pixels becomes 20 % larger'),
        (['offset'], -0.2, 'loss', 'makes the misfit 20 % larger'),
    ],
)
def test_the_headline_promises_no_more_than_was_measured(names, shrink, by, said):
    gap = {
        'wasserstein_mm': {'before': 8.4, 'after': 2.1, 'null': 0.5, 'tolerance': 0.2},
        'invalid_rate': {'before': 0.004, 'after': 0.002, 'null': 0.001, 'tolerance': 0.008},
    }
    assert said in headline(identified(*names, shrink=shrink, measured_by=by, **gap))


@pytest.mark.parametrize(('shrink', 'said'), [(0.6, 'remains.'), (0.9, 'may remain.')])
def test_the_little_that_is_left_is_not_said_to_have_a_cause(shrink, said):
    partly = identified('offset', shrink=shrink) | {'verdict': 'partly'}
    assert headline(partly).endswith(f' Another cause {said}')


@pytest.mark.parametrize(
    ('names', 'shrink', 'fitted', 'by', 'larger'),
    [
        (['offset'], -0.3, 0.0, 'distance', True),
        (['offset'], -0.05, 0.0, 'distance', False),  # within what a prediction is wrong by
        (['offset'], 0.9, 0.0, 'distance', False),
        (['quantisation'], -0.3, 0.0, 'loss', False),  # a misfit, not a distance
        (['offset', 'pose_error'], -0.9, 0.4, 'distance', False),  # the given poses are wrong
        (['offset', 'pose_error'], -0.9, -0.2, 'distance', True),
        (['pose_error'], 0.0, -0.2, 'distance', False),
    ],
)
def test_which_effects_make_the_gap_larger(names, shrink, fitted, by, larger):
    gap = {'shrink': shrink, 'at_fitted_poses': {'shrink': fitted}, 'measured_by': by}
    assert makes_larger(identified(*names, **gap)) is larger


@pytest.mark.parametrize(
    ('reason', 'said'),
    [
        ('improbable', 'none of the effects found is probable enough'),
        ('little', 'the effects found explain too little of the gap'),
        ('larger', 'the effects found make the gap larger when they are simulated'),
    ],
)
def test_an_unknown_cause_has_a_reason_and_its_nearest_explanations(reason, said):
    table = identified() | {
        'verdict': 'unknown',
        'alternatives': [{'name': 'offset'}, {'name': 'amplitude_bias'}],
        'refused': [{'name': 'offset', 'reason': reason}],
    }
    assert sentences(table) == [
        f'Found, but not named: offset: {said}.',
        'Other explanations: amplitude bias.',
    ]
    # Diagnoses of older versions do not say it.
    del table['refused']
    assert sentences(table) == ['Nearest explanations: offset and amplitude bias.']


def test_the_accuracy_of_poses_is_asked_for_where_they_may_hide_effects():
    exact = dict.fromkeys(('unknown', 'sigma', 'pose', 'turn', 'planes', 'offset', 'tilt'))
    rows = [{'used': True, 'truth': exact}]
    several = identified('offset', 'wiggling', at_fitted_poses={'shrink': 0.5})
    asked = [table | {'recordings': rows} for table in (several, identified('offset'))]
    held = asked[0] | {'settings': {'pose_stated': True}}
    known = asked[0] | {
        'recordings': [{'used': True, 'truth': exact | {'pose': 0.1, 'turn': 1.0}}]
    }
    said = ['--pose-prior' in ' '.join(sentences(table)) for table in (*asked, held, known)]
    assert said == [True, False, False, False]


@pytest.mark.parametrize(
    ('share', 'said'),
    [
        (0.08, 'take{} away 8 % of {}'),
        (-0.08, 'add{} 8 % to {}'),
        (-0.004, 'take{} away 0 % of {}'),
    ],
)
def test_a_gap_that_grows_is_not_said_to_be_taken_away(share, said):
    shown = {'shrink': share, 'interval': [share, 0.9]}
    table = identified('offset', 'pose_error', at_fitted_poses={'shrink': share}, **shown)
    form = {'name': 'offset', 'form': 'curve', 'taken': True}
    gap = table['gap']
    table['calibration'] = {'effects': [form], 'dropped': [], 'typical_gap': gap}
    assert f'Once the poses are corrected, it {said.format("s", "what is left")}.' in headline(
        table
    )
    would = f'the effects would {said.format("", "the gap")}.'
    assert any(would in one for one in sentences(table))
    assert said.format('s', 'the gap') in comment(table).splitlines()


@pytest.mark.parametrize(
    ('factor', 'said'), [(1.01, ''), (1.05, '5 % above the model'), (0.96, '4 % below the model')]
)
def test_a_noise_level_of_its_own_is_said(factor, said):
    table = identified('offset', noise_factor=factor)
    text = ' '.join(sentences(table))
    assert said in text
    assert ('noise of this camera' in text) == bool(said)


def test_a_curve_of_one_value_is_drawn():
    drawn = curves(np.zeros(1), np.zeros((1, 1)), ['a'], 'x', 'y', 0.0)
    assert 'nan' not in drawn
    assert drawn.count('<polyline') == 1


def test_what_effects_take_off_is_a_table_with_what_is_left():
    table = identified('saturation', 'offset')
    sure = {'mean': 5.69, 'interval': [4.0, 7.26]}
    nothing = {'mean': -0.003, 'interval': [-0.01, 0.02]}
    for row, mm, lost in zip(table['effects'], (nothing, sure), (sure, nothing), strict=True):
        row['takes_off'] = {'distance': sure, 'mm': mm, 'invalid_percent': lost, 'noise': sure}
    assert attribution(table) == [
        ('saturation', '90 %', '0 mm', '5.7 % (4 to 7.3)', '5.7 (4 to 7.3)'),
        ('offset', '90 %', '5.7 mm (4 to 7.3)', '0 %', '5.7 (4 to 7.3)'),
        ('not explained', '', '1 mm', '100 %', '60 (50 to 70)'),
        # Two tolerances of 0.04, and one of 0.1.
        ('two simulations', '', '1 mm', '100 %', '60'),
        ('together', '', '5 mm', '500 %', '300'),
    ]
    assert lengths(table) == [5.69, 5.69, 3.0, 1.0, 5.0]
    table['gap']['absorbed_by_poses'] = table['gap']['not_explained']
    assert [one for one, *_ in attribution(table)][2:4] == ['absorbed by poses', 'not explained']
    table['recordings'] = [
        {
            'name': f'{k}.npz',
            'used': True,
            'takes_off_here': {'saturation': 9.0 * (k == 1) - 0.1, 'offset': 2.0},
        }
        for k in range(4)
    ]
    assert shown_by_one(table) == ['saturation shows in 1.npz alone: record more scenes like it.']
    table['recordings'] = table['recordings'][:2]
    assert shown_by_one(table) == []


def test_noise_that_was_not_measured_is_no_zero():
    nothing = {'before': 0.0, 'after': 0.0, 'null': 0.0}
    part = dict.fromkeys(PARTS, {'mean': 0.0, 'interval': None})
    table = identified('offset', **dict.fromkeys(NOISE, nothing))
    table['effects'][0]['takes_off'] = part
    assert {row[-1] for row in attribution(table)} == {'-'}
    assert attribution(identified()) == []


def test_the_parts_of_effects_add_up():
    """Assert it where one effect hides another, and of one effect alone."""
    asked = []

    def far(some):
        asked.append(set(some))
        hidden = 2.0 if {'dropout', 'offset'} <= set(some) else 0.0
        return np.array([10.0 + hidden - 3 * ('dropout' in some) - 4 * ('offset' in some), 1.0])

    found = parts({'offset': {}, 'dropout': {}, 'noise': {}}, far)
    assert {name: tuple(part) for name, part in found.items()} == {
        'offset': (3.0, 0.0),
        'dropout': (2.0, 0.0),
        'noise': (0.0, 0.0),
    }
    assert sum(part[0] for part in found.values()) == far({})[0] - far(asked[3])[0]
    assert len(asked) - 2 == 2 * 3  # both ends, and two orders of two
    assert parts({'offset': {}}, far)['offset'][0] == 4.0
