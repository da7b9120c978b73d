"""Cameras whose effects are known only roughly: distributions of parameters, and draws of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from flexx2_sim_ros.effects.effect import Effect
from flexx2_sim_ros.errors import InputError, shown, unquoted
from flexx2_sim_ros.limits import is_finite
import numpy as np
import scipy  # its parts are imported on use

_KEYS = {'effects', 'correlations'}
_MOST = 200  # distributions in a file
_ROUNDING = 0.01  # of eigenvalues of a matrix of rounded correlations
_QUANTILES = 1000  # for the standard deviation


@dataclass(frozen=True)
class Distribution:
    """
    How one parameter of an effect is drawn.

    Attributes
    ----------
    effect, parameter : str
    low, high : float
        Bounds, within those of the effect.
    mean, sd : float or None
        A normal distribution, cut off at the bounds; None: uniform within the bounds.

    """

    effect: str
    parameter: str
    low: float
    high: float
    mean: float | None = None
    sd: float | None = None

    @property
    def name(self) -> str:
        """Return the effect and the parameter, with a dot between."""
        return f'{self.effect}.{self.parameter}'

    def at(self, quantile: np.ndarray) -> np.ndarray:
        """Return the values at quantiles, 0 to 1."""
        if self.mean is None or self.sd is None:
            return np.asarray(self.low + (self.high - self.low) * quantile)
        start, end = (scipy.special.ndtr((x - self.mean) / self.sd) for x in (self.low, self.high))
        values = self.mean + self.sd * scipy.special.ndtri(start + (end - start) * quantile)
        return np.clip(values, self.low, self.high)

    @property
    def spread(self) -> float:
        """Return the standard deviation."""
        return float(self.at((np.arange(_QUANTILES) + 0.5) / _QUANTILES).std())


@dataclass(frozen=True)
class Randomisation:
    """
    Effects whose parameters are drawn, one camera after the other.

    Attributes
    ----------
    effects : tuple of Effect
        All effects; parameters without a distribution have these values.
    probabilities : dict of str to float
        How often a camera has an effect, by name.
    distributions : tuple of Distribution
        Of the parameters that are drawn.
    correlation : numpy.ndarray
        (D, D) of the distributions' normal scores (Gaussian copula).

    """

    effects: tuple[Effect, ...]
    probabilities: dict[str, float]
    distributions: tuple[Distribution, ...]
    correlation: np.ndarray

    def values(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Draw the parameters of cameras.

        Parameters
        ----------
        count : int
            How many cameras.
        seed : int
            The first cameras of a larger count are the same.

        Returns
        -------
        tuple of numpy.ndarray
            (count, D) values of the distributions, and (count, E) bool: which effects are on.

        """
        rng = np.random.default_rng(seed)
        size = len(self.distributions), len(self.effects)
        draws = np.array([rng.standard_normal(sum(size)) for _ in range(count)])
        draws = draws.reshape(count, sum(size))
        level, vectors = np.linalg.eigh(self.correlation)
        root = vectors * np.sqrt(np.maximum(level, 0))
        quantiles = scipy.special.ndtr(draws[:, : size[0]] @ root.T)
        values = [one.at(quantiles[:, k]) for k, one in enumerate(self.distributions)]
        chances = [self.probabilities[effect.name] for effect in self.effects]
        on = scipy.special.ndtr(draws[:, size[0] :]) < np.array(chances)
        return np.array(values).reshape(size[0], count).T, on

    def draw(self, count: int, seed: int) -> list[tuple[Effect, ...]]:
        """Return the effects of so many cameras; see `values`."""
        values, on = self.values(count, seed)
        out = []
        for row, used in zip(values, on, strict=True):
            own: dict[str, dict[str, Any]] = {one.name: one.settings for one in self.effects}
            for one, value in zip(self.distributions, row, strict=True):
                own[one.effect][one.parameter] = float(value)
            out.append(
                tuple(
                    effect.from_mapping(own[effect.name])
                    for effect, is_on in zip(self.effects, used, strict=True)
                    if is_on
                )
            )
        return out

    def plain(self) -> dict[str, Any]:
        """Return what `parse_randomisation` reads."""
        effects: dict[str, Any] = {}
        for effect in self.effects:
            effects[effect.name] = {
                'probability': self.probabilities[effect.name],
                'parameters': dict(effect.settings),
            }
        for one in self.distributions:
            table = {'mean': one.mean, 'sd': one.sd, 'low': one.low, 'high': one.high}
            effects[one.effect]['parameters'][one.parameter] = {
                key: value for key, value in table.items() if value is not None
            }
        names = [one.name for one in self.distributions]
        pairs = [
            [names[i], names[j], round(float(self.correlation[i, j]), 3)]
            for i in range(len(names))
            for j in range(i)
            if abs(self.correlation[i, j]) >= 0.001
        ]
        return {'effects': effects, 'correlations': pairs}


def fixed(effects: Sequence[Effect]) -> Randomisation:
    """Return a randomisation that always draws the same effects."""
    return Randomisation(tuple(effects), {one.name: 1.0 for one in effects}, (), np.eye(0))


def of_strengths(effects: Sequence[Effect], low: float, high: float) -> Randomisation:
    """Return a randomisation of effects whose strengths are uniform and independent."""
    found = [Distribution(one.name, 'strength', low, high) for one in effects]
    return with_more(fixed(effects), (), found)


