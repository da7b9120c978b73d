"""
Every constant of the diagnosis: value, unit, meaning, and what it comes from.

Nothing else in ``gap/`` is tuned. What belongs to one effect (the values that are simulated of
it, how much it is doubted) is in that effect's own file.

Most values were chosen by hand while `DEVELOPMENT` was run on seeds below 100, until campaigns
without an effect gave ``none`` and those with one named it; the tables of these runs were not
kept. A value of which no trial is on record is `ASSUMED`. `DEFINITION` marks what only fixes a
resolution or a unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeVar

T = TypeVar('T')
DEVELOPMENT = 'python -m bench.gap_development --seeds <below 100>; by hand, tables not kept'
FIRST_RELEASE = (
    'raised from 4.5 after flexx2 gap benchmark --seed-set test --release of commit e3bc15f '
    '(docs/benchmark_e3bc15f.md), new test seeds were drawn after that'
)
ASSUMED = 'assumed; no trial is on record'
DEFINITION = 'definition'


def _constant(value: T, unit: str, meaning: str, source: str = ASSUMED) -> T:
    about = {'unit': unit, 'meaning': meaning, 'source': source}
    return field(default=value, metadata=about)


def _table(values: Mapping[str, T], unit: str, meaning: str, source: str) -> Mapping[str, T]:
    about = {'unit': unit, 'meaning': meaning, 'source': source}
    return field(default_factory=lambda: MappingProxyType(dict(values)), metadata=about)


@dataclass(frozen=True)
class Reading:
    """Which frames are read, and which units a file may have."""

    most_frames: int = _constant(48, 'frames', 'a longer recording is read in segments')
    segment: int = _constant(12, 'frames', 'length of a segment')
    chunk: int = _constant(32, 'frames', 'read at a time', DEFINITION)
    brightest: float = _constant(2.0, '', 'a larger reflectivity is in another unit')
    longest_uptime: float = _constant(1e6, 's', 'a longer uptime is an error')
    near_1000: float = _constant(0.7, 'ln', 'a ratio this near 1000 means millimetres')
    reflectivities: tuple[float, float] = _constant(
        (1e-3, 100.0), '', 'median reflectivity that an amplitude image may mean'
    )


@dataclass(frozen=True)
class Registration:
    """How a recording's small pose error is found."""

    rounds: int = _constant(3, '', 'times that the clean depth is moved and the rest fitted')
    frames: int = _constant(6, 'frames', 'of a moving scene that are compared')
    lead: int = _constant(3, 'frames', 'left out at the start: the scene before is unknown')
    late: float = _constant(
        0.03, 's', 'step of the time offset; large enough to be told from pose'
    )
    latest: float = _constant(0.1, 's', 'largest time offset')
    outlier_sigmas: float = _constant(
        8.0, 'sigma_z', 'a larger error, beyond outlier, is left out'
    )
    outlier: float = _constant(0.02, 'm', 'added to that')
    iterations: int = _constant(8, '', 'of reweighted least squares')
    scales: tuple[float, float, float] = _constant(
        (3.0, 0.6, 0.5), 'sigma_z', 'of the loss: at first, factor for each iteration, at last'
    )
    ridge: float = _constant(0.003, '', 'weight of the priors, as a fraction of the pixels')
    bound: float = _constant(3.0, 'standard deviations', 'largest pose error')
    sure: float = _constant(10.0, '', 'stiffer prior for the part of a pose that is beyond doubt')
    smooth: tuple[float, float, float] = _constant(
        (0.01, 0.01, 0.002), 'm', 'size of a bias along the ray, the axis, with log distance'
    )
    harmonic: float = _constant(0.004, 'm', 'size of the fourth harmonic of each frequency')
    same_surface: float = _constant(0.1, 'fraction of depth', 'largest change by a time offset')
    amounts: float = _constant(2.0, '', 'prior spread of how much there is of a typical effect')
    steps: tuple[float, ...] = _constant(
        (0.002, 0.002, 0.002, 0.1, 0.1, 0.2),
        'm, deg',
        'unit in which poses are fitted',
        DEFINITION,
    )
    limits: tuple[float, ...] = _constant(
        (0.15, 0.15, 0.15, 8.0, 8.0, 8.0), 'm, deg', 'largest pose error that is simulated'
    )


