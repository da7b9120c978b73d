"""What recordings must be like, how they are registered, and the bins of their covariates."""

from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.about import ASSUMED, constant, DEFINITION


@dataclass(frozen=True)
class Reading:
    """Which frames are read, and which units a file may have."""

    most_frames: int = constant(48, 'frames', 'a longer recording is read in segments')
    most_small: int = constant(480, 'frames', 'the same for images of few pixels')
    pixels: int = constant(400_000, 'px', 'up to so many in all, a recording is read whole')
    segment: int = constant(12, 'frames', 'length of a segment')
    chunk: int = constant(32, 'frames', 'read at a time', DEFINITION)
    brightest: float = constant(2.0, '', 'a larger reflectivity is in another unit')
    longest_uptime: float = constant(1e6, 's', 'a longer uptime is an error')
    outside_range: float = constant(0.01, 'fraction', 'of valid depths that is noted')
    reflectivities: tuple[float, float] = constant(
        (1e-3, 100.0), '', 'median reflectivity that an amplitude image may mean'
    )
    longest_delay: float = constant(
        1.0,
        's',
        'frames that arrive later have another clock; largest `TimeOffset.delay`',
        DEFINITION,
    )
    arrivals: tuple[float, float, float] = constant(
        (0.05, 0.5, 0.95), '', 'quantiles of the delay that are told', DEFINITION
    )


@dataclass(frozen=True)
class Registration:
    """How a recording's small pose error is found."""

    rounds: int = constant(3, '', 'times that the clean depth is moved and the rest fitted')
    frames: int = constant(6, 'frames', 'of a moving scene that are compared')
    lead: int = constant(3, 'frames', 'left out at the start: the scene before is unknown')
    late: float = constant(0.03, 's', 'step of the time offset; large enough to be told from pose')
    latest: float = constant(0.25, 's', 'largest time offset')
    outlier_sigmas: float = constant(8.0, 'sigma_z', 'a larger error, beyond outlier, is left out')
    outlier: float = constant(0.02, 'm', 'added to that')
    iterations: int = constant(8, '', 'of reweighted least squares')
    scales: tuple[float, float, float] = constant(
        (3.0, 0.6, 0.5),
        'standard deviations',
        'of the loss: at first, factor for each iteration, at last',
    )
    ridge: float = constant(0.003, '', 'weight of the priors, as a fraction of pixels and jumps')
    fewest: float = constant(16.0, '', 'one of so many pixels counts for it at least')
    bound: float = constant(3.0, 'standard deviations', 'largest pose error')
    sure: float = constant(3.0, '', 'stiffer prior for the part of a pose that is beyond doubt')
    smooth: tuple[float, float, float] = constant(
        (0.01, 0.01, 0.002), 'm', 'size of a bias along the ray, the axis, with log distance'
    )
    harmonic: float = constant(0.004, 'm', 'size of the fourth harmonic of each frequency')
    same_surface: float = constant(0.1, 'fraction of depth', 'largest change by a time offset')
    amounts: float = constant(2.0, '', 'prior spread of how much there is of a typical effect')
    jump_reach: int = constant(28, '', 'image width over pixels on a side of a jump', DEFINITION)
    jump_side: int = constant(2, 'px', 'to both rows that tell its direction', DEFINITION)
    jump_sigmas: float = constant(8.0, 'sigma_z', 'a larger jump is seen in single pixels')
    jump_error: float = constant(
        1.0, 'px', 'standard deviation of a jump in one row; neighbours round alike'
    )
    jump_growth: float = constant(0.5, 'px', 'by which all surfaces in front may look larger')
    steps: tuple[float, ...] = constant(
        (0.002, 0.002, 0.002, 0.1, 0.1, 0.2),
        'm, deg',
        'unit in which poses are fitted',
        DEFINITION,
    )
    limits: tuple[float, ...] = constant(
        (0.15, 0.15, 0.15, 8.0, 8.0, 8.0), 'm, deg', 'largest pose error that is simulated'
    )


