"""Assumptions of the noise model, tested on the recordings."""

from collections.abc import Callable
from dataclasses import dataclass
import math

from flexx2_sim_ros.characterize.analysis import Cell, ModeResult
from flexx2_sim_ros.characterize.measurement import Measurement
import numpy as np
from scipy.stats import t

# Deviations below these do not matter to somebody who simulates the camera (assumed).
_CORRELATION = 0.04
_INVALID = 0.008
_BIAS_SHARE = 0.10  # of sigma_z
_VARIANCE_SHARE = 0.10  # of sigma_z squared
_SKEWNESS = 0.1
_KURTOSIS = 0.2
_EDGE_KURTOSIS = 0.5
_EDGE_SPREAD = 0.10  # of sigma_x
_TAPE = 0.010  # metres, of the paper's tape
_LEAST_SPAN, _TURN = 0.2, 30.0  # metres and degrees over which bias is compared
_FACING = 7.5  # degrees: recordings at "0 degrees"
_FEWEST_FRAMES = 20  # for anything about time or tails
_SURE = 5.0  # standard errors


@dataclass(frozen=True)
class TestedAssumption:
    """
    One assumption, tested on the recordings of one mode.

    Attributes
    ----------
    usecase : str
        The mode.
    assumption : str
        What the model assumes.
    holds : bool or None
        None when the recordings cannot say.
    evidence : str
        The measured figures.

    """

    usecase: str
    assumption: str
    holds: bool | None
    evidence: str


def check_assumptions(mode: ModeResult) -> list[TestedAssumption]:
    """Test every assumption of the model on the recordings of a mode."""
    checks: dict[str, Callable[[ModeResult], tuple[bool | None, str]]] = {
        'sigma_z follows the formula': _form,
        'sigma_z depends on reflectivity as the profile says': _surfaces,
        '0 degrees is like other angles': _facing,
        'frames are independent': _time,
        'neighbouring pixels are independent': _neighbours,
        'errors are not common to a whole frame': _whole_frames,
        'axial noise is Gaussian': _gaussian,
        'depth is unbiased': _unbiased,
        'there is no fixed-pattern noise': _pattern,
        'there are no invalid pixels on the board': _dropout,
        'lateral noise is Gaussian': _edges_gaussian,
        'lateral noise is the same at all distances and angles': _edges_alike,
    }
    return [TestedAssumption(mode.usecase, name, *check(mode)) for name, check in checks.items()]


def _form(mode: ModeResult) -> tuple[bool | None, str]:
    if mode.axial.freedom < 1:
        return None, f'{len(mode.white)} recordings are too few for the number of coefficients'
    worst = max(mode.white, key=lambda cell: abs(math.log(cell.sigma / cell.modelled)))
    return (
        2 * mode.axial.scatter < _VARIANCE_SHARE,
        f'recordings deviate from the fit by {mode.axial.scatter:.1%} (RMS), '
        f'{_where(worst.measurement)} by {worst.sigma / worst.modelled - 1:+z.1%}',
    )


def _surfaces(mode: ModeResult) -> tuple[bool | None, str]:
    if mode.surfaces is None:
        boards = {cell.measurement.reflectivity for cell in mode.cells}
        return None, (
            ('one white board was recorded' if len(boards) == 1 else 'two boards are too few')
            + '; the profile gives surfaces of every reflectivity the noise of the '
            + ('board' if len(boards) == 1 else 'brighter board')
        )
    fit = mode.surfaces
    return (
        2 * fit.scatter < _VARIANCE_SHARE,
        f'{len(fit.reflectivities)} boards of {fit.reflectivities[0]:.0%} to '
        f'{fit.reflectivities[-1]:.0%}; recordings of the darker ones deviate from the fit by '
        f'{fit.scatter:.1%} (root mean square)',
    )


