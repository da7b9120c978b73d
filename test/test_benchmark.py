"""The benchmark harness: seeds, seals, scores and resumption, on answers made by hand."""

import argparse
from dataclasses import replace
import json
from pathlib import Path
from types import SimpleNamespace

from flexx2_sim_ros.cli.options import add_table
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from made_answers import said, small
import numpy as np
import pytest
from rich.console import Console
from study.benchmark import DEVELOPMENT, make_design, Planned, run_benchmark, score, TEST
from study.benchmark.answers import joined, read_answers, write_answers
from study.benchmark.command import OPTIONS, VALUES
from study.benchmark.command import run as run_command
from study.benchmark.realised import realised_gap
from study.benchmark.report import draw_confusion, print_report, sheets, write_page
from study.benchmark.runner import run_case
from study.benchmark.sealing import open_seal, seal
from study.benchmark.seeds import seed_range
from study.blind import BlindCamera, CATALOGUE, Internals, NOVEL, VARIED

CALLS = []
QUIET = Console(quiet=True)


def diagnose(folder, *, without=(), seed=0, jobs=1):
    """Stand in for the diagnosis: random answers in its schema."""
    CALLS.append((folder, without))
    assert len(list(folder.glob('*.npz'))) == 2
    rng = np.random.default_rng(seed)
    if rng.random() < 0.2:
        raise RuntimeError('a diagnosis that breaks')
    verdict = str(rng.choice(['none', 'identified', 'partly', 'unknown']))
    names = [name for name in sorted(CATALOGUE) if name not in without]
    names = names if verdict in ('identified', 'partly') else []
    answer = said(verdict, tuple(rng.choice(names, 1)) if names else ())
    for effect in answer['effects']:
        effect['parameters'] = {'strength': 0.5}
    return answer


def measure(folder, effects, *, seed=0):
    """Stand in for the diagnosis's own gap."""
    return {'shrink': 0.5}


DESIGN = [
    small('single', {'offset': 1.0}, 1, realise=True),
    small('single', {'wiggling': 0.5}, 2),
    small('none', {}, 3),
    small('pair', {'offset': 1.0, 'temporal_filter': 1.0}, 4),
    small('novel', {'row_bands': 1.0}, 5),
    small('left_out', {'offset': 1.0}, 6, without=('offset',)),
    small('many', {'offset': 1.0, 'temporal_filter': 1.0, 'saturation': 0.5}, 7, realise=True),
]