def with_more(
    one: Randomisation, effects: Sequence[Effect], found: Sequence[Distribution]
) -> Randomisation:
    """Return a randomisation with more effects and independent distributions."""
    names = set(one.probabilities) & {effect.name for effect in effects}
    if names:
        raise InputError(f'effects: must be without {names.pop()}, which is added here')
    size = len(one.distributions)
    matrix = np.eye(size + len(found))
    matrix[:size, :size] = one.correlation
    return Randomisation(
        (*one.effects, *effects),
        {**one.probabilities, **{effect.name: 1.0 for effect in effects}},
        (*one.distributions, *found),
        matrix,
    )


def parse_randomisation(
    table: Any, kinds: Mapping[str, type[Effect]], where: str
) -> Randomisation:
    """
    Read a randomisation from a table, as of a YAML file.

    ``effects`` of the table has, by name, ``probability`` and ``parameters``, each a number or a
    table with ``low`` and ``high`` (uniform), and ``mean`` and ``sd`` (normal). ``correlations``
    are lists of two parameters (``effect.parameter``) and a number. ``kinds`` are the effects
    there are, by name; ``where`` is what to call the table in errors. Raises InputError that names
    what cannot be used.
    """
    if not isinstance(table, Mapping) or not set(table) <= _KEYS or 'effects' not in table:
        raise InputError(f'{where}: must be a table of effects and correlations')
    if not isinstance(table['effects'], Mapping):
        raise InputError(f'{where}: effects: must be a table of effects by name')
    effects, chances, found = [], {}, []
    for name in table['effects']:
        if name not in kinds:
            raise InputError(f'{where}: {unquoted(name)}: must be an effect, got an unknown one')
    for name, kind in kinds.items():  # in the order of light
        if name in table['effects']:
            place = f'{where}: {name}'
            own, chance, distributions = _effect(table['effects'][name], kind, place)
            effects.append(own)
            chances[name] = chance
            found += distributions
    if len(found) > _MOST:
        raise InputError(f'{where}: must have at most {_MOST} distributions, got {len(found)}')
    matrix = _correlation(table.get('correlations', []), [one.name for one in found], where)
    return Randomisation(tuple(effects), chances, tuple(found), matrix)


def _effect(
    table: Any, kind: type[Effect], where: str
) -> tuple[Effect, float, list[Distribution]]:
    if not isinstance(table, Mapping) or not set(table) <= {'probability', 'parameters'}:
        raise InputError(f'{where}: must be a table of probability and parameters')
    chance = _number(table.get('probability', 1.0), f'{where}: probability', 0.0, 1.0)
    parameters = table.get('parameters', {})
    if not isinstance(parameters, Mapping):
        raise InputError(f'{where}: parameters: must be a table, got {shown(parameters)}')
    known = {item.name: item for item in kind.parameters()}
    fixed: dict[Any, Any] = {}
    found = []
    for name, value in parameters.items():
        if not isinstance(value, Mapping) or name not in known:
            fixed[name] = value
            continue
        one = _distribution(kind.name, name, value, f'{where}.{name}')
        for end in (one.low, one.high):
            known[name].checked(end, f'{where}.{name}')
        found.append(one)
    try:
        return kind.from_mapping(fixed), chance, found
    except InputError as error:
        raise InputError(f'{where}: {error}') from error


def _distribution(effect: str, name: str, table: Mapping[Any, Any], where: str) -> Distribution:
    if set(table) not in ({'low', 'high'}, {'low', 'high', 'mean', 'sd'}):
        raise InputError(
            f'{where}: must have low and high, or low, high, mean and sd, got {shown(dict(table))}'
        )
    low, high = (_number(table[key], f'{where}: {key}', -math.inf) for key in ('low', 'high'))
    if not low < high:
        raise InputError(f'{where}: low: must be below high, got {low:g} and {high:g}')
    if 'mean' not in table:
        return Distribution(effect, name, low, high)
    mean = _number(table['mean'], f'{where}: mean', low, high)
    sd = _number(table['sd'], f'{where}: sd', 0.0)
    if sd < 1e-9 * (high - low):
        raise InputError(f'{where}: sd: must be above 0, got {sd:g}')
    return Distribution(effect, name, low, high, mean, sd)


def _number(value: Any, where: str, low: float, high: float = math.inf) -> float:
    if not (is_finite(value) and low <= value <= high):
        raise InputError(f'{where}: must be a number from {low:g} to {high:g}, got {shown(value)}')
    return float(value)


def _correlation(rows: Any, names: Sequence[str], where: str) -> np.ndarray:
    matrix = np.eye(len(names))
    if not isinstance(rows, list):
        raise InputError(f'{where}: correlations: must be a list, got {shown(rows)}')
    for row in rows:
        if not isinstance(row, list) or len(row) != 3 or not all(one in names for one in row[:2]):
            raise InputError(
                f'{where}: correlations: must be two parameters that are drawn and a number, got '
                f'{shown(row)}'
            )
        i, j = names.index(row[0]), names.index(row[1])
        matrix[i, j] = matrix[j, i] = _number(row[2], f'{where}: correlations', -1.0, 1.0)
    if (np.diag(matrix) != 1).any() or np.linalg.eigvalsh(matrix).min(initial=1) < -_ROUNDING:
        raise InputError(f'{where}: correlations: must be a matrix without negative eigenvalues')
    return matrix