def _facing(mode: ModeResult) -> tuple[bool | None, str]:
    facing = [cell for cell in mode.white if cell.measurement.angle_deg < _FACING]
    others = [cell for cell in mode.white if cell.measurement.angle_deg >= _FACING]
    if not facing or not others:
        return None, 'needs recordings at 0 degrees and at other angles'

    def mean(cells: list[Cell], value: Callable[[Cell], float]) -> float:
        return float(np.mean([value(cell) for cell in cells]))

    ratio = mean(facing, lambda c: (c.sigma / c.modelled) ** 2)
    divergence = [mean(cells, lambda c: c.axial.debiased) for cells in (facing, others)]
    invalid = [mean(cells, lambda c: c.measurement.pixels.invalid) for cells in (facing, others)]
    holds = (
        abs(math.log(ratio)) < _VARIANCE_SHARE
        and invalid[0] - invalid[1] < _INVALID
        and divergence[0] - divergence[1] < _VARIANCE_SHARE**2
    )
    return holds, (
        f'at 0 degrees sigma_z is {math.sqrt(ratio):.3f} x the model, divergence '
        f'{divergence[0]:z.4f} nats (elsewhere {divergence[1]:z.4f}), invalid '
        f'{invalid[0]:.2%} (elsewhere {invalid[1]:.2%})'
    )


def _time(mode: ModeResult) -> tuple[bool | None, str]:
    return _correlated(
        mode, lambda m: m.pixels.lag, 'correlation with the next frame', _several(mode)
    )


def _neighbours(mode: ModeResult) -> tuple[bool | None, str]:
    measured = mode.measurements if mode.spatial else _several(mode)
    holds, text = _correlated(
        mode,
        lambda m: 0.5 * (m.pixels.right + m.pixels.down),
        'correlation with the next pixel',
        measured,
    )
    return holds, text + (' (of the deviation from fitted planes)' if mode.spatial else '')


def _correlated(
    mode: ModeResult, value: Callable[[Measurement], float], what: str, measured: list[Measurement]
) -> tuple[bool | None, str]:
    if not measured:
        return None, _too_few(mode)
    mean = _mean(measured, value)
    worst = max(measured, key=lambda m: abs(value(m)))
    samples = sum(m.pixels.count * m.frames for m in measured)
    matters = abs(mean) > max(_CORRELATION, _SURE / math.sqrt(samples))
    return not matters, (
        f'{what} {mean:+z.3f} on average, {value(worst):+z.3f} at {_where(worst)}'
    )


def _whole_frames(mode: ModeResult) -> tuple[bool | None, str]:
    measured = _several(mode)
    if not measured:
        return None, _too_few(mode)
    spread = float(np.mean([m.pixels.frame_spread for m in measured]))
    sure = _SURE * math.sqrt(2 / sum(m.frames for m in measured))
    drifting = max(measured, key=lambda m: abs(m.pixels.drift))
    drift = abs(drifting.pixels.drift) / _sigma(drifting)
    return (
        spread < 1.5 + sure and drift < _BIAS_SHARE,
        f'frame means vary {spread:.2f} times as much as with independent pixels; '
        f'the largest drift is {1e3 * drifting.pixels.drift:+z.2f} mm over '
        f'{drifting.frames} frames at {_where(drifting)}',
    )


def _gaussian(mode: ModeResult) -> tuple[bool | None, str]:
    measured = _several(mode)
    if not measured:
        return None, _too_few(mode)
    skewness, kurtosis = (
        _mean(measured, value)
        for value in (lambda m: m.pixels.skewness, lambda m: m.pixels.kurtosis)
    )
    samples = sum(m.pixels.count * m.frames for m in measured)
    return (
        abs(skewness) < _SKEWNESS + _SURE * math.sqrt(6 / samples)
        and abs(kurtosis) < _KURTOSIS + _SURE * math.sqrt(24 / samples),
        f'skewness {skewness:+z.3f}, excess kurtosis {kurtosis:+z.3f} (a Gaussian has 0 and 0)',
    )


def _unbiased(mode: ModeResult) -> tuple[bool | None, str]:
    known = [m for m in mode.measurements if m.bias_of]
    if not known:
        return (
            None,
            'the true distance is not known: no clean depth and no distance in the file names',
        )
    bias = np.array([m.bias for m in known])
    text = (
        f'bias {1e3 * bias.mean():+z.2f} mm on average, '
        f'{1e3 * bias.min():+z.2f} to {1e3 * bias.max():+z.2f} mm{_scale(known, bias)}'
    )
    if all(m.bias_of == 'clean depth' for m in known):
        share = float(np.sqrt(np.mean((bias / [_sigma(m) for m in known]) ** 2)))
        return share < _BIAS_SHARE, f'{text}; {share:.3f} of sigma_z (RMS)'
    rms = float(np.sqrt(np.mean(bias**2)))
    return (
        None if rms < _TAPE else False,
        f'{text} relative to the tape, which is accurate to 10 mm',
    )


