"""Weights of the fit, thresholds of the verdict, and how differences are located."""

from collections.abc import Mapping
from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.about import (
    ASSUMED,
    constant,
    DEFINITION,
    DEVELOPMENT,
    FIRST_RELEASE,
    MANY,
    table,
)


@dataclass(frozen=True)
class Loss:
    """Weights of features and priors of nuisances."""

    structure_weight: float = constant(3.0, '', 'of a feature that is not binned')
    noise_factor: float = constant(2.0, '', 'on the variance of features')
    mismatch: float = constant(
        0.25,
        'fraction of the shift',
        'by which the number of lost or gross pixels may differ from an effect: its onset is '
        'only a form that fits',
        ASSUMED,
    )
    pose_weight: float = constant(0.5, 'loss', "of the logarithm of the poses' spread")
    pose_floor: tuple[float, ...] = constant(
        (0.25, 0.25, 0.25, 0.3, 0.3, 0.15), 'pose steps', 'a smaller spread costs nothing'
    )
    brightness_weight: float = constant(1.5, 'loss', "of a recording's relative brightness")
    edge_weight: float = constant(0.5, 'loss', "of a recording's shift of edges")
    edge_shift: float = constant(0.4, 'px', 'unit of that shift')
    edges_moved: float = constant(
        6.0, '', 'factor on the variance of edges at poses as wrong as usual', ASSUMED
    )
    sigma_spread: float = constant(0.05, 'fraction', 'usual error of the base sigma_z')
    sigma_weight: float = constant(0.8, 'loss', 'of such an error')
    sigma_bound: float = constant(
        0.16, 'fraction', 'largest error; below 0.15 it is no finding', ASSUMED
    )
    scales: tuple[float, ...] = constant(
        (20.0, 6.0, 2.0, 1.0, 1.0, 1.0), 'feature scales', 'of the loss, from step to step'
    )
    scales_from_value: tuple[float, ...] = constant(
        (3.0, 1.0, 1.0), 'feature scales', 'the same from a simulated value'
    )
    ridge: float = constant(1e-6, '', 'on the scaled matrix: columns may be almost alike')
    nuisance_steps: int = constant(2, '', 'steps of the last fit of nuisances')


@dataclass(frozen=True)
class Thresholds:
    """
    How effects are selected. Losses and gains are per recording.

    From when on there is a gap and effects are named: ``config/decisions.yaml``.
    """

    gap: float = constant(
        5.5,
        'excess loss',
        'that an effect must cause, so that a plan of recordings does not call it unseen; below '
        'it there is no gap whose reduction `measure` could give; the verdict does not use it',
        FIRST_RELEASE,
    )
    floor: float = constant(
        4.0, 'loss', 'that errors of pose and reflectivity leave above noise', DEVELOPMENT
    )
    gain: float = constant(
        1.0, 'loss', 'that a decidable effect must leave, and the tolerance of checks', DEVELOPMENT
    )
    next_gain: float = constant(1.5, 'loss', 'the next effect must take off', DEVELOPMENT)
    term_cost: float = constant(0.5, 'loss', 'of each fitted parameter', DEVELOPMENT)
    pose_terms: int = constant(2, '', 'parameters that a common pose error counts for, besides')
    weak_cost: float = constant(
        0.25, 'loss', 'of each factor of e below 1 / weak of the typical strength', DEVELOPMENT
    )
    weak: float = constant(2.5, '', 'see weak_cost', DEVELOPMENT)
    scattered: float = constant(
        0.6, 'usual spread', 'poses that scatter more are a finding', DEVELOPMENT
    )
    scattered_alone: float = constant(
        0.55,
        'usual spread',
        'the same where no effect is found; of poses wrong by 5 mm, none of 89 scatter more',
        DEVELOPMENT,
    )
    common_pose: float = constant(
        0.05,
        'probability',
        'that scatter alone has poses taken to have something in common: a bias that they took '
        'over; docs/diagnosis_evidence.md, "What it predicts"',
        DEVELOPMENT,
    )
    unknown: float = constant(
        0.08, 'excess loss', 'effects that explain less are not named', DEVELOPMENT
    )
    partly: float = constant(0.5, 'excess loss', 'more left than this is partly explained')
    identified: float = constant(
        0.8, 'of the gap', 'that effects must close, simulated, to be the cause', DEFINITION
    )
    larger: float = constant(
        0.1,
        '',
        'effects that, simulated, make the gap larger by more than this are not named',
        'python -m bench.gap_larger of aac5156: no effect of such a campaign was a true one',
    )
    varies: float = constant(
        0.1,
        '',
        'an effect whose form varies less in the recordings acts like a constant',
        'python -m bench.gap_flat of aac5156: 0.157 or more of the cause itself, 0.057 or less of '
        'an amplitude_bias in the place of an offset',
    )
    likely: float = constant(0.5, '', 'a less probable effect explains a gap partly', DEFINITION)
    alternative: float = constant(
        0.8, 'gain', 'an undecided effect with this much may be the cause as well'
    )
    most_t: float = constant(10.0, '', "larger values of Student's t say no more", DEFINITION)
    most_alternatives: int = constant(5, '', 'that are listed')
    quantile: float = constant(0.95, '', 'upper end of 90 % intervals', DEFINITION)
    least_shrink: float = constant(
        -1.0,
        'fraction',
        'a gap that more than doubles is written like one that doubles',
        DEFINITION,
    )
    least_error: float = constant(0.25, 'loss', 'of a mean difference of few recordings')