@dataclass(frozen=True)
class GroundTruth:
    """What is not known of the ground truth: filled, tolerated, fitted, measured by people."""

    continued: int = _constant(12, 'px', 'a surface is continued with its slope into the unknown')
    inverse_depths: tuple[float, float] = _constant(
        (0.5, 2.0), 'of that at the border', 'limits of 1/depth of a continued surface'
    )
    narrow: int = _constant(3, 'px', 'an unknown area at least this wide may hide an object')
    reach: float = _constant(2.0, 'clean_sigma', 'a difference within is no gap')
    plane_steps: tuple[float, float, float] = _constant(
        (0.002, 1.75e-3, 1.75e-3), 'm, rad', 'unit in which planes are fitted', DEFINITION
    )
    plane_floor: float = _constant(0.25, 'plane steps', 'to which a plane is known at best')
    least_cosine: float = _constant(0.02, '', 'of a ray to a normal; below, a plane is edge-on')
    fixed: float = _constant(1e-12, 'variance', 'of the largest; a direction is fixed', DEFINITION)
    margin: float = _constant(
        1.5, '', 'factor on the loss of a finding that a decidable effect must leave'
    )
    scales: tuple[float, ...] = _constant(
        (6.0, 1.0, 1.0), 'feature scales', 'of the loss when only nuisances are fitted'
    )
    tape: float = _constant(0.003, 'm', 'standard deviation of a tape measure')
    laser: float = _constant(0.001, 'm', 'the same of a laser distance meter')
    square: float = _constant(5.2e-3, 'rad', 'the same of a set square, 0.3 degrees')
    pose: tuple[float, ...] = _constant(
        (0.001, 0.001, 0.001, 0.1, 0.1, 0.1), 'm, deg', 'the same of a pose from a board or scan'
    )


@dataclass(frozen=True)
class Binning:
    """Bins of the covariates, and which pixels count as surface."""

    distance_edges: int = _constant(11, '', 'number of edges of geometric bins', DEFINITION)
    farthest_share: float = _constant(0.8, "the camera's longest range", 'last edge', DEFINITION)
    nearest_share: float = _constant(1.5, "the camera's shortest range", 'first edge', DEFINITION)
    span: float = _constant(56 / 3, '', 'last over first edge, at most', DEFINITION)
    incidences: tuple[float, ...] = _constant(
        (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 68.0, 75.0), 'deg', 'edges of bins', DEFINITION
    )
    radii: tuple[float, ...] = _constant(
        (0.2, 0.4, 0.55, 0.7, 0.85), 'half diagonals', 'edges of bins', DEFINITION
    )
    amplitudes: tuple[float, float, int] = _constant(
        (-6.0, 0.75, 13), 'ln 1/m^2', 'first edge, step and number of edges', DEFINITION
    )
    concavities: tuple[float, ...] = _constant(
        (-0.02, -0.005, 0.005, 0.02, 0.05), 'fraction of distance', 'edges of bins', DEFINITION
    )
    speeds: tuple[float, ...] = _constant(
        (-0.8, -0.4, -0.15, -0.03, 0.03, 0.15, 0.4, 0.8), 'm/s', 'edges of bins', DEFINITION
    )
    tiles: tuple[int, int] = _constant((22, 28), '', 'rows and columns of tiles', DEFINITION)
    fine_a_period: float = _constant(
        31.2, '', 'fine bins in c / 2f of the highest frequency: 8 a fourth harmonic', DEFINITION
    )
    fine_bins: int = _constant(64, '', 'number of fine bins', DEFINITION)
    edge_reach: int = _constant(3, 'px', 'from a jump, looked at as edge')
    near_jump: int = _constant(5, 'px', 'from a jump, not looked at as surface: lateral noise')
    crease: float = _constant(0.004, 'fraction of 1/depth', 'second difference of a sharp bend')
    near_crease: int = _constant(3, 'px', 'from a sharp bend, not looked at as surface')
    same_surface: float = _constant(0.1, 'fraction of depth', 'largest change between frames')
    bend: float = _constant(0.3, 'fraction of 1/depth', 'a larger change is another surface')
    bend_step: int = _constant(28, '', 'the width over this is the reach of concavity', DEFINITION)
    beyond: float = _constant(1.1, 'range_max', 'farther is beyond the range')