@dataclass(frozen=True)
class GroundTruth:
    """What is not known of the ground truth: filled, tolerated, fitted, measured by people."""

    continued: int = constant(12, 'px', 'a surface is continued with its slope into the unknown')
    inverse_depths: tuple[float, float] = constant(
        (0.5, 2.0), 'of that at the border', 'limits of 1/depth of a continued surface'
    )
    narrow: int = constant(3, 'px', 'an unknown area at least this wide may hide an object')
    whole_margins: int = constant(
        56, 'px', 'images with a smaller side have smaller margins around the unknown'
    )
    reach: float = constant(2.0, 'clean_sigma', 'a difference within is no gap')
    plane_steps: tuple[float, float, float] = constant(
        (0.002, 1.75e-3, 1.75e-3), 'm, rad', 'unit in which planes are fitted', DEFINITION
    )
    plane_floor: float = constant(0.25, 'plane steps', 'to which a plane is known at best')
    least_cosine: float = constant(0.02, '', 'of a ray to a normal; below, a plane is edge-on')
    fixed: float = constant(1e-12, 'variance', 'of the largest; a direction is fixed', DEFINITION)
    margin: float = constant(
        1.5, '', 'factor on the loss of a finding that a decidable effect must leave'
    )
    scales: tuple[float, ...] = constant(
        (6.0, 1.0, 1.0), 'feature scales', 'of the loss when only nuisances are fitted'
    )
    usual: tuple[float, float] = constant(
        (0.010, 0.5), 'm, deg', 'the same of a pose of which nothing is stated', ASSUMED
    )
    fewest_poses: int = constant(3, '', 'that say how much poses scatter', DEFINITION)
    least_scatter: tuple[float, float] = constant(
        (0.0005, 0.03), 'm, deg', 'what features can tell of a pose', DEFINITION
    )
    tape: float = constant(0.003, 'm', 'standard deviation of a tape measure')
    laser: float = constant(0.001, 'm', 'the same of a laser distance meter')
    square: float = constant(5.2e-3, 'rad', 'the same of a set square, 0.3 degrees')
    pose: tuple[float, ...] = constant(
        (0.001, 0.001, 0.001, 0.1, 0.1, 0.1), 'm, deg', 'the same of a pose from a board or scan'
    )


@dataclass(frozen=True)
class Binning:
    """Bins of the covariates, and which pixels count as surface."""

    distance_edges: int = constant(11, '', 'number of edges of geometric bins', DEFINITION)
    farthest_share: float = constant(0.8, "the camera's longest range", 'last edge', DEFINITION)
    nearest_share: float = constant(1.5, "the camera's shortest range", 'first edge', DEFINITION)
    span: float = constant(56 / 3, '', 'last over first edge, at most', DEFINITION)
    incidences: tuple[float, ...] = constant(
        (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 68.0, 75.0), 'deg', 'edges of bins', DEFINITION
    )
    radii: tuple[float, ...] = constant(
        (0.2, 0.4, 0.55, 0.7, 0.85), 'half diagonals', 'edges of bins', DEFINITION
    )
    amplitudes: tuple[float, float, int] = constant(
        (-6.0, 0.75, 13), 'ln 1/m^2', 'first edge, step and number of edges', DEFINITION
    )
    concavities: tuple[float, ...] = constant(
        (-0.02, -0.005, 0.005, 0.02, 0.05), 'fraction of distance', 'edges of bins', DEFINITION
    )
    speeds: tuple[float, ...] = constant(
        (-0.8, -0.4, -0.15, -0.03, 0.03, 0.15, 0.4, 0.8), 'm/s', 'edges of bins', DEFINITION
    )
    tiles: tuple[int, int] = constant((22, 28), '', 'rows and columns of tiles', DEFINITION)
    fine_a_period: float = constant(
        31.2, '', 'fine bins in c / 2f of the highest frequency: 8 a fourth harmonic', DEFINITION
    )
    fine_bins: int = constant(64, '', 'number of fine bins', DEFINITION)
    edge_reach: int = constant(3, 'px', 'from a jump, looked at as edge')
    near_jump: int = constant(5, 'px', 'from a jump, not looked at as surface: lateral noise')
    crease: float = constant(0.004, 'fraction of 1/depth', 'second difference of a sharp bend')
    near_crease: int = constant(3, 'px', 'from a sharp bend, not looked at as surface')
    same_surface: float = constant(0.1, 'fraction of depth', 'largest change between frames')
    bend: float = constant(0.3, 'fraction of 1/depth', 'a larger change is another surface')
    bend_step: int = constant(28, '', 'the width over this is the reach of concavity', DEFINITION)
    beyond: float = constant(1.1, 'range_max', 'farther is beyond the range')
    phase_noise: float = constant(
        0.2,
        'rad',
        'of one frequency; 80 and 60 MHz are then told apart wrongly in 0.2 % of depths: the '
        'combination 4 a - 3 b has 5 times the noise, and has to stay within pi',
        DEFINITION,
    )
    limit: float = constant(0.05, 'm', 'so near to an end of the range is not compared')


READING = Reading()
REGISTRATION = Registration()
GROUND_TRUTH = GroundTruth()
BINNING = Binning()