@pytest.fixture(scope='module', autouse=True)
def few_cases():
    """Let every design be a few tiny cases."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('study.benchmark.runner.make_design', lambda *_: DESIGN)
        yield


def run(out, **options):
    return run_benchmark(
        out,
        diagnoser=f'{__name__}:diagnose',
        measurer=f'{__name__}:measure',
        console=QUIET,
        **options,
    )


def test_development_and_test_seeds_do_not_overlap():
    for seeds, index in ((DEVELOPMENT, 1_000_000), (TEST, -1)):
        with pytest.raises(InputError, match='seed index'):
            seeds.seed(index)
    assert DEVELOPMENT.seed(999_999) < TEST.seed(0)
    for seeds, other in ((DEVELOPMENT, TEST), (TEST, DEVELOPMENT)):
        for quick in (True, False):
            for case in make_design(seeds, quick):
                for seed in (case.seed, case.scene_seed, case.scene_seed + 500):
                    assert seed in seeds
                    assert seed not in other


def test_test_seeds_need_a_release(tmp_path):
    with pytest.raises(InputError, match='--release'):
        run(tmp_path / 'out', seed_set='test')
    assert not (tmp_path / 'out').exists()
    assert seed_range('test', True) is TEST
    with pytest.raises(InputError, match='dev or test'):
        seed_range('other', True)
    parser = argparse.ArgumentParser()
    add_table(parser, OPTIONS, **VALUES)
    arguments = parser.parse_args(['--seed-set', 'test', '--out', str(tmp_path / 'out')])
    with pytest.raises(InputError, match='--release'):
        run_command(arguments)


def test_the_full_design_has_all_groups_and_strengths():
    cases = make_design(DEVELOPMENT, quick=False)
    page = Path(__file__).parents[1] / 'docs' / 'diagnosis_evidence.md'
    assert f'without it there are {len(cases)} ' in page.read_text()
    for usecase in ('Mode_5_30fps', 'Mode_9_30fps'):
        here = [case for case in cases if case.usecase == usecase]
        single = [one for one in here if one.group == 'single' and one.pose_mm == 2.0]
        sizes = {size for one in single for size in one.effects.items()}
        assert sizes == {(name, size) for name in CATALOGUE for size in (0.25, 0.5, 1.0, 2.0)}
        assert {one.without[0] for one in here if one.group == 'left_out'} == set(CATALOGUE)
    assert sum(case.group == 'none' for case in cases) >= 100
    assert {name for case in cases if case.group == 'novel' for name in case.effects} == set(NOVEL)
    assert all(len(case.effects) == 2 for case in cases if case.group == 'pair')
    inside = [case for case in cases if case.group == 'internals']
    assert len(inside) == len(VARIED)
    assert all(case.case.internals != Internals() for case in inside)
    assert all(Planned.from_json(case.to_json()) == case for case in inside)
    many = [case for case in cases if case.group == 'many']
    assert {len(case.effects) for case in many} == {4, 8, 14}
    assert {case.width for case in many} == {112, 224, 320}
    assert 'pose_error' not in {name for case in many for name in case.effects}
    assert all(Planned.from_json(case.to_json()) == case for case in many)
    assert {case.only for case in cases if case.group == 'midway'} == {(4, 5, 6, 7)}
    assert {len(case.only) for case in cases if case.group == 'one_scene'} == {1}
    hidden = [case for case in cases if case.hidden]
    assert all(case.group == 'truth' for case in hidden)
    assert {name for case in hidden for name in case.effects} == set(CATALOGUE)
    assert any(not case.effects for case in hidden)
    assert {case.pose_mm for case in cases} == {0.0, 2.0, 5.0}
    assert len({case.seed for case in cases}) == len(cases)
    quiet = [case.scene_seed for case in cases if case.group == 'none']
    others = {case.scene_seed for case in cases if case.group != 'none'}
    assert len(set(quiet)) == len(quiet)
    assert not others & set(quiet)


def median_errors(folder, **_):
    """Stand in for the diagnosis: of the depth of each recording, metres."""
    some = [load_recording(path) for path in sorted(folder.glob('*.npz'))]
    return {'verdict': 'none', 'errors': [np.nanmedian(r.depth - r.clean_depth) for r in some]}


def test_some_recordings_of_a_campaign_have_the_effect(tmp_path):
    case = small('midway', {'offset': 2.0}, 1, only=(1,))
    reference = f'{__name__}:median_errors'
    (tmp_path / 'results').mkdir()
    assert not run_case(tmp_path, 'case', replace(case, pose_mm=0.0).to_json(), reference, '')
    result = json.loads((tmp_path / 'results' / 'case.json').read_text())
    plain, moved = np.abs(result['diagnosis']['errors'])
    assert plain < 0.003 < 0.01 < moved


def test_labels_are_sealed(tmp_path):
    public, sealed = tmp_path / 'public', tmp_path / 'sealed'
    first = seal(DESIGN, sealed, public, {'seed_set': 'dev'})
    published = (public / 'commitment.json').read_text()
    assert first.digest in published
    for word in ('offset', 'wiggling', 'row_bands', 'single', 'salt'):
        assert word not in published
    assert all(len(name) == 12 for name in first.cases)
    # Another run gives other ids and another hash: the salt is not known from the design.
    again = seal(DESIGN, tmp_path / 's2', tmp_path / 'p2', {})
    assert again.digest != first.digest
    assert not set(again.cases) & set(first.cases)
    # Taking a run up again changes nothing; another design is refused.
    assert seal(DESIGN, sealed, public, {}).digest == first.digest
    with pytest.raises(InputError, match='another benchmark'):
        seal(DESIGN[:-1], sealed, public, {})
    labels = sealed / 'labels.json'
    labels.write_text(labels.read_text().replace('wiggling', 'saturation'))
    with pytest.raises(InputError, match='not the labels of this run'):
        open_seal(sealed, public)


def test_a_run_without_finished_cases_cannot_be_scored(tmp_path):
    (tmp_path / 'results').mkdir()
    seal(DESIGN, tmp_path / 'sealed', tmp_path, {})
    with pytest.raises(InputError, match='at least one finished case'):
        score(tmp_path, partly=True)


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Run two cases and then the rest; return what was there in between, and all at the end."""
    out = tmp_path_factory.mktemp('whole')
    CALLS.clear()
    assert run(out, limit=2) is None
    done = {path: path.stat().st_mtime_ns for path in (out / 'results').iterdir()}
    part = score(out, partly=True)
    return SimpleNamespace(out=out, done=done, part=part, scores=run(out), calls=CALLS.copy())


def page_of(scores, folder):
    write_page(scores, folder / 'page.md', 'flexx2 gap benchmark', 'c.png')
    return (folder / 'page.md').read_text()