@dataclass(frozen=True)
class Features:
    """From what size on a difference of a feature matters, and how many samples it takes."""

    tolerances: Mapping[str, float] = _table(
        {
            'bias': 0.10,
            'invalid': 0.008,
            'high': 0.004,
            'low': 0.004,
            'log_variance': 0.10,
            'kurtosis': 0.05,
            'lag': 0.04,
            'neighbour': 0.04,
            'trend': 0.15,
            'frame_common': 0.01,
            'row_common': 0.01,
            'column_common': 0.01,
            'row_invalid': 0.004,
            'static_grain': 0.015,
            'static_rows': 0.004,
            'static_columns': 0.004,
            'static_neighbour': 0.04,
            'frame_spread': 0.04,
            'lattice_coarse': 0.5,
            'lattice_medium': 0.5,
            'lattice_small': 0.5,
            'lattice_fine': 0.5,
            'repeat': 0.08,
        },
        "each channel's own",
        'differences below do not matter (equivalence margins)',
        ASSUMED,
    )
    enough: int = _constant(150, 'samples', 'a bin with fewer is unknown')
    enough_alike: int = _constant(12, 'samples', 'the same with common random numbers')
    structure_noise: float = _constant(
        0.3, 'tolerances', 'standard deviation of features that are not binned'
    )
    gross: float = _constant(6.0, 'sigma_z', 'a larger error is gross, and clipped', DEFINITION)
    gross_change: float = _constant(8.5, 'sigma_z', 'limit of the difference of two errors')
    jump: float = _constant(0.25, 'm', 'a larger gross error is another surface')
    lattice_bin: float = _constant(1e-4, 'm', 'histogram of depths', DEFINITION)
    lattice_range: float = _constant(7.5, 'm', 'its range', DEFINITION)
    lattice_steps: Mapping[str, tuple[float, float]] = _table(
        {
            'lattice_coarse': (0.006, 0.02),
            'lattice_medium': (0.003, 0.006),
            'lattice_small': (0.0015, 0.003),
            'lattice_fine': (0.0006, 0.0015),
        },
        'm',
        'ranges of the step in which depth comes; its multiples show in longer ranges',
        DEFINITION,
    )
    lattice_noise: float = _constant(3e-4, '', 'added to a spectrum before its logarithm')
    lattice_harmonic: float = _constant(0.8, '', 'a longer step with this much of the peak wins')
    same_noise: float = _constant(
        0.5,
        'correlation',
        'of one noise; cameras are below 0.1, one noise on two scenes above 0.9',
    )
    same_noise_samples: int = _constant(4096, 'px', 'whose noise is compared', DEFINITION)
    same_noise_fewest: int = _constant(100, 'px', 'fewer are not compared')


@dataclass(frozen=True)
class Measures:
    """Resolution of the gap in physical units."""

    bin_mm: float = _constant(0.5, 'mm', 'histogram of depth errors', DEFINITION)
    half: int = _constant(300, 'bins', 'of it on either side of zero', DEFINITION)
    normal: int = _constant(60, 'bins', 'of errors from -6 to 6 sigma_z', DEFINITION)
    fewest: int = _constant(50, 'px', 'a histogram or bin with fewer is left out')
    every: int = _constant(3, 'frames', 'one of these is counted', DEFINITION)


