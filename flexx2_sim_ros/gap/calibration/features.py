"""From what size on a difference matters, and how recordings and simulations are summarised."""

from collections.abc import Mapping
from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.about import ASSUMED, constant, DEFINITION, table


@dataclass(frozen=True)
class Features:
    """From what size on a difference of a feature matters, and how many samples it takes."""

    tolerances: Mapping[str, float] = table(
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
            'jump_between': 0.02,
            'jump_switches': 0.01,
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
    enough: int = constant(150, 'samples', 'a bin with fewer is unknown')
    enough_alike: int = constant(12, 'samples', 'the same with common random numbers')
    structure_noise: float = constant(
        0.3, 'tolerances', 'standard deviation of features that are not binned'
    )
    gross: float = constant(6.0, 'sigma_z', 'a larger error is gross, and clipped', DEFINITION)
    gross_change: float = constant(8.5, 'sigma_z', 'limit of the difference of two errors')
    jump: float = constant(0.25, 'm', 'a larger gross error is another surface')
    lattice_bin: float = constant(1e-4, 'm', 'histogram of depths', DEFINITION)
    lattice_range: float = constant(7.5, 'm', 'its range', DEFINITION)
    lattice_steps: Mapping[str, tuple[float, float]] = table(
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
    lattice_noise: float = constant(3e-4, '', 'added to a spectrum before its logarithm')
    lattice_harmonic: float = constant(0.8, '', 'a longer step with this much of the peak wins')
    lattice_agreement: float = constant(
        0.02, 'fraction of a step', 'steps of two recordings within it agree'
    )
    same_noise: float = constant(
        0.5,
        'correlation',
        'of one noise; cameras are below 0.1, one noise on two scenes above 0.9',
    )
    same_noise_samples: int = constant(4096, 'px', 'whose noise is compared', DEFINITION)
    same_noise_fewest: int = constant(100, 'px', 'fewer are not compared')


@dataclass(frozen=True)
class MeasureResolution:
    """Resolution of the gap in physical units."""

    bin_mm: float = constant(0.5, 'mm', 'histogram of depth errors', DEFINITION)
    half: int = constant(300, 'bins', 'of it on either side of zero', DEFINITION)
    normal: int = constant(60, 'bins', 'of errors from -6 to 6 sigma_z', DEFINITION)
    fewest: int = constant(50, 'px', 'a histogram or bin with fewer is left out')
    every: int = constant(3, 'frames', 'one of these is counted', DEFINITION)
    bend: float = constant(
        3.0, 'tolerances', 'gap beyond which a mismatch grows in proportion, not by its square'
    )
    tile: int = constant(4, 'px', 'least side of small tiles', DEFINITION)
    apart: tuple[int, ...] = constant(
        (2, 3, 4), 'frames', 'between which the growth of noise is counted', DEFINITION
    )
    fewest_pairs: int = constant(100, 'depths', 'of a pixel in two frames: fewer are not counted')


@dataclass(frozen=True)
class Simulation:
    """How often and how long a recording's scene is simulated."""

    null_seeds: int = constant(4, '', 'simulations without effects: mean and noise of features')
    confirm_seeds: int = constant(2, '', 'simulations of the outcome')
    few: tuple[int, int, int] = constant(
        (8, 2, 5),
        'frames',
        'of a still scene; of a moving one, how many stretches of how many frames',
    )
    fewest: tuple[int, int, int] = constant(
        (4, 4, 2),
        'frames',
        'the same for a bias or a loss, which add no noise; other frames show other surfaces at '
        'the same place of the image',
    )
    settling: int = constant(2, 'frames', 'left out after a gap: filters settle')
    pooled: tuple[float, float] = constant(
        (0.5, 0.25), '', 'weight of the analytic variance, and its least fraction'
    )
    edge_error: float = constant(0.4, 'px', 'error of where edges are')


FEATURES = Features()
MEASURES = MeasureResolution()
SIMULATION = Simulation()
