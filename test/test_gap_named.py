"""A diagnosis simulates what it names: it fits, doubts, refuses what harms, promises no more."""

from dataclasses import replace
import re

from bench.gap_campaigns import write_campaign
from campaigns import ALIKE, all_but, among
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.gap.calibration.inference import THRESHOLDS
from flexx2_sim_ros.gap.inference.improvement import measured
from flexx2_sim_ros.gap.report import table as report_table
from flexx2_sim_ros.gap.report.words import sentences
import numpy as np
import pytest

SIZE = {'frames': 8, 'scale': 0.35, 'recordings': 5, 'moving': 2}


def test_the_gate_of_a_filter_is_found_by_a_diagnosis(tmp_path):
    """Assert it: a wide gate smears what moves, which decides how far the gap closes."""
    effects = {'temporal_filter': {'share': 0.5, 'gate': 20.0}}
    write_campaign(tmp_path, effects=effects, seed=41, **SIZE)
    table = diagnose(tmp_path, without=all_but('motion_artefact', *effects, *ALIKE))
    (effect,) = table['effects']
    assert effect['name'] == 'temporal_filter'
    assert effect['parameters']['share'] == pytest.approx(0.5, abs=0.06)
    assert 12.0 < effect['parameters']['gate'] < 35.0
    (form,) = table['calibration']['effects']
    assert form['taken']
    assert table['gap']['shrink'] > table['calibration']['typical_gap']['shrink']


def test_an_effect_that_is_the_same_everywhere_is_not_sure(tmp_path):
    """Assert it of an offset that is not in the catalogue: a flat amplitude_bias explains it."""
    write_campaign(tmp_path, effects={'offset': {'bias': 0.02}}, seed=42, **SIZE)
    table = diagnose(tmp_path, **among(*ALIKE[1:]))
    assert table['verdict'] in ('partly', 'unknown')
    assert 'offset' not in [one['name'] for one in table['effects']]


def test_the_report_says_why_effects_that_fit_are_not_named(tmp_path, monkeypatch):
    """Assert it with a threshold from which on every effect makes the gap larger."""
    monkeypatch.setattr(report_table, 'THRESHOLDS', replace(THRESHOLDS, larger=-2.0))
    write_campaign(tmp_path, effects={'wiggling': {}}, seed=44, **SIZE)
    table = diagnose(tmp_path, out=tmp_path / 'out', **among(*ALIKE))
    assert table['verdict'] == 'unknown'
    (refused,) = table['refused']
    assert refused['reason'] == 'larger'
    # It comes first among the alternatives, on its own.
    first = table['alternatives'][0]
    assert first['name'] == refused['name']
    assert not first['instead_of']
    name = refused['name'].replace('_', ' ')
    why = 'make the gap larger when they are simulated'
    said = next(one for one in sentences(table) if one.startswith('Found, but not named: '))
    assert name in said
    assert why in said
    page = (tmp_path / 'out' / 'report.html').read_text()
    (row,) = re.findall(f'<tr><td>{name}</td><td>[^<]*</td><td>([^<]*)</td>', page)
    assert why in row
    assert 'too little' not in page


def test_two_recordings_have_no_interval_of_the_reduction():
    values = np.array([[3.0, 1.0, 0.5], [4.0, 1.0, 0.5], [3.5, 1.2, 0.5]])
    assert measured(values[:2], 1.0)['shrink_interval'] is None
    low, high = measured(values, 1.0)['shrink_interval']
    assert low < measured(values, 1.0)['shrink'] < high
