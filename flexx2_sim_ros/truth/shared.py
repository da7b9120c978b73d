"""Estimate the errors that recordings share, and decide which of them can be distinguished."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Any

from flexx2_sim_ros.truth.alignment import ErrorColumns, LENS, Linear, PosedImage
from flexx2_sim_ros.truth.joint import reduced, shared_equations, Solution, solve
import numpy as np

# Periods that are tried, metres: c/16f of 100 MHz to c/2f of 40 MHz.
_PERIODS = np.geomspace(0.18, 3.75, 90)
_FINER = np.linspace(0.96, 1.04, 17)
_MOST_PERIODS = 4
_SCAN_PIXELS = 1500
# A wave is accepted if it explains this many times as much as noise (two coefficients, 90 periods
# tried: by chance once in a million).
_LEAST_GAIN = 40.0
_MOST_DEVIATION = 0.002  # metres, of the bias; bench/truth.py of aac5156 shows what remains
_LEAST_RECORDINGS = 3
_CLEAR = 3.0  # standard deviations of the bounce's gain, and of a scale
_LIKE_SCALE = 2.0  # metres: a wave at least as long looks like a scale
_LEAST_SCALE = 0.002  # scale error of a calibrated camera
# Smaller errors of the lens, as in `LENS`, are not corrected: a third of the effect's defaults,
# with 0.7 pixels of 224 as a tangent.
_LEAST_LENS = {'focal': 0.005 / 3, 'cx': 0.0033 / 3, 'cy': 0.0033 / 3, 'k1': 0.01 / 3}
_CLEAR_LENS = 4.0  # standard deviations
_DRIFTS = 300.0, 900.0, 2700.0  # seconds, time constants as those of the effect
_CLEAR_DRIFT = 5.0  # standard deviations, the largest of three tried
_LEAST_DRIFT = 0.003  # metres: a third of the usual drift
_LEAST_TIME = 300.0  # seconds between the first and the last recording

DIFFER = 'depth and room differ in scale'  # An offset is confounded then.
Finding = dict[str, Any]


def estimate(
    views: Sequence[PosedImage], scale_error: float | None = None
) -> tuple[Solution, dict[str, Finding]]:
    """
    Estimate poses and shared errors, but for errors that these recordings cannot tell apart.

    Return the joint solution with the others, and what is found of each effect: ``verdict``,
    ``reason``, values and their standard deviations. A verdict is ``identified`` (also: known to
    be absent), ``confounded``, or ``found``: a ``depth_scale`` of the camera, where the room's own
    is known to the fraction `scale_error`.
    """
    bounce = any(view.target.bounce.any() for view in views)
    several = len({view.recording for view in views}) >= _LEAST_RECORDINGS
    trial = solve(views, ErrorColumns(True, (), bounce, lens=several))
    if several:
        trial = _with_waves(trial)
    findings: dict[str, Finding] = {}
    trial, findings['warm_up_drift'] = _with_drift(trial)
    solution, findings['intrinsics_error'] = _with_or_without_lens(trial)
    why = _refusal(solution)
    full, columns = solution, solution.columns
    clear = columns.bounce and not _unclear(solution)
    if clear and not why:
        why = _hidden_by_bounce(solution)
    if why or (columns.bounce and not clear):
        # Errors that cannot be distinguished from the poses are not subtracted; the others are
        # fitted without them.
        columns = replace(columns, bias=not why, bounce=clear)
        solution = solve(solution.views, columns)
    findings = {**_findings(full, solution, why), **findings}
    scale = _scale(solution, scale_error)
    if scale:
        findings['depth_scale'] = scale
    if 'fraction' in scale:
        findings['offset'] |= {'verdict': 'confounded', 'reason': DIFFER}
    return solution, findings


def _with_waves(solution: Solution) -> Solution:
    # Waves are added one by one as long as each is clear.
    for _ in range(_MOST_PERIODS):
        period, gain = _best_period(solution)
        if gain < _LEAST_GAIN:
            break
        columns = solution.columns
        solution = solve(solution.views, replace(columns, periods=(*columns.periods, period)))
    return solution


def _fitted(solution: Solution, name: str) -> tuple[float, float]:
    # Value and standard deviation of a coefficient.
    place = solution.columns.names.index(name)
    return float(solution.values[place]), float(solution.deviations[place])


def _finding(why: str, **values: Any) -> Finding:
    # An error that can be told from the poses, or why not.
    reason = {'reason': why} if why else {}
    return {'verdict': 'confounded' if why else 'identified', **values, **reason}


def _with_or_without_lens(solution: Solution) -> tuple[Solution, Finding]:
    # Errors of the lens stay where they are clear and large enough. Light that bounced bends
    # floors and walls as a wrong lens does, and its shape is only simulated, so next to it nothing
    # is said of the lens.
    if not solution.columns.lens:
        return solution, _finding(_too_few(_LEAST_RECORDINGS, solution))
    lens = {name: _fitted(solution, name) for name in LENS}
    loose = [name for name, (_, deviation) in lens.items() if deviation > _LEAST_LENS[name]]
    why = f'the recordings cannot tell it from their poses ({", ".join(loose)})' if loose else ''
    found = any(
        abs(value) > max(_CLEAR_LENS * deviation, _LEAST_LENS[name])
        for name, (value, deviation) in lens.items()
    )
    if solution.columns.bounce and not _unclear(solution):
        found, why = False, 'bounced light looks like it'
    values = {
        name: {'value': value, 'standard_deviation': deviation}
        for name, (value, deviation) in lens.items()
    }
    if found:
        return solution, _finding('', lens=values)
    without = solve(solution.views, replace(solution.columns, lens=False))
    return without, _finding(why, lens=values)


def _with_drift(solution: Solution) -> tuple[Solution, Finding]:
    # A bias that decays after power-on, if it is clear.
    uptimes = np.array([view.uptime for view in solution.views])
    if not np.isfinite(uptimes).all():
        why = 'the stamps do not say when the recordings were made, one after another'
        return solution, _finding(why)
    if np.ptp(uptimes) < _LEAST_TIME:
        return solution, {'verdict': 'identified', 'reason': 'an offset: all is within minutes'}
    if solution.recordings <= _LEAST_RECORDINGS:
        return solution, _finding(_too_few(_LEAST_RECORDINGS + 1, solution))
    trials = [solve(solution.views, replace(solution.columns, drift=tau)) for tau in _DRIFTS]
    clear = [abs(value) / spread for value, spread in (_fitted(one, 'drift') for one in trials)]
    best = trials[int(np.argmax(clear))]
    value, deviation = _fitted(best, 'drift')
    values = {'metres': value, 'standard_deviation': deviation, 'tau': best.columns.drift}
    if max(clear) > _CLEAR_DRIFT:
        return best, _finding('', **values)
    loose = f'it is known to {deviation * 1e3:.1f} mm (must be {_LEAST_DRIFT * 1e3:.0f} mm)'
    return solution, _finding(loose if deviation > _LEAST_DRIFT else '', **values)


def _too_few(least: int, solution: Solution) -> str:
    return f'needs at least {least} recordings, got {solution.recordings}'


def _scale(solution: Solution, known: float | None) -> Finding:
    # The scale is reported but not subtracted: if it is an error of the camera, the diagnosis must
    # see it. Within the error of the room's own scale, `known`, it may be an error of the room.
    loose = known is None or known > _LEAST_SCALE
    told = 'not known' if known is None else f'known to {known:.2%} only'
    nothing = _finding(f'the scale of the room is {told}') if loose else {}
    if solution.recordings < _LEAST_RECORDINGS:
        return nothing
    periods = tuple(one for one in solution.columns.periods if one < _LIKE_SCALE)
    columns = replace(solution.columns, bias=True, periods=periods, scale=True)
    trial = solve(solution.views, columns)
    size, deviation = _fitted(trial, 'scale')
    if abs(size) < max(_CLEAR * deviation, _LEAST_SCALE):
        return nothing
    ours = known is not None and abs(size) > _CLEAR * math.hypot(deviation, known)
    return {
        'verdict': 'found' if ours else 'confounded',
        'fraction': size,
        'standard_deviation': deviation,
        'reason': f'measured depth grows by {size:+.2%} of distance against the room',
    }


def _unclear(solution: Solution) -> str:
    # Why bounced light is not; empty if it is.
    if solution.recordings < _LEAST_RECORDINGS:
        return _too_few(_LEAST_RECORDINGS, solution)
    gain, deviation = _fitted(solution, 'bounce')
    if gain > _CLEAR * deviation:
        return ''
    least = f'must be above {_CLEAR:.0f} standard deviations of {deviation:.2f}'
    return f'its gain {least}, got {gain:.2f}'


def _refusal(solution: Solution) -> str:
    # Why an estimate of the bias cannot be trusted; empty if it can.
    if solution.recordings < _LEAST_RECORDINGS:
        return _too_few(_LEAST_RECORDINGS, solution)
    _, deviation = _fitted(solution, 'bias')
    if deviation > _MOST_DEVIATION:
        return (
            f'recordings disagree: leaving one out changes it by {deviation * 1e3:.1f} mm '
            f'(at most {_MOST_DEVIATION * 1e3:.0f} mm)'
        )
    return ''


def _hidden_by_bounce(solution: Solution) -> str:
    # The shape of bounced light is simulated, and about as uncertain as it is large.
    size = np.mean([np.abs(view.target.bounce).mean() for view in solution.views])
    least = float(solution.values[-1] * size)
    if abs(float(solution.values[0])) > least:
        return ''
    return f'bounced light adds {least * 1e3:.0f} mm; a smaller offset cannot be told from it'


def _best_period(solution: Solution) -> tuple[float, float]:
    # The period that explains most of the residual, and the ratio to noise.
    gains = _gains(solution, _PERIODS)
    finer = float(_PERIODS[int(gains.argmax())]) * _FINER
    gains = _gains(solution, finer)
    return float(finer[int(gains.argmax())]), float(gains.max())


def _gains(solution: Solution, periods: np.ndarray) -> np.ndarray:
    # How much a wave of each period explains, beyond poses and present columns.
    k, first = len(solution.values), 1 + 2 * len(solution.columns.periods)
    waves = np.arange(first, first + 2 * len(periods))
    values = np.insert(solution.values, first, np.zeros(len(waves)))
    columns = replace(solution.columns, periods=(*solution.columns.periods, *periods.tolist()))
    equations = [
        replace(
            view, target=view.target.thinned(_SCAN_PIXELS), columns=columns, values=values
        ).linear
        for view in solution.views
    ]
    S, s = reduced(shared_equations(equations, columns), columns)
    S -= np.diag(np.isin(np.arange(len(s)), waves) * columns.precision)
    own = np.setdiff1d(np.arange(len(s)), waves)
    present = np.linalg.solve(S[np.ix_(own, own)], np.column_stack([S[own], s[own]]))
    left = S[waves] - S[np.ix_(waves, own)] @ present[:, :-1]
    rest = (s[waves] - S[np.ix_(waves, own)] @ present[:, -1]).reshape(-1, 2)
    pairs = waves.reshape(-1, 2)
    blocks = np.stack([left[2 * i : 2 * i + 2, pair] for i, pair in enumerate(pairs)])
    amplitudes = np.linalg.solve(blocks + 1e-9 * np.eye(2), rest[..., None])[..., 0]
    noise = _noise([(one, one.A[:, own]) for one in equations], present[:k, -1])
    return np.asarray(np.einsum('cp,cp->c', amplitudes, rest) / noise)


def _noise(equations: Sequence[tuple[Linear, np.ndarray]], values: np.ndarray) -> float:
    # Part of pure noise that one coefficient explains; residuals of one tile are not independent.
    total, squares = 0.0, 0.0
    for one, present in equations:
        left = one.free((one.y - present @ values)[:, None])[:, 0]
        squares += float((np.bincount(one.tile, one.weight * left) ** 2).sum())
        total += float(one.weight.sum())
    return max(squares / max(total, 1e-30), 1e-30)


def _findings(full: Solution, used: Solution, why: str) -> dict[str, Finding]:
    metres, deviation = _fitted(full, 'bias')
    found = {'offset': _finding(why, metres=metres, standard_deviation=deviation)}
    names = used.columns.names
    waves = []
    for period in used.columns.periods:
        place = names.index(f'sine {period:.3f} m')
        sine, cosine = used.values[place : place + 2]
        waves.append(
            {
                'period': period,
                'amplitude': math.hypot(sine, cosine),
                'standard_deviation': float(np.max(used.deviations[place : place + 2])),
            }
        )
    if waves:
        found['wiggling'] = _finding('', waves=waves)
    if full.columns.bounce:
        gain, deviation = _fitted(full, 'bounce')
        why = '' if used.columns.bounce else _unclear(full)
        found['multipath'] = _finding(why, gain=gain, standard_deviation=deviation)
    return found
