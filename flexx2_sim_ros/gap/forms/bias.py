"""Forms of a bias: which functions of range, light or time are tried, from simple to flexible."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

from flexx2_sim_ros.camera import Mode
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.effects.tables import Curve
from flexx2_sim_ros.gap.calibration.forms import FORMS
from flexx2_sim_ros.gap.forms.samples import Samples
from flexx2_sim_ros.physics.frame_state import SPEED_OF_LIGHT
import numpy as np

Basis = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Form:
    """
    One form that a bias may have, linear in its coefficients; `label` is for people.

    `basis` gives (K, N) metres along the ray at (N,) values, for a coefficient of 1 each. The
    curve of `effect` has `knots`. `stiffness` is a penalty on second differences of the
    coefficients; 0: none.
    """

    effect: str
    label: str
    basis: Basis
    knots: np.ndarray
    stiffness: float = 0.0

    @property
    def size(self) -> int:
        """Return how many coefficients there are."""
        return len(self.basis(self.knots[:1]))

    def columns(self, samples: Samples) -> np.ndarray:
        """Return (K, N) metres of depth for a coefficient of 1 each."""
        return self.basis(getattr(samples, covariate_of(self.effect))) / samples.length

    def penalty(self) -> np.ndarray:
        """Return the (K, K) penalty on coefficients: a little, or more on second differences."""
        ridge = FORMS.ridge * np.eye(self.size)
        if self.stiffness:
            bends = np.diff(np.eye(self.size), 2, axis=0)
            ridge += self.stiffness * bends.T @ bends
        return ridge

    def curve(self, coefficients: np.ndarray) -> Curve:
        """Return the curve of some coefficients within its bounds, to the hundredth of a mm."""
        table = registry()[self.effect].tables()['curve']
        values = np.round(coefficients @ self.basis(self.knots), 5).clip(table.low, table.high)
        return Curve(
            tuple(float(x) for x in np.round(self.knots, 6)), tuple(float(y) for y in values)
        )


def hats(knots: np.ndarray) -> Basis:
    """Return a basis of functions that are 1 at a knot, 0 at the others, linear between."""
    units = np.eye(len(knots))

    def basis(x: np.ndarray) -> np.ndarray:
        return np.array([np.interp(x, knots, unit) for unit in units])

    return basis


# Four taps alone see the fourth harmonic; unequal taps the second, too.
_ORDERS = (4,), (2, 4), (1, 2, 3, 4)


def _far(mode: Mode) -> float:
    # Metres along the ray in a corner of the image.
    return FORMS.corner * mode.range_max


def _offsets(mode: Mode) -> list[list[Form]]:
    def constant(x: np.ndarray) -> np.ndarray:
        return np.ones((1, len(x)))

    def line(x: np.ndarray) -> np.ndarray:
        return np.stack([np.ones_like(x), x - mode.range_max / 2])

    ends = np.array([0.0, _far(mode)])
    return [
        [Form('offset', 'constant along the ray', constant, ends[:1])],
        [Form('offset', 'line over range', line, ends)],
    ]


def harmonics(frequencies: tuple[float, ...], orders: tuple[int, ...]) -> Basis:
    """Return a basis of sines and cosines of multiples of the phases of modulation frequencies."""
    waves = [4 * np.pi * f * n / SPEED_OF_LIGHT for f in frequencies for n in orders]

    def basis(x: np.ndarray) -> np.ndarray:
        return np.array([g(k * x) for k in waves for g in (np.sin, np.cos)])

    return basis


def _wigglings(mode: Mode) -> list[list[Form]]:
    knots = np.linspace(0.0, _far(mode), FORMS.range_knots)

    def wave(orders: tuple[int, ...], hertz: tuple[float, ...], whose: str) -> Form:
        label = f'harmonics {", ".join(map(str, orders))} of {whose}'
        return Form('wiggling', label, harmonics(hertz, orders), knots)

    own = tuple(mode.modulation_hz)
    known = [wave(orders, own, "the profile's frequencies") for orders in _ORDERS if own]
    tried = np.geomspace(*FORMS.frequencies_mhz, FORMS.frequency_steps)
    free = [
        [wave(orders, (float(1e6 * f),), f'{f:.1f} MHz') for f in tried] for orders in _ORDERS[1:]
    ]
    spaced = np.linspace(0.0, _far(mode), FORMS.spline_knots)
    spline = Form('wiggling', 'spline over range', hats(spaced), spaced, FORMS.bend)
    return sorted([*([one] for one in known), *free, [spline]], key=lambda group: group[0].size)


def _amplitude_biases(mode: Mode) -> list[list[Form]]:
    knots = np.linspace(*FORMS.light)

    def knee(k: float) -> Form:
        def basis(x: np.ndarray) -> np.ndarray:
            return np.stack([np.ones_like(x), 1 / (1 + np.exp(x) / k)])

        label = f'a + b / (1 + A / {k:.3g})'
        return Form('amplitude_bias', label, basis, knots)

    knees = [knee(float(k)) for k in np.geomspace(*FORMS.knees)]
    spline = Form('amplitude_bias', 'spline over ln A', hats(knots), knots, FORMS.bend)
    return [knees, [spline]]


def _warm_ups(mode: Mode) -> list[list[Form]]:
    taus = np.geomspace(*FORMS.taus)
    knots = np.concatenate([[0.0], np.geomspace(1.0, 4.0 * taus[-1], FORMS.time_knots)])

    def decays(some: tuple[float, ...]) -> Form:
        def basis(x: np.ndarray) -> np.ndarray:
            return np.exp(-x / np.array(some)[:, None])

        label = f'decay with {" and ".join(f"{tau:.0f} s" for tau in some)}'
        return Form('warm_up_drift', label, basis, knots)

    one = [decays((float(tau),)) for tau in taus]
    two = [decays((float(a), float(b))) for a, b in combinations(taus, 2)]
    return [one, two]


# Each with the attribute of `Samples` that its curve is over, and its forms.
_FORMS: dict[str, tuple[str, Callable[[Mode], list[list[Form]]]]] = {
    'offset': ('distance', _offsets),
    'wiggling': ('distance', _wigglings),
    'amplitude_bias': ('light', _amplitude_biases),
    'warm_up_drift': ('uptime', _warm_ups),
}
BIASES = tuple(_FORMS)


def covariate_of(effect: str) -> str:
    """Return the attribute of `Samples` that an effect's curve is over."""
    return _FORMS[effect][0]


def forms_of(effect: str, mode: Mode) -> list[list[Form]]:
    """
    Return the forms to try for an effect, grouped: of a group only the best is looked at further.

    The groups go from simple to flexible.
    """
    return _FORMS[effect][1](mode)
