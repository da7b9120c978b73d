"""A set of effects, fitted around the simulation that has them: made-up features."""

from dataclasses import replace

from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.gap import rounds
from flexx2_sim_ros.gap.data.axes import AXES, axes_of
from flexx2_sim_ros.gap.features.catalogue import catalogue, Decaying
from flexx2_sim_ros.gap.features.evidence import Evidence
from flexx2_sim_ros.gap.features.features import LAYOUT, SIZE
from flexx2_sim_ros.gap.features.work import Simulator
from flexx2_sim_ros.gap.inference.effects import table_of
from flexx2_sim_ros.gap.inference.joint import around, nothing, Proposal, proposals
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.inference.selection import select, Trials
from flexx2_sim_ros.recording.truth import Accuracy
import numpy as np
import pytest

RECORDINGS = 6
PRIOR = np.array([0.01] * 3 + [0.5] * 3)
COLUMNS, CANDIDATES = catalogue()
BINS = max(axis.start + axis.bins for axis in AXES.values())


def candidate(effect, label=''):
    """Return a variant of the catalogue."""
    return next(one for one in CANDIDATES if (one.effect, one.label) == (effect, label))


def made(columns, shift, signals):
    """Return recordings whose gap is so many times the named columns, with noise of 0.01."""
    rng = np.random.default_rng(0)
    evidence = []
    for r in range(RECORDINGS):
        own = np.array([signals.get(one.name, np.zeros((RECORDINGS, SIZE)))[r] for one in columns])
        index = {one.name: i for i, one in enumerate(columns)}
        base = np.zeros(SIZE)
        real = base + sum(factor * own[index[name]] for name, factor in shift.items())
        nulls = rng.normal(0, 0.01, (4, SIZE))
        zeros = {
            'pose_columns': np.zeros((6, SIZE)),
            'edge_columns': np.zeros((2, SIZE)),
            'displaced': np.zeros(SIZE),
            'plane_columns': np.zeros((0, SIZE)),
            'truth_spread': np.zeros(SIZE),
            'pose': np.zeros(6),
            'sure_pose': np.zeros(6),
            'planes': np.zeros(0),
        }
        evidence.append(
            Evidence(
                name=f'{r}',
                real=real + rng.normal(0, 0.01, SIZE),
                base=base,
                noise=np.full(SIZE, 1e-4),
                nulls=nulls,
                columns=own.astype(np.float32),
                covariance=None,
                uptime=100.0 * (r + 1),
                step=1e-3,
                grain=rng.normal(size=(8, 8)).astype(np.float16),
                null_grain=rng.normal(size=(8, 8)).astype(np.float16),
                fingerprint=rng.normal(size=16).astype(np.float16),
                sigma=np.full(BINS, 0.01, np.float32),
                compared=10000,
                frames=10,
                moving=False,
                notes=(),
                axes=axes_of(flexx2()),
                accuracy=Accuracy(),
                checksum=f'{r}',
                **zeros,
            )
        )
    return Model(evidence, columns, PRIOR)


def signal(seed, channels, size):
    """Return (RECORDINGS, SIZE) of random numbers in some channels."""
    there = np.array([one.channel in channels for one in LAYOUT])
    values = np.random.default_rng(seed).normal(0, size, (RECORDINGS, SIZE))
    return np.where(there, values, 0.0)


def test_numbers_of_a_set_may_move_by_steps_within_their_bounds():
    named = {'offset': {'bias': 0.02}, 'quantisation': {}, 'random_dropout': {'share': 0.0}}
    effects = table_of(parse_effects(named))
    columns, members = around(effects, CANDIDATES)
    by_name = {one.name: one for one in columns}
    members_of = {one.name: one for one in members}
    offset = members_of['offset']
    assert by_name[offset.without].without == ('offset',)
    assert by_name[offset.without].effects == {}
    (term,) = offset.candidate.terms
    assert term.neutral == 0
    ((less, column), (more, _)) = term.nodes
    name = str(column)
    assert less < 0 < more
    assert by_name[name].effects['offset']['bias'] == pytest.approx(0.02 + less)
    assert by_name[name].without == ('offset',)
    assert offset.candidate.build((0.005,))['bias'] == pytest.approx(0.025)
    # The step between depths comes from their histogram, and is not fitted.
    assert members_of['quantisation'].candidate is None
    # A fraction cannot be less than nothing.
    share = members_of['random_dropout'].candidate
    assert share.terms[0].low == 0
    assert all(value > 0 for value, _ in share.terms[0].nodes)


def test_a_number_beyond_those_that_are_looked_for_moves_both_ways():
    # A lens that bends more than the catalogue has.
    (k1,) = (t for t in candidate('intrinsics_error', 'distortion').terms if t.name == 'k1')
    beyond = table_of(parse_effects({'intrinsics_error': {'k1': 1.25 * k1.high}}))
    _, (member,) = around(beyond, CANDIDATES)
    moved = next(term for term in member.candidate.terms if term.name == 'k1')
    ((less, _), *_) = moved.nodes
    assert less < 0 == moved.high
    assert moved.low < 0


def test_a_drift_is_nothing_where_the_uptime_is_not_known():
    name = COLUMNS[0].name
    model = made(COLUMNS[:4], {}, {name: signal(0, ('bias',), 1.0)})
    model.evidence[0] = replace(model.evidence[0], uptime=None)
    left = 2 * np.exp(-100.0 * np.arange(1, RECORDINGS + 1) / 300.0)
    left[0] = 0.0
    drift = model.column(Decaying(name, 2.0, 300.0))
    np.testing.assert_allclose(drift, model.column(name) * left[:, None], rtol=1e-5)


