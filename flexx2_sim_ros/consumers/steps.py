"""Heights on a grid: their errors, and steps of the ground between neighbouring cells."""

import numpy as np

# A step is a height difference of neighbouring cells that a robot must lift its feet for, metres.
STEP = 0.04
# Below this fraction of a step there is none.
_NONE = 0.5


def height_errors(seen: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """
    Compare heights on a grid with the true ones.

    Parameters
    ----------
    seen, true : numpy.ndarray
        (X, Y) metres, NaN without data.

    Returns
    -------
    dict of str to float
        ``height_error``: mean absolute difference, mm. ``cells_without_data``: fraction of the
        true cells, %. ``invented_steps``: neighbours that differ by more than a step where the
        true ones do not. ``missed_steps``: the reverse. Empty if there are no true heights.

    """
    shown = np.isfinite(true)
    if not shown.any():
        return {}
    both = shown & np.isfinite(seen)
    out = {'cells_without_data': 100 * float(1 - both.sum() / shown.sum())}
    if both.any():
        out['height_error'] = 1000 * float(np.abs(seen - true)[both].mean())
    invented = missed = 0
    for axis in (0, 1):
        found, real = (np.abs(np.diff(one, axis=axis)) for one in (seen, true))
        invented += int(((found > STEP) & (real < _NONE * STEP)).sum())
        missed += int(((real > STEP) & (found < _NONE * STEP)).sum())
    return {**out, 'invented_steps': float(invented), 'missed_steps': float(missed)}


def edge_error(seen: np.ndarray, true: np.ndarray, pitch: float, reach: int = 3) -> float | None:
    """
    Return how far the edges of steps are from the true edges, along the first axis.

    Parameters
    ----------
    seen, true : numpy.ndarray
        (X, Y) metres, NaN without data.
    pitch : float
        Size of a cell, metres.
    reach : int
        Edges are looked for so many cells before and behind the true edge.

    Returns
    -------
    float or None
        Mean absolute distance, mm; None without a true step that is found again.

    """
    distances = []
    for i, j in np.argwhere(np.abs(np.diff(true, axis=0)) > STEP):
        low, high = max(i - reach, 0), min(i + reach + 2, len(true))
        middle = (true[i, j] + true[i + 1, j]) / 2
        edges = [_crossings(one[low:high, j] - middle) + low for one in (true, seen)]
        if len(edges[1]):
            own = edges[0][np.abs(edges[0] - i - 0.5).argmin()]
            distances.append(float(np.abs(edges[1] - own).min()))
    return 1000 * pitch * float(np.mean(distances)) if distances else None


def _crossings(profile: np.ndarray) -> np.ndarray:
    # Where a profile changes its sign, in cells, linear between cells.
    a, b = profile[:-1], profile[1:]
    at = np.flatnonzero((a * b < 0) | ((a == 0) & (b != 0)))
    return at + a[at] / (a[at] - b[at])