@dataclass(frozen=True)
class Simulation:
    """How often and how long a recording's scene is simulated."""

    null_seeds: int = _constant(4, '', 'simulations without effects: mean and noise of features')
    confirm_seeds: int = _constant(2, '', 'simulations of the outcome')
    few: tuple[int, int] = _constant(
        (8, 5), 'frames', 'of a still scene, and of each of two stretches of a moving one'
    )
    fewest: tuple[int, int] = _constant(
        (4, 3), 'frames', 'the same for a bias or a loss, which add no noise'
    )
    settling: int = _constant(2, 'frames', 'left out after a gap: filters settle')
    pooled: tuple[float, float] = _constant(
        (0.5, 0.25), '', 'weight of the analytic variance, and its least fraction'
    )
    edge_error: float = _constant(0.4, 'px', 'error of where edges are')


@dataclass(frozen=True)
class Loss:
    """Weights of features and priors of nuisances."""

    structure_weight: float = _constant(3.0, '', 'of a feature that is not binned')
    noise_factor: float = _constant(2.0, '', 'on the variance of features')
    mismatch: float = _constant(
        0.25,
        'fraction of the shift',
        'by which the number of lost or gross pixels may differ from an effect: its onset is '
        'only a form that fits',
        ASSUMED,
    )
    pose_weight: float = _constant(0.5, 'loss', "of the logarithm of the poses' spread")
    pose_floor: tuple[float, ...] = _constant(
        (0.25, 0.25, 0.25, 0.3, 0.3, 0.15), 'pose steps', 'a smaller spread costs nothing'
    )
    brightness_weight: float = _constant(1.5, 'loss', "of a recording's relative brightness")
    edge_weight: float = _constant(0.5, 'loss', "of a recording's shift of edges")
    edge_shift: float = _constant(0.4, 'px', 'unit of that shift')
    edges_moved: float = _constant(
        6.0, '', 'factor on the variance of edges at poses as wrong as usual', ASSUMED
    )
    sigma_spread: float = _constant(0.05, 'fraction', 'usual error of the base sigma_z')
    sigma_weight: float = _constant(0.8, 'loss', 'of such an error')
    sigma_bound: float = _constant(
        0.16, 'fraction', 'largest error; below 0.15 it is no finding', ASSUMED
    )
    scales: tuple[float, ...] = _constant(
        (20.0, 6.0, 2.0, 1.0, 1.0, 1.0), 'feature scales', 'of the loss, from step to step'
    )
    scales_from_value: tuple[float, ...] = _constant(
        (3.0, 1.0, 1.0), 'feature scales', 'the same from a simulated value'
    )
    ridge: float = _constant(1e-6, '', 'on the scaled matrix: columns may be almost alike')
    nuisance_steps: int = _constant(2, '', 'steps of the last fit of nuisances')


@dataclass(frozen=True)
class Thresholds:
    """From when on an effect is a finding. Losses and gains are per recording."""

    gap: float = _constant(5.5, 'loss', 'excess loss of a gap', FIRST_RELEASE)
    floor: float = _constant(
        4.0, 'loss', 'that errors of pose and reflectivity leave above noise', DEVELOPMENT
    )
    gain: float = _constant(1.0, 'loss', 'an effect that takes off this is found', DEVELOPMENT)
    least_gain: float = _constant(
        0.5, 'loss', 'enough if recordings agree or the gap is beyond doubt', DEVELOPMENT
    )
    agree: float = _constant(0.97, 'confidence', 'recordings agree', DEVELOPMENT)
    beyond_doubt: float = _constant(2.0, 'gaps', 'a gap beyond doubt', DEVELOPMENT)
    next_gain: float = _constant(1.5, 'loss', 'the next effect must take off', DEVELOPMENT)
    next_fraction: float = _constant(
        0.04, 'excess loss', 'as well; half of it below explained_little', DEVELOPMENT
    )
    explained_little: float = _constant(0.5, 'excess loss', 'see next_fraction', DEVELOPMENT)
    most_effects: int = _constant(6, '', 'that are named together')
    term_cost: float = _constant(0.5, 'loss', 'of each fitted parameter', DEVELOPMENT)
    pose_terms: int = _constant(2, '', 'parameters that a common pose error counts for, besides')
    weak_cost: float = _constant(
        0.25, 'loss', 'of each factor of e below 1 / weak of the typical strength', DEVELOPMENT
    )
    weak: float = _constant(2.5, '', 'see weak_cost', DEVELOPMENT)
    filtered: tuple[float, float] = _constant(
        (0.8, 1.5), '', 'filter and noise to start from when both are fitted'
    )
    filter_gain: float = _constant(2.0, '', 'factor on the gain for a filter with noise')
    scattered: float = _constant(
        0.48, 'usual spread', 'poses that scatter more are a finding', DEVELOPMENT
    )
    next_to_scattered: float = _constant(
        0.15, 'excess loss', 'next_fraction with scattered poses, which leave edges', DEVELOPMENT
    )
    unknown: float = _constant(
        0.08, 'excess loss', 'effects that explain less are not named', DEVELOPMENT
    )
    partly: float = _constant(0.5, 'excess loss', 'more left than this is partly explained')
    alternative: float = _constant(0.8, 'gain', 'a rival with this much is an alternative')
    sure: float = _constant(0.95, 'confidence', 'unless the chosen one is better for sure')
    most_alternatives: int = _constant(5, '', 'that are listed')
    nearest: int = _constant(3, '', 'that are listed if nothing explains the gap')
    quantile: float = _constant(0.95, '', 'upper end of 90 % intervals', DEFINITION)
    least_error: float = _constant(0.25, 'loss', 'of a mean difference of few recordings')