def test_an_interrupted_run_resumes(whole, tmp_path):
    assert len(whole.part.answers) == len(whole.done) == 2
    assert f'the first 2 of {len(DESIGN)} cases' in page_of(whole.part, tmp_path)
    assert len(whole.scores.answers) == len(whole.calls) == len(DESIGN)
    assert all(path.stat().st_mtime_ns == time for path, time in whole.done.items())
    # Once more: nothing left to do.
    CALLS.clear()
    again = run(whole.out)
    assert CALLS == []
    assert [a.verdict for a in again.answers] == [a.verdict for a in whole.scores.answers]


def test_a_run_is_finished_from_the_answers_of_an_earlier_part(whole, tmp_path):
    file = tmp_path / 'answers.jsonl'
    write_answers(whole.part, file)
    earlier = read_answers(file)
    assert str(earlier) == str(whole.part)
    CALLS.clear()
    scores = joined(earlier, run(tmp_path / 'later', earlier=earlier))
    assert len(CALLS) == len(DESIGN) - 2
    assert sorted(a.planned.key for a in scores.answers) == sorted(one.key for one in DESIGN)
    page = page_of(scores, tmp_path)
    assert f'{len(DESIGN)} cases; it was run in 2 parts' in page
    assert all(one['sha256'] in page for one in (earlier.commitment, scores.commitment))
    # A third part would have nothing to do.
    write_answers(scores, file)
    assert read_answers(file).planned == len(DESIGN)
    with pytest.raises(InputError, match='must leave cases to run'):
        run(tmp_path / 'third', earlier=read_answers(file))


def test_the_diagnosis_sees_recordings_and_nothing_else(whole):
    assert [without for _, without in whole.calls].count(('offset',)) == 1
    for folder, _ in whole.calls:
        assert not folder.exists()
        assert whole.out not in folder.parents
    for path in (whole.out / 'results').iterdir():
        result = json.loads(path.read_text())
        assert set(result) == {
            'error', 'diagnosis', 'baselines', 'realised', 'seconds', 'cpu_seconds',
        }  # fmt: skip
        # What it broke off with is kept, and does not end the run.
        assert (result['diagnosis'] is None) == (result['error'] is not None)


def test_the_report_shows_every_row(whole, tmp_path):
    scores = whole.scores
    draw_confusion(scores, tmp_path / 'c.png')
    assert (tmp_path / 'c.png').stat().st_size > 10_000
    page = page_of(scores, tmp_path)
    for words in (
        'single effects, strength 1', 'false alarms', 'left out', 'localisation',
        'flexx2 gap benchmark', scores.commitment['sha256'], 'c.png',
    ):  # fmt: skip
        assert words in page
    with (tmp_path / 'printed').open('w') as file:
        print_report(scores, Console(file=file, width=200))
    assert 'Goals' in (tmp_path / 'printed').read_text()
    assert all(len(row) == len(sheet.columns) for sheet in sheets(scores) for row in sheet.rows)


def test_realised_shrinkage_is_measured_on_fresh_recordings(tmp_path):
    size = {'width': 112, 'height': 86, 'recordings': 4, 'frames': 10}
    case = replace(small('single', {'offset': 1.0}, 1), pose_mm=0.0, **size)
    camera = BlindCamera(case.case)
    right = said('identified', ('offset',))
    right['effects'][0]['parameters'] = {'bias': camera.effects[0].parameters['bias']}
    found = realised_gap(case, right, tmp_path, measure)
    assert found['shrink'] > 0.9
    assert found['after'] - found['null'] < 0.1 * found['before']
    assert found['before_mm'] > 7
    assert found['after_mm'] < 0.4 * found['before_mm']
    assert found['null_mm'] < 2
    right['effects'][0]['parameters'] = {'bias': -camera.effects[0].parameters['bias']}
    assert realised_gap(case, right, tmp_path, measure)['shrink'] < -0.5
    # The level of the noise counts once: as a part of the effect that names it.
    noisy = replace(case, effects={'excess_noise': 1.0}, seed=DEVELOPMENT.seed(1002))
    camera = BlindCamera(noisy.case)
    assert camera.sigma_factor < 0.9
    level = said('identified', ('excess_noise',))
    whole = camera.sigma_factor * camera.effects[0].parameters['factor']
    level['effects'][0]['parameters'] = {'factor': whole}
    assert realised_gap(noisy, level, tmp_path, measure)['shrink'] > 0.9
    # What is below the tolerance is measured as the diagnosis does it.
    weak = replace(case, effects={})
    assert realised_gap(weak, right, tmp_path, measure)['shrink'] == 0.5
