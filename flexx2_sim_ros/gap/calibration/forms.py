"""Which forms of an effect are tried when it is calibrated, and when one is taken."""

from dataclasses import dataclass

from flexx2_sim_ros.gap.calibration.about import constant, DEFINITION


@dataclass(frozen=True)
class Forms:
    """Resolution of curves and maps, and what flexibility costs."""

    ridge: float = constant(1e4, '1/m^2', 'penalty on coefficients: they are about a centimetre')
    bend: float = constant(1e7, '1/m^2', 'penalty on second differences of a spline')
    corner: float = constant(
        1.3, 'range_max', 'longest range along the ray, in a corner of the image', DEFINITION
    )
    range_knots: int = constant(300, '', 'of a curve over range', DEFINITION)
    spline_knots: int = constant(60, '', 'coefficients of a spline over range')
    frequencies_mhz: tuple[float, float] = constant(
        (12.0, 130.0), 'MHz', 'modulation frequencies that are tried'
    )
    frequency_steps: int = constant(90, '', 'how many of them')
    light: tuple[float, float, int] = constant(
        (-7.0, 3.0, 15), 'ln 1/m^2', 'first and last knot over amplitude, and how many', DEFINITION
    )
    knees: tuple[float, float, int] = constant(
        (0.01, 3.0, 9), '1/m^2', 'smallest and largest knee that is tried, and how many'
    )
    taus: tuple[float, float, int] = constant(
        (60.0, 7200.0, 8), 's', 'shortest and longest time constant, and how many'
    )
    time_knots: int = constant(50, '', 'of a curve over uptime', DEFINITION)
    iterations: int = constant(6, '', 'of reweighted least squares')
    free_knots: int = constant(40, '', 'of a bias over range and light that sets weights alone')
    robust: float = constant(3.0, 'sigma', 'scale of the Cauchy loss')
    incidence: tuple[float, float, int] = constant(
        (0.0, 90.0, 46), 'deg', 'edges of bins of incidence', DEFINITION
    )
    slant: tuple[float, float, int] = constant(
        (-4.0, 4.0, 41), 'ln m', 'edges of bins of range times tan of incidence', DEFINITION
    )
    amplitude: tuple[float, float, int] = constant(
        (-7.0, 3.0, 51), 'ln 1/m^2', 'edges of bins of amplitude', DEFINITION
    )
    bleeds: tuple[float, ...] = constant((1.0, 3.0, 10.0), 'px', 'reaches of bleeding light')
    fewest: int = constant(3, 'recordings', 'with fewer nothing can be left out')
    surer: float = constant(
        1.0, 'standard errors', 'by which a more flexible form must be better, left out'
    )
    samples: int = constant(
        56, 'pixels', 'of each row and column that a bias is fitted to', DEFINITION
    )
    grain: float = constant(
        0.002, 'm', "error of a pixel's ground truth, beside noise, when a map is made"
    )
    steps: int = constant(2, '', "of a recording's pose, when its effects change")
    slope: float = constant(
        0.004,
        '',
        'step of a parameter on geometry for its slope, as a fraction of half its bounds',
    )
    rounds: int = constant(4, '', 'of parameters on geometry and poses, at most')
    scales: int = constant(31, '', 'values of a scale that are tried, from 0 on', DEFINITION)
    rigid: tuple[float, float] = constant(
        (0.2, 0.0003),
        'fraction, m',
        'a shift that is less like that of a camera that moves is that of an edge',
        'python -m bench.benchmark_cases --effects motion_artefact --strengths 1; by hand: with '
        'all pixels, edges decided',
    )
    equal: float = constant(1e-5, 'm', 'shifts that differ less are the same', DEFINITION)
    least: float = constant(
        0.05, 'tolerances', 'a smaller gain in distance does not matter; see `physical.distance`'
    )
    coarse: int = constant(4, '', 'sets of parameters all over their bounds, for each parameter')
    fine: int = constant(8, '', 'sets of parameters on the way downhill, for each parameter')
    quick: tuple[float, float] = constant(
        (0.2, 0.08), '', 'steps about what a diagnosis has found, as fractions of the bounds'
    )
    frames: int = constant(6, 'frames', 'of a recording that are simulated in a search')
    simplex: float = constant(0.12, '', 'first step downhill, as a fraction of the bounds')
    close: float = constant(0.005, '', 'the last step, likewise')
    known: int = constant(50, 'samples', 'a bin with fewer is left out')
    dead: float = constant(
        0.5, '', 'share of the frames in which a dead pixel is lost', DEFINITION
    )
    unlikely: float = constant(1e-3, '', 'least probability of a table that is judged')


FORMS = Forms()
