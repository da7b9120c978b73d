"""How the benchmark scores a diagnosis, on answers made by hand."""

import math
from types import MappingProxyType

from made_answers import said, small
import numpy as np
import pytest
from study.benchmark.goals import reach
from study.benchmark.overlap import overlap
from study.benchmark.partition import COVARIATES
from study.benchmark.physics import DEPENDS_ON
from study.benchmark.scoring import answer_of, Scores
from study.blind import CATALOGUE

# Pixels of which the first half is affected.
PIXELS = {
    'affected': np.repeat([True, False], 4),
    'samples': np.zeros((8, len(COVARIATES)), np.float32),
}


for covariate, values in (
    ('distance', [0.5, 0.5, 1.2, 1.8, 2.5, 2.5, 2.5, 2.5]),
    ('incidence', [10.0, 10.0, *[40.0] * 6]),
    ('x', [0.1, 0.1, *[0.4] * 6]),
):
    PIXELS['samples'][:, COVARIATES.index(covariate)] = values


def answer(group, effects, diagnosis, contributions=MappingProxyType({}), only=(), **more):
    result = {'diagnosis': diagnosis, 'seconds': 1.0, **more}
    facts = {'parameters': {'offset': {'bias': 0.010}}, 'contributions': dict(contributions)}
    return answer_of(small(group, effects, 1, only=only), result, facts, PIXELS)


@pytest.mark.parametrize(
    ('group', 'effects', 'diagnosis', 'right', 'contains', 'wrong'),
    [
        ('single', ['offset'], said('identified', ('offset',)), True, True, False),
        ('single', ['offset'], said('partly', ('offset',)), True, True, False),
        ('single', ['offset'], said('identified', ('wiggling',), ('offset',)), False, True, False),
        ('single', ['offset'], said('identified', ('wiggling',)), False, False, True),
        ('single', ['offset'], said('partly', ('wiggling',)), False, False, True),
        ('single', ['offset'], said('unknown', (), ('wiggling',)), False, False, False),
        ('single', ['offset'], said('none'), False, False, True),
        ('single', ['offset'], None, False, False, True),
        ('none', [], said('none'), True, True, False),
        ('none', [], said('identified', ('offset',)), False, False, True),
        ('none', [], said('unknown'), False, False, False),
        ('novel', ['ghost'], said('unknown'), True, True, False),
        ('novel', ['ghost'], said('partly', ('offset',)), True, True, False),
        ('novel', ['ghost'], said('identified', ('offset',)), False, False, True),
        ('left_out', ['offset'], said('unknown'), True, True, False),
        ('left_out', ['offset'], said('none'), False, False, True),
        ('pair', ['offset', 'wiggling'], said('identified', ('wiggling',)), True, True, False),
        ('pair', ['offset', 'wiggling'], said('identified', ('saturation',)), False, False, True),
    ],
)
def test_answers_are_judged(group, effects, diagnosis, right, contains, wrong):
    found = answer(group, dict.fromkeys(effects, 1.0), diagnosis)
    assert (found.right, found.contains, found.wrong) == (right, contains, wrong)
    assert found.missed == (bool(effects) and found.verdict == 'none')


@pytest.mark.parametrize(
    ('verdict', 'named', 'disagree', 'right'),
    [
        ('partly', ('wiggling', 'offset'), None, True),
        ('none', (), {'name': 'offset'}, True),
        ('partly', ('wiggling',), {'name': 'wiggling'}, False),
        ('unknown', ('offset',), None, False),
    ],
)
def test_an_effect_of_some_recordings_is_named_or_sets_them_apart(verdict, named, disagree, right):
    told = said(verdict, named, disagree=disagree)
    assert answer('midway', {'offset': 1.0}, told, only=(1,)).right == right


def test_many_effects_are_weighed_by_what_they_contribute():
    true = {'offset': 6.0, 'wiggling': 3.0, 'saturation': 0.9, 'multipath': 0.1}
    told = said('partly', ('wiggling', 'offset', 'multipath', 'quantisation'))
    for row, taken in zip(told['effects'], (3.0, 5.0, 0.2, 1.0), strict=True):
        row['takes_off'] = {'distance': {'mean': taken}}
    gone = {'shrink': 0.7, 'before': 9.0, 'null': 1.0, 'before_mm': 20.0, 'after_mm': 21.0}
    found = answer('many', dict.fromkeys(true, 1.0), told, true, realised=gone)
    assert found.recall == pytest.approx(0.91)
    assert found.wrong_names == 1
    assert found.order == 1.0
    rows = rows_of(found)
    assert rows['4 effects: named, weighted by what they contribute: mean'][2] == 'NO'
    assert rows['many effects: wrong names a camera'][1] == '1.000 (1)'
    assert rows['many effects: depth error in mm grows'][2] == 'NO'
    unsure = answer('many', dict.fromkeys(true, 1.0), said('unknown', ('offset',)), true)
    assert (unsure.recall, unsure.wrong_names, unsure.delivered) == (0, 0, 0)
    assert math.isnan(unsure.order)