def _scale(known: list[Measurement], bias: np.ndarray) -> str:
    # How bias grows with distance and angle together; nothing where recordings do not tell.
    places = np.array([(m.distance, abs(m.angle_deg) / _TURN) for m in known])
    varied = np.ptp(places, axis=0) > (_LEAST_SPAN, 1 / 2)
    design = np.column_stack([np.ones(len(known)), places[:, varied]])
    freedom = len(design) - design.shape[1]
    if not varied[0] or freedom < 1 or np.linalg.matrix_rank(design) < design.shape[1]:
        return ''
    slopes, *_ = np.linalg.lstsq(design, bias, None)
    variance = ((bias - design @ slopes) ** 2).sum() / freedom
    reach = t.ppf(0.975, freedom) * np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design)))
    words = f'; it grows by {slopes[1]:+z.2%} of distance (95 %: +- {100 * reach[1]:.2g} %)'
    if not varied[1]:
        return words
    return words + (
        f' and by {1e3 * slopes[2]:+z.1f} mm in {_TURN:g} degrees of yaw (95 %: +- '
        f'{1e3 * reach[2]:.2g} mm)'
    )


def _pattern(mode: ModeResult) -> tuple[bool | None, str]:
    measured = [m for m in mode.measurements if m.frames > 1]
    if not measured:
        return None, _too_few(mode)
    share = float(np.sqrt(np.mean([(m.pixels.pattern / _sigma(m)) ** 2 for m in measured])))
    worst = max(measured, key=lambda m: m.pixels.pattern)
    return (
        share < 1.5 * _BIAS_SHARE,
        f'pixel means scatter about a smooth surface by {share:.3f} of sigma_z (RMS), '
        f'{1e3 * worst.pixels.pattern:.2f} mm at {_where(worst)}',
    )


def _dropout(mode: ModeResult) -> tuple[bool | None, str]:
    worst = max(mode.measurements, key=lambda m: m.pixels.invalid)
    mean = _mean(mode.measurements, lambda m: m.pixels.invalid)
    return mean < _INVALID, (
        f'{mean:.2%} invalid on average, {worst.pixels.invalid:.2%} at {_where(worst)}'
    )


def _edges_gaussian(mode: ModeResult) -> tuple[bool | None, str]:
    edges = [edge for _, edge in mode.edges]
    if not edges:
        return None, 'no vertical edge of a board was seen'
    weights = [edge.rows * edge.frames for edge in edges]
    kurtosis = float(np.average([edge.kurtosis for edge in edges], weights=weights))
    return (
        abs(kurtosis) < _EDGE_KURTOSIS + _SURE * math.sqrt(24 / sum(weights)),
        f'excess kurtosis {kurtosis:+z.2f} of the displacement of {len(edges)} edges',
    )


def _edges_alike(mode: ModeResult) -> tuple[bool | None, str]:
    edges = [edge for _, edge in mode.edges]
    if len(edges) < 2:
        return None, 'needs edges at several distances and angles'
    sigmas = np.array([edge.sigma for edge in edges])
    errors = np.array([edge.error for edge in edges])
    spread = math.sqrt(max(float(sigmas.var(ddof=1) - np.mean(errors**2)), 0.0))
    return (
        spread < _EDGE_SPREAD * float(sigmas.mean()),
        f'{len(edges)} edges: {sigmas.min():.2f} to {sigmas.max():.2f} px, scatter beyond '
        f'chance: {spread:.3f} px',
    )


def _several(mode: ModeResult) -> list[Measurement]:
    return [m for m in mode.measurements if m.frames >= _FEWEST_FRAMES]


def _too_few(mode: ModeResult) -> str:
    most = max(m.frames for m in mode.measurements)
    return f'needs recordings of at least {_FEWEST_FRAMES} frames, got {most}'


def _mean(measured: list[Measurement], value: Callable[[Measurement], float]) -> float:
    return float(
        np.average(
            [value(m) for m in measured], weights=[m.pixels.count * m.frames for m in measured]
        )
    )


def _sigma(measurement: Measurement) -> float:
    tiles = measurement.tiles
    return max(math.sqrt(float(np.average(tiles.variance, weights=tiles.pixels))), 1e-9)


def _where(measurement: Measurement) -> str:
    distance, angle = measurement.label
    return f'{distance:g} m, {angle:g} degrees'