def test_what_explains_the_gap_is_added_and_nothing_else():
    bias, lost = candidate('offset'), candidate('random_dropout')
    other = candidate('heavy_tails')
    nodes = [node for one in (bias, lost, other) for term in one.terms for node in term.nodes]
    names = [str(name) for _, name in nodes]
    columns = [one for one in COLUMNS if one.name in names or one in COLUMNS[:4]]
    signals = {
        name: signal(k, ('bias',) if 'offset' in name else ('invalid', 'high'), 1.0)
        for k, name in enumerate(names)
    }
    true = {bias.terms[0].nodes[0][1]: 1.0, lost.terms[0].nodes[0][1]: 1.0}
    model = made(columns, {str(name): size for name, size in true.items()}, signals)
    some = proposals(model, nothing(model), [], [bias, lost, other])
    assert some[0].effects == {}
    assert set(some[-1].effects) == {'offset', 'random_dropout'}
    found = some[-1].effects['offset']['bias']
    assert found == pytest.approx(bias.terms[0].nodes[0][0], rel=0.05)
    for name in some[-1].effects:
        _, less = some[-1].less(name)
        assert set(less.effects) == set(some[-1].effects) - {name}
        assert less.loss > some[-1].loss
    assert len(some[-1].without) == RECORDINGS
    losses = [one.loss for one in some]
    assert losses == sorted(losses, reverse=True)


def test_what_the_others_make_unnecessary_is_taken_off():
    effects = table_of(parse_effects({'offset': {'bias': 0.02}, 'heavy_tails': {}}))
    columns, members = around(effects, CANDIDATES)
    columns = [*COLUMNS[:4], *columns]
    signals = {
        'offset: without': signal(1, ('bias',), 1.0),
        'heavy_tails: without': signal(2, ('kurtosis',), 1.0),
    }
    # Recordings look as if the camera had no heavy tails.
    model = made(columns, {'heavy_tails: without': 1.0}, signals)
    none = nothing(model)
    forms = {name: candidate(name) for name in effects}
    now = Proposal(effects, [effects] * RECORDINGS, none.motions, 0.0, 0.0, forms)
    some = proposals(model, now, members, [])
    assert some[0].effects == effects
    assert set(some[-1].effects) == {'offset'}
    assert some[-1].loss < some[0].loss


def chosen(model, candidates):
    """Return what is selected: terms by effect."""
    trials = Trials(model)
    one = select(trials, candidates, [trials.single(one) for one in candidates]).chosen.fit
    return {part.effect: [term.name for term in part.terms] for part in one.candidates}


def test_the_constant_of_a_bias_goes_by_the_name_of_an_offset_in_a_set():
    dark, offset = candidate('amplitude_bias', 'knee 1'), candidate('offset')
    (constant, _), (slope, _) = (term.nodes[0][::-1] for term in dark.terms)
    signals = {name: signal(k, ('bias',), 1.0) for k, name in enumerate((constant, slope))}
    both = made(COLUMNS, {constant: 1.0, slope: 2.0}, signals)
    assert chosen(both, [dark, offset]) == {'amplitude_bias': ['slope'], 'offset': ['bias']}
    alone = made(COLUMNS, {slope: 2.0}, signals)
    assert chosen(alone, [dark, offset]) == {'amplitude_bias': ['intercept', 'slope']}


def test_the_best_single_effect_is_chosen_where_none_is_sure():
    offset, lost = candidate('offset'), candidate('random_dropout')
    signals = {
        str(one.terms[0].nodes[0][1]): signal(k, ('bias',) if k else ('invalid', 'high'), 1.0)
        for k, one in enumerate((lost, offset))
    }
    names = list(signals)
    assert list(chosen(made(COLUMNS, {names[0]: 0.02}, signals), [offset, lost])) == [
        'random_dropout'
    ]
    both = made(COLUMNS, dict.fromkeys(names, 1.0), signals)
    assert set(chosen(both, [offset, lost])) == {'offset', 'random_dropout'}


@pytest.mark.parametrize(
    ('rise', 'kept'),
    [
        ([1.5, 0.5, 1.5, 0.5, 1.5, 0.5], True),
        ([0.3] * 6, False),  # too little of what is left
        ([6.0, -4.0, 6.0, -5.0, 6.0, -3.0], False),  # not sure
        ([9.0, 0.0, 0.0, 0.0, 0.0, 0.0], True),  # one recording shows it
        ([-1.0] * 6, False),
    ],
)
def test_effects_stay_that_simulations_need(rise, kept):
    rises = {
        'offset': np.full(RECORDINGS, 3.0),
        'heavy_tails': np.array(rise),
        'saturation': np.full(RECORDINGS, -5.0),
    }
    weak = rounds.unneeded(rises, 10.0)
    assert weak == ['saturation', *['heavy_tails'] * (not kept)]


@pytest.mark.parametrize('modulation', [True, False])
def test_what_is_in_a_set_is_not_simulated_a_second_time(monkeypatch, modulation):
    """Assert it with a lens, whose columns follow those of nuisances, and without frequencies."""
    columns, candidates = catalogue(modulation=modulation)
    seen = []

    def interrupted(*values, **_):
        seen.extend(values[3].columns)
        raise InterruptedError

    monkeypatch.setattr(rounds, 'summarise_all', interrupted)
    effects = {'intrinsics_error': {'focal': 0.01}}
    best = Proposal(effects, [effects], [np.zeros(6)], 0.0, 0.0, {})
    simulator = Simulator(map, None, {}, 0, tuple(PRIOR), columns)
    with pytest.raises(InterruptedError):
        rounds.Campaign('', [], candidates, simulator, None).proposed(best)
    again = [one.name for one in seen if set(one.effects) & set(effects) and not one.without]
    assert seen
    assert not again