def test_both_effects_of_a_pair_have_to_be_named():
    effects = {'offset': 1.0, 'wiggling': 1.0}
    assert answer('pair', effects, said('identified', ('wiggling', 'offset'))).both
    assert not answer('pair', effects, said('identified', ('wiggling',), ('offset',))).both


def test_parameters_and_shrinkage():
    found = answer(
        'single', {'offset': 1.0}, said('identified', ('offset',)), realised={'shrink': 0.7}
    )
    assert found.parameter_error == pytest.approx(0.2)
    assert (found.predicted, found.low, found.high, found.realised) == (0.6, 0.4, 0.8, 0.7)
    missed = answer('single', {'offset': 1.0}, said('identified', ('wiggling',)))
    assert math.isnan(missed.parameter_error)
    assert math.isnan(missed.realised)


@pytest.mark.parametrize(
    ('where', 'wanted'),
    [
        ([], 0.0),
        ([('distance', 0.0, 1.0, 'm')], 0.5),
        ([('distance', 0.0, 2000.0, 'mm')], 1.0),
        ([('distance', 0.0, 1.5, 'm')], 0.75),
        ([('distance', 0.0, 1.0, 'm'), ('fine_distance', 1.0, None, 'm')], 0.5),
        ([('all', None, None, '')], 0.5),
        ([('image region row 1 of 3, column 1 of 4', None, None, '')], 0.5),
        ([('image region row 2 of 3, column 1 of 4', None, None, '')], 0.0),
        ([('theta', 0.0, 0.3, 'rad')], 0.5),
        ([('incidence', 30.0, 50.0, 'deg')], 0.25),
        ([('something else', 0.0, 9.0, 'm')], 0.0),
    ],
)
def test_the_score_of_where_is_the_intersection_over_union_in_pixels(where, wanted):
    entries = [
        dict(zip(('covariate', 'low', 'high', 'unit'), entry, strict=True)) for entry in where
    ]
    assert overlap(entries, PIXELS) == pytest.approx(wanted)
    assert math.isnan(overlap(entries, {**PIXELS, 'affected': np.zeros(8, bool)}))


@pytest.mark.parametrize(
    ('effects', 'places', 'right'),
    [
        (['saturation'], ['amplitude', 'recording'], True),
        (['saturation'], ['recording', 'amplitude'], False),
        (['wiggling'], ['fine_distance'], True),
        (['intrinsics_error'], ['image region row 1 of 3, column 2 of 4'], True),
        (['offset', 'warm_up_drift'], ['uptime'], True),
        (['quantisation'], ['structure', 'distance'], True),
        (['wiggling'], ['structure'], False),
        (['offset'], [], False),
    ],
)
def test_the_first_row_of_where_has_to_name_what_an_effect_depends_on(effects, places, right):
    where = [{'covariate': name, 'low': None, 'high': None, 'unit': ''} for name in places]
    found = answer('single', dict.fromkeys(effects, 1.0), said('unknown', where=where))
    assert found.right_place == right


def test_the_scorer_knows_what_every_effect_depends_on():
    assert set(DEPENDS_ON) == set(CATALOGUE)


def rows_of(*answers):
    """Return the table of goals by its first column."""
    return {row[0]: row[1:] for row in reach(Scores(answers, {})).rows}


def test_goals_on_the_realised_reduction_and_its_prediction():
    def realised(shrink, before=5.0):
        found = {'shrink': shrink, 'before': before, 'null': 1.0}
        return answer('single', {'offset': 1.0}, said('identified', ('offset',)), realised=found)

    # 0.6 [0.4, 0.8] is predicted. The last gap is too small for the independent measure.
    rows = rows_of(realised(0.9), realised(0.7), realised(-0.1), realised(0.6, before=1.5))
    median = 'realised reduction of the gap, strength 1, independent measure: median'
    assert rows[median] == ('>= 0.85', '0.700 (3)', 'NO')
    assert rows['... the smallest'] == ('>= 0', '-0.100 (3)', 'NO')
    error = 'predicted less realised reduction: mean absolute value'
    assert rows[error] == ('<= 0.06', '0.275 (4)', 'NO')
    coverage = rows['predicted reduction: empirical coverage of 90 % intervals']
    assert coverage[1].startswith('50.0 %')


def test_confidences_of_absent_effects_are_a_calibration_error():
    # Made diagnoses have a confidence of 0.9 in each effect that they name.
    right = answer('single', {'offset': 1.0}, said('identified', ('offset',)))
    wrong = answer('single', {'offset': 1.0}, said('identified', ('wiggling',)))
    row = 'expected calibration error of `confidence`, all cases'
    assert rows_of(*9 * [right], wrong)[row] == ('<= 0.05', '0.000 (10)', 'yes')
    assert rows_of(right, wrong)[row] == ('<= 0.05', '0.400 (2)', 'NO')
