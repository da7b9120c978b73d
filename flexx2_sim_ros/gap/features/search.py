"""
Find what is free inside a camera from its recordings, before anything is simulated.

`SEARCHES` has one search for each internal that an effect declares (`Effect.searched`). What is
found becomes variants of that effect, which the catalogue adds to its own.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

from flexx2_sim_ros.effects import Effect
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH, REGISTRATION
from flexx2_sim_ros.gap.calibration.search import SEARCH
from flexx2_sim_ros.gap.data.clues import Clues, latencies, light_edges, LINE, RANGE
from flexx2_sim_ros.gap.data.prior import POSE
from flexx2_sim_ros.physics.frame_state import SPEED_OF_LIGHT
from flexx2_sim_ros.profiles.modes import Mode
import numpy as np
from scipy import stats

Found = Mapping[str, tuple[float, ...]]
# Reciprocal periods, 1/m, and weights of the waves that a harmonic is made of.
_Mix = Sequence[tuple[float, float]]
_USUAL = (4,), (1,), (1, 2), (1, 2, 3, 4)  # harmonics of the profile that the catalogue has


def search(clues: Sequence[Clues], mode: Mode) -> Found:
    """
    Return what the recordings of one camera show of its inside, by internal.

    Only what stands out and is not in the profile, whose mode is `mode`.
    """
    found = {name: one(clues, mode) for name, one in SEARCHES.items()}
    return {name: values for name, values in found.items() if values}


def wave(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """
    Find the period of a bias over the range, metres.

    A sine and its second harmonic are fitted to the errors at every period, together with the pose
    of each recording, a line over range and a latency (as for Lomb-Scargle periodograms). The
    period is the one that explains most of the errors of recordings left out of the fit. It is
    empty if the harmonics of the profile explain about as much.
    """
    parts = _parts(clues, slice(None))
    if len(parts) < 2:
        return ()
    low, high, step = SEARCH.waves
    tried = np.arange(low, high, step)
    own = [[(k, 1.0)] for k in tried]
    best = float(tried[int(np.argmax([_explained(parts, one, (1, 2))[0] for one in own]))])
    near = best + np.linspace(-step, step, 9)
    explained = [_explained(parts, [(k, 1.0)], (1, 2))[0] for k in near]
    best = float(near[int(np.argmax(explained))])
    share, agree = _explained(parts, [(best, 1.0)], (1, 2))
    squares = sum(f * f for f in mode.modulation_hz)
    profile = [(2.0 * f / SPEED_OF_LIGHT, f * f / squares) for f in mode.modulation_hz]
    known = [_explained(parts, profile, orders)[0] for orders in _USUAL if profile]
    enough = max(SEARCH.wave_explains, SEARCH.wave_adds * max(known, default=0.0))
    return (1.0 / best,) if share >= enough and agree >= SEARCH.wave_agrees else ()


def constant(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """Find a bias that is the same at all distances, metres; empty if poses or chance make it."""
    (value, _), (chance, _) = _line(clues)
    return (value,) if abs(value) > max(GROUND_TRUTH.usual[0], chance) else ()


def stretch(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """Find a bias in proportion to distance, as a fraction; empty if chance makes it."""
    (_, value), (_, chance) = _line(clues)
    return (value,) if abs(value) > chance else ()


def _line(clues: Sequence[Clues]) -> np.ndarray:
    # A constant, metres, and a fraction of the depth, fitted beside the pose of each recording;
    # and what chance makes of them, by their scatter over recordings (jackknife).
    own = [i for i in range(clues[0].own.shape[1]) if i not in (RANGE, LINE)]
    parts = _parts(clues, own)
    if len(parts) < 2:
        return np.array([[0.0, 0.0], [np.inf, np.inf]])
    each = [one.equations_of(np.insert(one.depth, 0, 1.0, axis=1)) for one in parts]
    normal, right = (np.sum(one, axis=0) for one in zip(*each, strict=True))
    ridge = SEARCH.ridge * np.diag(np.diag(normal))
    values = np.linalg.solve(normal + ridge, right)
    without = [np.linalg.solve(normal - n + ridge, right - r) for n, r in each]
    errors = np.sqrt(len(parts) - 1) * np.std(without, axis=0)
    return np.array([values, stats.t.isf(SEARCH.line_chance / 2, len(parts) - 1) * errors])


def inside_of(effects: Iterable[Effect]) -> Found:
    """Return what `search` would find in a camera with these effects, as far as they say it."""
    found = {
        one.searched.internal: one.searched.of(one)
        for one in effects
        if one.searched is not None and one.searched.of is not None
    }
    return {name: values for name, values in found.items() if values}


def of_registration(found: Found) -> tuple[tuple[float, ...], float, tuple[float, float]]:
    """Return what `register` needs to know: periods of biases, metres; latency, s; its line."""
    (period,), (late,), (offset,), (scale,) = (
        found.get(name, (0.0,)) for name in ('wave', 'latency', 'constant', 'stretch')
    )
    return (period, period / 2) if period else (), late, (offset, scale)


class _Errors:
    # Errors of one recording and their nuisances, weighted, ready for what all have in common.
    def __init__(self, clues: Clues, nuisances: slice | list[int]) -> None:
        own = clues.own[:, nuisances] / clues.sigma[:, None]
        error = clues.error / clues.sigma
        ridge = SEARCH.ridge * len(error) * np.diag(np.square(own).mean(axis=0) + 1e-12)
        # Of few planes a motion looks like a bias, but motions are small.
        usual = np.repeat(GROUND_TRUTH.usual, 3)
        ridge[:POSE, :POSE] = np.diag(REGISTRATION.ridge * len(error) / usual**2)
        spread = 1.5 * np.median(np.abs(error))  # near a standard deviation
        scale = SEARCH.scale * np.maximum(spread, SEARCH.least_scale)
        rest = error
        for _ in range(SEARCH.steps):
            weight = 1 / (1 + (rest / scale) ** 2)
            inverse = np.linalg.inv((own.T * weight) @ own + ridge)
            rest = error - own @ (inverse @ ((own.T * weight) @ error))
        self._weight, self._own, self._rest = weight, own, rest
        self._project = inverse @ (own.T * weight)
        self._clues = clues
        self.power = float((weight * rest**2).sum())
        self.depth = clues.own[:, [LINE]]

    def equations(self, mix: _Mix, orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        # Normal matrix and right side, the nuisances eliminated.
        clues = self._clues
        columns = [
            sum(weight * g(2 * np.pi * n * k * clues.distance) for k, weight in mix)
            for n in orders
            for g in (np.sin, np.cos)
        ]
        return self.equations_of(np.stack(columns, axis=1) / clues.length[:, None])

    def equations_of(self, metres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # The same of any (N, n) columns.
        design = metres / self._clues.sigma[:, None]
        design = design - self._own @ (self._project @ design)
        weighted = design.T * self._weight
        return weighted @ design, weighted @ self._rest


def _parts(clues: Sequence[Clues], nuisances: slice | list[int]) -> list[_Errors]:
    return [_Errors(one, nuisances) for one in clues if len(one.error) >= SEARCH.fewest]


def _explained(
    parts: Sequence[_Errors], mix: _Mix, orders: tuple[int, ...]
) -> tuple[float, float]:
    return _held_out(parts, [one.equations(mix, orders) for one in parts])


def _held_out(
    parts: Sequence[_Errors], both: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[float, float]:
    # The fraction of the squared errors that is explained in recordings left out of the fit, and
    # the fraction of the recordings in which it is above 0. Each recording counts alike.
    normal, right = (np.sum(part, axis=0) for part in zip(*both, strict=True))
    ridge = SEARCH.ridge * np.trace(normal) / len(normal) * np.eye(len(normal))
    gains = []
    for one, (matrix, side) in zip(parts, both, strict=True):
        values = np.linalg.solve(normal - matrix + ridge, right - side)
        gains.append((2 * values @ side - values @ matrix @ values) / max(one.power, 1e-9))
    powers = np.array([one.power for one in parts])
    return float(np.dot(gains, powers) / powers.sum()), float(np.mean(np.array(gains) > 0))


def fold(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """
    Find the range after which distances repeat: the most frequent jump of depths that are short.

    It is in metres along the ray; empty if jumps do not have a length in common.
    """
    true, measured = np.concatenate([one.folds for one in clues], axis=1)
    jumps = true - measured  # metres by which depths are short
    beyond = sum(one.beyond for one in clues)
    looked = sum(one.looked for one in clues)
    if len(jumps) < max(SEARCH.fewest, SEARCH.fewest_folds * looked):
        return ()
    edges = np.arange(0.0, SEARCH.fold_longest, SEARCH.fold_bin)
    counts = np.histogram(jumps, edges)[0]
    smooth = np.convolve(counts, np.ones(5), 'same')
    peak = float(edges[int(np.argmax(smooth))] + SEARCH.fold_bin / 2)
    # The most frequent jump may be of two or three folds.
    number, length = max(_folded(jumps, measured, peak / n) for n in (1, 2, 3))
    return (length,) if number >= SEARCH.folds_alike * (len(jumps) + beyond) else ()


def _folded(jumps: np.ndarray, measured: np.ndarray, length: float) -> tuple[int, float]:
    # How many jumps are whole folds of about a length, and the length that fits them.
    whole = np.zeros(len(jumps), bool)
    for _ in range(3):
        times = np.maximum(np.rint(jumps / length), 1)
        # Folds leave the rest of the distance; other jumps leave any distance.
        whole = np.abs(jumps - times * length) < SEARCH.fold_near * length
        whole &= measured < (1 + SEARCH.fold_near) * length
        if not whole.any():
            break
        length = float(np.median(jumps[whole] / times[whole]))
    return int(whole.sum()), length


def latency(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """
    Find how old the images of moving scenes are, by comparing them with earlier and later ones.

    A filter over frames makes what moves late, too. It shows in still scenes, whose frames it
    makes alike. The latency is in seconds; empty if none explains more than the stamps do, or if a
    filter explains it.
    """
    losses = [one.late for one in clues if len(one.late) and np.isfinite(one.late).any()]
    if not losses:
        return ()
    tried = latencies()
    # A latency that only some recordings are long enough for is not compared.
    mean = np.where(np.isfinite(losses).all(axis=0), np.mean(losses, axis=0), np.inf)
    best = int(np.argmin(mean))
    if mean[best] > 1 - SEARCH.latency_gains:
        return ()
    late = _vertex(tried, mean, best)
    lags = [one.lag for one in clues if np.isfinite(one.lag)]
    return () if lags and 0 <= late <= np.median(lags) else (late,)


def _vertex(places: np.ndarray, values: np.ndarray, best: int) -> float:
    # Of the parabola through the smallest value and its neighbours.
    if best in (0, len(values) - 1) or not np.isfinite(values[best - 1 : best + 2]).all():
        return float(places[best])
    before, here, after = values[best - 1 : best + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(places[best] + shift * (places[best + 1] - places[best]))


def darkness(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """Find the amplitude below which depths are lost: amplitude in 1/m^2 and slope, or nothing."""
    expected, lost = np.sum([one.light for one in clues], axis=0).sum(axis=2)
    light = _middles(light_edges())
    return _threshold(expected, lost, light, -1.0)[1]


def glare(clues: Sequence[Clues], mode: Mode) -> tuple[float, ...]:
    """
    Find the amplitude above which depths are lost, with light that surfaces reflect head-on.

    The values are the amplitude in 1/m^2, slope, gloss and the width of its lobe, degrees; or
    nothing.
    """
    expected, lost = np.sum([one.light for one in clues], axis=0)
    angles = _middles(np.array(SEARCH.incidences))
    lobes = [(0.0, SEARCH.lobes[0])]  # without gloss any lobe is the same
    lobes += [(gloss, lobe) for gloss in SEARCH.glosses for lobe in SEARCH.lobes if gloss]
    found = []
    for gloss, lobe in lobes:
        more = np.log1p(gloss * np.exp(-np.square(angles / lobe)))
        light = _middles(light_edges())[:, None] + more
        rest, threshold = _threshold(expected, lost, light, 1.0)
        if threshold:
            found.append((rest, (*threshold, gloss, lobe)))
    return min(found)[1] if found else ()


def _middles(edges: np.ndarray) -> np.ndarray:
    return np.asarray((edges[:-1] + edges[1:]) / 2)


def _threshold(
    expected: np.ndarray, lost: np.ndarray, light: np.ndarray, sign: float
) -> tuple[float, tuple[float, ...]]:
    # Of bins with this logarithm of the light: what the best threshold leaves of the variance, and
    # its amplitude and slope; nothing if that is too much.
    some = expected >= SEARCH.fewest
    if some.sum() < 4:
        return np.inf, ()
    weight = np.sqrt(expected[some])  # neither pixels nor bins alone
    share, light = (lost / np.maximum(expected, 1))[some], light[some]
    mean = np.average(share, weights=weight)
    spread = float((weight * (share - mean) ** 2).sum())
    low, high, count = SEARCH.halves
    best: tuple[float, tuple[float, ...]] = (np.inf, ())
    for half in np.geomspace(low, high, count):
        for slope in SEARCH.slopes:
            curve = 1 / (1 + np.exp(-np.clip(sign * slope * (light - np.log(half)), -50, 50)))
            rest = float((weight * (share - curve) ** 2).sum())
            best = min(best, (rest, (float(half), slope)))
    return best if best[0] < (1 - SEARCH.usual_share) * spread else (best[0], ())


# By the name that an effect's `Searched` gives.
SEARCHES: dict[str, Callable[[Sequence[Clues], Mode], tuple[float, ...]]] = {
    'wave': wave,
    'stretch': stretch,
    'constant': constant,
    'fold': fold,
    'latency': latency,
    'darkness': darkness,
    'glare': glare,
}