@dataclass(frozen=True)
class Rounds:
    """How a set of effects is fitted around the simulation that has them."""

    most: int = constant(5, '', 'rounds')
    first: int = constant(10, '', 'effects that the first round adds')
    added: int = constant(3, '', 'effects that another one adds')
    scale: float = constant(
        3.0,
        '',
        'factor on the scale of the loss: at the scale of a tolerance, forms that are a little '
        'wrong make an outlier of everything',
        MANY,
    )
    gain: float = constant(0.4, 'loss', 'that an effect must take off to be added', MANY)
    kept: float = constant(0.5, '', 'of the loss that adds an effect: what keeps it')
    t: float = constant(
        0.7, '', 'over recordings, of such gains; one recording that shows it gives 1', MANY
    )
    step: float = constant(0.25, 'of the value', 'by which a number is changed')
    least_step: float = constant(0.05, 'of the usual value', 'likewise')
    reach: float = constant(2.0, 'steps', 'that a number may move in a round')
    as_near: float = constant(0.1, 'of the distance', 'within which the loss decides', MANY)
    nearer: float = constant(0.02, 'of the distance', 'within which the loss decides at last')
    least: float = constant(
        0.04, 'of what is left', 'that an effect takes off beside the others', MANY
    )
    sure: float = constant(
        0.95,
        '',
        't over recordings, of that; one recording that shows it gives 1',
        'test_gap_search.py: 0.9 of an offset beside a depth scale; python -m bench.gap_many: '
        '1.0 of true effects',
    )
    true: float = constant(0.8, '', 'probability that is given to effects that rounds add')


@dataclass(frozen=True)
class Unlike:
    """From when on recordings disagree: some have an effect that the others lack."""

    gain: float = constant(
        20.0,
        'loss',
        'a recording, that two sides take off beyond one',
        'python -m bench.gap_many --count 4,8 --seeds 1-5 names none; test_gap_disagreement.py: '
        'filters in half of the recordings; by hand between 11 of those and 38 of these',
    )
    each: float = constant(5.0, 'loss', 'by which each recording is on its side', MANY)
    tried: int = constant(6, '', 'effects')
    rounds: int = constant(4, '', 'in which recordings change sides')


@dataclass(frozen=True)
class OtherMode:
    """From when on the noise is rather that of another mode of the camera."""

    gain: float = constant(
        0.4,
        'loss',
        'a recording, of noise over distance',
        'by hand, recordings of test_gap_disagreement.py: 0.6 to 1.1 of other modes, at most 0.2 '
        'of effects; none in ten cameras of python -m bench.gap_many --count 4,8,12',
    )
    t: float = constant(1.2, '', 'over recordings, of that', MANY)
    slant: float = constant(30.0, 'deg', 'of surfaces, at which modes are compared')
    factors: tuple[float, float, int] = constant(
        (-2.0, 2.0, 81), 'ln', 'factors on the variance that have other causes', DEFINITION
    )


@dataclass(frozen=True)
class Where:
    """How differences are located."""

    degrees: int = constant(100, '', 'of freedom of the noise of features')
    false_discoveries: float = constant(0.1, 'rate', 'of listed differences')
    uptimes: tuple[float, ...] = constant(
        (30.0, 120.0, 450.0, 1200.0), 's', 'limits of intervals of uptime', DEFINITION
    )
    most_conditions: int = constant(3, '', 'covariates that select pixels')
    worth: Mapping[str, float] = table(
        {
            'all': 0.0,
            'uptime': 0.02,
            'speed': 0.02,
            'distance': 0.02,
            'incidence': 0.02,
            'radius': 0.02,
            'edge': 0.02,
            'log_amplitude': 0.02,
            'region': 0.03,
            'recording': 0.03,
            'fine_distance': 0.03,
        },
        'intersection over union',
        'that a covariate must add',
        ASSUMED,
    )
    distances: float = constant(5.0, 'm', 'farther pixels are in the last group', DEFINITION)
    groups: tuple[int, ...] = constant(
        (6, 4, 12, 2, 2), '', 'groups by distance, incidence, region, edge, dark', DEFINITION
    )
    steep: tuple[float, ...] = constant((20.0, 45.0, 65.0), 'deg', 'incidences', DEFINITION)
    dark: float = constant(0.2, 'reflectivity', 'below is dark', DEFINITION)
    samples: int = constant(12, 'px', 'of each group whose covariates are kept', DEFINITION)
    pixels: tuple[int, int] = constant((75, 300), 'px', 'of a group: a frame, in all')
    standard_errors: float = constant(4.0, '', 'a smaller difference is noise')
    deviation: float = constant(1.5, 'ln', 'standard deviation of one log squared error')
    edge_pixels: int = constant(12, 'px', 'of an edge count for one: it moves as a whole')
    least_variance: float = constant(1e-4, 'sigma_z^2', 'below, correlations are unknown')
    others: float = constant(0.05, 'of what is left', 'a channel with less is not listed')


LOSS = Loss()
THRESHOLDS = Thresholds()
WHERE = Where()
ROUNDS = Rounds()
UNLIKE = Unlike()
MODE = OtherMode()