@dataclass(frozen=True)
class Where:
    """How differences are located."""

    most: int = _constant(60, 'rows', 'that are listed')
    degrees: int = _constant(100, '', 'of freedom of the noise of features')
    all_over: float = _constant(0.85, 'fraction of pixels', 'a difference in more is everywhere')
    false_discoveries: float = _constant(0.1, 'rate', 'of listed differences')
    besides: float = _constant(1.2, '', 'power along another covariate that is listed, too')
    selective: float = _constant(0.5, 'fraction', 'of such a covariate that may differ')
    cuts: Mapping[str, float] = _table(
        {
            'all': 1.0,
            'distance': 0.9,
            'incidence': 0.9,
            'radius': 0.9,
            'region': 0.8,
            'log_amplitude': 0.9,
            'fine_distance': 0.8,
            'recording': 0.5,
        },
        'factor',
        'on the power of differences along a covariate: finer ones must do better',
        ASSUMED,
    )
    most_conditions: int = _constant(3, '', 'covariates that select pixels')
    worth: Mapping[str, float] = _table(
        {
            'all': 0.0,
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
    distances: float = _constant(5.0, 'm', 'farther pixels are in the last group', DEFINITION)
    groups: tuple[int, ...] = _constant(
        (6, 4, 12, 2, 2), '', 'groups by distance, incidence, region, edge, dark', DEFINITION
    )
    steep: tuple[float, ...] = _constant((20.0, 45.0, 65.0), 'deg', 'incidences', DEFINITION)
    dark: float = _constant(0.2, 'reflectivity', 'below is dark', DEFINITION)
    samples: int = _constant(12, 'px', 'of each group whose covariates are kept', DEFINITION)
    pixels: tuple[int, int] = _constant((75, 300), 'px', 'of a group: a frame, in all')
    standard_errors: float = _constant(4.0, '', 'a smaller difference is noise')
    deviation: float = _constant(1.5, 'ln', 'standard deviation of one log squared error')
    edge_pixels: int = _constant(12, 'px', 'of an edge count for one: it moves as a whole')
    least_variance: float = _constant(1e-4, 'sigma_z^2', 'below, correlations are unknown')
    others: float = _constant(0.05, 'of what is left', 'a channel with less is not listed')


READING = Reading()
REGISTRATION = Registration()
GROUND_TRUTH = GroundTruth()
BINNING = Binning()
FEATURES = Features()
MEASURES = Measures()
SIMULATION = Simulation()
LOSS = Loss()
THRESHOLDS = Thresholds()
WHERE = Where()
SECTIONS = (
    READING,
    REGISTRATION,
    GROUND_TRUTH,
    BINNING,
    FEATURES,
    MEASURES,
    SIMULATION,
    LOSS,
    THRESHOLDS,
    WHERE,
)
