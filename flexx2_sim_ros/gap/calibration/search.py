"""How the inside of a camera is looked for, before anything is simulated."""

from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.about import constant, DEFINITION

BENCH = 'python -m bench.gap_internals of aac5156 --seeds 700, and --plain; by hand'


@dataclass(frozen=True)
class Search:
    """Grids of the searches, and from what evidence on a variant is proposed."""

    samples: int = constant(1500, 'px', 'of a recording, about')
    largest_error: float = constant(0.06, 'm', 'larger errors are not part of a bias')
    ridge: float = constant(
        1e-4, 'fraction', 'of the power of a column, on fits of waves and nuisances'
    )
    scale: float = constant(3.0, 'spreads of errors, or sigma_z', 'of the loss')
    least_scale: float = constant(0.3, 'sigma_z', 'least spread of errors, for waves')
    steps: int = constant(3, '', 'of reweighted least squares')
    fewest: int = constant(200, 'px', 'fewer say nothing')
    waves: tuple[float, float, float] = constant(
        (0.24, 3.4, 0.02), '1/m', 'reciprocal periods over the range: lowest, highest, step'
    )
    wave_explains: float = constant(
        0.01, 'fraction', 'of the squared errors of left-out recordings, by a wave', BENCH
    )
    wave_adds: float = constant(
        1.15, 'factor', 'on what harmonics of the profile explain of them', BENCH
    )
    wave_agrees: float = constant(0.85, 'fraction', 'of the recordings that these improve', BENCH)
    line_chance: float = constant(
        5e-4,
        'probability',
        'that scatter alone makes a constant bias, or a depth scale, as large (Student)',
        'test_gap_search.py: a wrong lens is not taken for it, and 1 % is found',
    )
    latencies: tuple[float, float, float] = constant((-0.2, 0.4, 0.01), 's', 'that are tried')
    latency_gains: float = constant(
        0.02,
        'fraction',
        'of the loss of moving recordings that a latency takes off',
        'python -m bench.gap_latency of aac5156: 0 without an effect, 0.063 or more at 25 ms',
    )
    least_loss: float = constant(1e-9, '', 'of frames at their stamps, for a latency')
    most_alike: float = constant(0.9, '', 'weight of the frame before, in the lag of a filter')
    fewest_frames: int = constant(2, 'frames', 'at a latency; fewer say nothing')
    light: tuple[float, float, float] = constant(
        (-10.0, 6.0, 0.25), 'ln 1/m^2', 'bins of the amplitude', DEFINITION
    )
    incidences: tuple[float, ...] = constant(
        (0.0, 2.0, 4.0, 6.0, 8.0, 11.0, 16.0, 24.0, 90.0), 'deg', 'edges of bins', DEFINITION
    )
    glosses: tuple[float, ...] = constant((0.0, 0.5, 1.0, 2.0, 4.0, 8.0), '', 'that are tried')
    lobes: tuple[float, ...] = constant((2.0, 4.0, 6.0, 9.0), 'deg', 'that are tried')
    halves: tuple[float, float, int] = constant((1e-4, 30.0, 64), '1/m^2', 'that are tried')
    slopes: tuple[float, ...] = constant((1.5, 3.0, 6.0, 12.0), '', 'that are tried')
    usual_share: float = constant(
        0.5, 'fraction', 'of the variance of lost fractions that a threshold explains', BENCH
    )
    fold_frames: int = constant(3, 'frames', 'of a still scene that are looked at')
    least_fold: float = constant(0.25, 'm', 'a smaller jump is an edge')
    most_folds: int = constant(20_000, 'px', 'of a recording')
    fold_bin: float = constant(0.02, 'm', 'histogram of the jumps', DEFINITION)
    fold_longest: float = constant(12.0, 'm', 'its end', DEFINITION)
    fold_near: float = constant(0.04, 'fraction', 'jumps this near to a whole number of folds')
    folds_alike: float = constant(0.7, 'fraction', 'of all jumps, for a fold', BENCH)
    fewest_folds: float = constant(5e-4, 'fraction', 'of the depths, for a fold', BENCH)


SEARCH = Search()
