"""How validity and noise depend on the amplitude image, where there is one."""

from dataclasses import dataclass

from flexx2_sim_ros.characterize.tiles import Tiles
import numpy as np

# Half-octaves: edges that every camera's units and every recording share, so that counts add up.
EDGES = 2.0 ** (np.arange(-40, 65) / 2)
_FEWEST_TILES = 5
_ABOVE_FLOOR = 1.3


@dataclass(frozen=True)
class AmplitudeCounts:
    """Pixels by amplitude: (len(EDGES) - 1,) how many, and how many of them are invalid."""

    pixels: np.ndarray
    invalid: np.ndarray

    def __add__(self, other: 'AmplitudeCounts') -> 'AmplitudeCounts':
        """Return the counts of both."""
        return AmplitudeCounts(self.pixels + other.pixels, self.invalid + other.invalid)


def count_invalid(
    amplitude: np.ndarray, valid: np.ndarray, edges: np.ndarray = EDGES
) -> AmplitudeCounts:
    """
    Count pixels and invalid pixels by amplitude.

    Amplitude, in the camera's units, and ``valid``, bool, have the same shape; what is not
    positive is not counted. ``edges`` are bounds of the bins, rising; the lower one belongs to the
    bin.
    """
    index = np.searchsorted(edges, amplitude.ravel(), side='right') - 1
    inside = (index >= 0) & (index < len(edges) - 1) & (amplitude.ravel() > 0)
    size = len(edges) - 1
    return AmplitudeCounts(
        np.bincount(index[inside], minlength=size),
        np.bincount(index[inside & ~valid.ravel()], minlength=size),
    )


@dataclass(frozen=True)
class AmplitudeCurve:
    """
    Noise against amplitude, in N bins.

    Attributes
    ----------
    amplitude : numpy.ndarray
        (N,) middle of each bin, in the camera's units.
    sigma, tiles : numpy.ndarray
        (N,) median standard deviation of the tiles in it, metres, and how many there are.
    exponent : float
        sigma goes as amplitude to this power where it is well above its floor (the lowest of
        `sigma`); NaN for fewer than three bins there.

    """

    amplitude: np.ndarray
    sigma: np.ndarray
    tiles: np.ndarray
    exponent: float


def sigma_against(tiles: Tiles, edges: np.ndarray = EDGES) -> AmplitudeCurve:
    """Return the noise of tiles by their amplitude; empty where they have none."""
    level = tiles.amplitude
    index = np.searchsorted(edges, np.nan_to_num(level), side='right') - 1
    known = np.isfinite(level) & (level > 0) & (index >= 0) & (index < len(edges) - 1)
    rows = []
    for number in np.unique(index[known]):
        here = known & (index == number)
        if here.sum() >= _FEWEST_TILES:
            rows.append(
                (
                    np.sqrt(edges[number] * edges[number + 1]),
                    np.sqrt(np.median(tiles.variance[here])),
                    here.sum(),
                )
            )
    table = np.array(rows).reshape(-1, 3)
    exponent = float('nan')
    above = table[table[:, 1] > _ABOVE_FLOOR * table[:, 1].min(initial=np.inf)]
    if len(above) >= 3:
        low = known & np.isin(index, np.searchsorted(edges, above[:, 0]) - 1)
        exponent = float(np.polyfit(np.log(level[low]), 0.5 * np.log(tiles.variance[low]), 1)[0])
    return AmplitudeCurve(table[:, 0], table[:, 1], table[:, 2], exponent)
