"""What an effect may take beyond its parameters: a curve, a map, a number of another formula."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import whole
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.npz_arrays import open_npz
import numpy as np

MOST_KNOTS = 400
MOST_SIDE = 2048  # pixels of a map
_MAP, _NUMBER = 'map', 'number'
_MOST_BYTES = 8 * MOST_SIDE**2


@dataclass(frozen=True)
class Curve:
    """
    A function of one covariate: linear between knots, which rise, constant beyond them.

    There are as many values as knots. With ``period`` the curve repeats; None: it does not.
    """

    knots: tuple[float, ...]
    values: tuple[float, ...]
    period: float | None = None

    def at(self, x: Any) -> np.ndarray:
        """Return the curve at some places, float32 of the same shape; NaN where they are NaN."""
        y = np.interp(np.asarray(x, np.float64), self.knots, self.values, period=self.period)
        return np.asarray(y, np.float32)

    def plain(self) -> dict[str, Any]:
        """Return the curve as lists, as in a YAML or JSON file."""
        lists = {'knots': list(self.knots), 'values': list(self.values)}
        return lists if self.period is None else {**lists, 'period': self.period}


class PixelMap:
    """One number for each pixel: (H, W), finite; copied to float32 that cannot be changed."""

    def __init__(self, values: np.ndarray) -> None:
        """Keep a copy."""
        self.values = np.array(values, np.float32, order='C')
        self.values.setflags(write=False)

    def __eq__(self, other: object) -> bool:
        """Compare shape and numbers."""
        return isinstance(other, PixelMap) and np.array_equal(self.values, other.values)

    def __hash__(self) -> int:
        """Return a hash of the numbers."""
        return hash(self.values.tobytes())

    def of_image(self, shape: tuple[int, ...], where: str) -> np.ndarray:
        """Return the numbers for an image of this shape; `where` is what errors call the map."""
        if self.values.shape != shape:
            raise InputError(
                f'{where}: must have the size of the image, {shape}, got {self.values.shape}'
            )
        return self.values

    def at_size(self, height: int, width: int) -> 'PixelMap':
        """Return the map of smaller or larger images of the same view: the nearest pixels."""
        rows, columns = (
            ((np.arange(new) + 0.5) * old / new).astype(int)
            for new, old in zip((height, width), self.values.shape, strict=True)
        )
        return PixelMap(self.values[np.ix_(rows, columns)])

    def plain(self) -> list[list[float]]:
        """Return the rows as lists, as in a JSON file."""
        rows: list[list[float]] = self.values.tolist()
        return rows


Form = Curve | PixelMap | float


@dataclass(frozen=True)
class Table:
    """
    A curve, map or number that changes the formula of an effect if it is given.

    Attributes
    ----------
    kind : str
        ``curve``, ``map`` or ``number``.
    text : str
        What it is, for people.
    over : str
        What a curve is over, with its unit; empty for a map or number.
    unit : str
        Of the values; empty for a plain number.
    low, high : float
        Bounds of the values.

    """

    kind: str
    text: str
    over: str
    unit: str
    low: float
    high: float

    def checked(self, value: Any, where: str) -> 'Form | None':
        """
        Return a value as a curve, map or number; None stays None.

        Raises InputError, which names `where`, when it is none of them, or its numbers are out of
        bounds.
        """
        if value is None:
            return None
        if self.kind == _NUMBER:
            if not _is_number(value):
                raise InputError(f'{where}: must be a number, got {shown(value)}')
            self._within(np.array([value]), where)
            return float(value)
        return self._map(value, where) if self.kind == _MAP else self._curve(value, where)

    def _curve(self, value: Any, where: str) -> Curve:
        table = value.plain() if isinstance(value, Curve) else value
        if not isinstance(table, Mapping) or not {'knots', 'values'} <= set(table) <= {
            'knots',
            'values',
            'period',
        }:
            raise InputError(
                f'{where}: must be a table of knots, values and, if it repeats, period, got '
                f'{shown(value)}'
            )
        knots = _numbers(table['knots'], f'{where}.knots')
        values = _numbers(table['values'], f'{where}.values')
        if any(b <= a for a, b in zip(knots, knots[1:], strict=False)):
            raise InputError(f'{where}.knots: must rise from one to the next')
        if len(values) != len(knots):
            raise InputError(
                f'{where}.values: must be as many as knots, {len(knots)}, got {len(values)}'
            )
        self._within(np.array(values), f'{where}.values')
        period = table.get('period')
        if period is not None and not (_is_number(period) and period > knots[-1] - knots[0]):
            raise InputError(
                f'{where}.period: must be a number above {knots[-1] - knots[0]:g}, the range of '
                f'the knots, got {shown(period)}'
            )
        return Curve(knots, values, None if period is None else float(period))

    def _map(self, value: Any, where: str) -> PixelMap:
        array = value.values if isinstance(value, PixelMap) else value
        if isinstance(array, list):
            array = _from_rows(array)
        if not (
            isinstance(array, np.ndarray)
            and array.dtype.kind == 'f'
            and array.ndim == 2
            and 0 < min(array.shape) <= max(array.shape) <= MOST_SIDE
        ):
            got = (
                f'{array.dtype} of shape {array.shape}'
                if isinstance(array, np.ndarray)
                else shown(value)
            )
            raise InputError(
                f'{where}: must be an (H, W) array of floating-point numbers with sides up to '
                f'{MOST_SIDE}, or in a file the name of an .npz file beside it, got {got}'
            )
        self._within(array, where)
        return value if isinstance(value, PixelMap) else PixelMap(array)

    def _within(self, values: np.ndarray, where: str) -> None:
        wrong = values[~((values >= self.low) & (values <= self.high))]
        if wrong.size:
            unit = f' {self.unit}' if self.unit else ''
            raise InputError(
                f'{where}: must be numbers from {self.low:g} to {self.high:g}{unit}, got '
                f'{wrong.flat[0]:g}'
            )


def curve_over(over: str, unit: str, low: float, high: float, text: str) -> Any:
    """Declare a curve of an effect: a dataclass field that is None unless it is given."""
    table = Table('curve', text, over, unit, low, high)
    return field(default=None, kw_only=True, metadata={'table': table})


def pixel_map(unit: str, low: float, high: float, text: str) -> Any:
    """Declare a map of an effect: a dataclass field that is None unless it is given."""
    table = Table(_MAP, text, '', unit, low, high)
    return field(default=None, kw_only=True, metadata={'table': table})


def optional_number(unit: str, low: float, high: float, text: str) -> Any:
    """Declare a number of another formula: a dataclass field that is None unless it is given."""
    table = Table(_NUMBER, text, '', unit, low, high)
    return field(default=None, kw_only=True, metadata={'table': table})


def read_map(folder: Path, name: Any, where: str) -> np.ndarray:
    """
    Read a map from the .npz file `name` (without a folder) in the folder of a file of effects.

    Nothing of the map, (H, W), is checked yet; `where` is what it is called in errors. Raises
    InputError when the file cannot be read, is too large, or has anything but one array ``map`` in
    it.
    """
    if not isinstance(name, str) or Path(name).name != name or not name.endswith('.npz'):
        raise InputError(
            f'{where}: must be the name of an .npz file beside this file, got {shown(name)}'
        )
    try:
        with open_npz(folder / name) as archive:
            if list(archive.headers) != [_MAP]:
                raise InputError(f'{shown_path(name)}: must have one array, {_MAP}')
            size = archive.headers[_MAP].size
            if size > _MOST_BYTES:
                raise InputError(
                    f'{shown_path(name)}: must be at most {_MOST_BYTES} bytes, got {size}'
                )
            return archive.read(_MAP)
    except InputError as error:
        raise InputError(f'{where}: {error}') from error


def write_map(path: Path, one: PixelMap) -> None:
    """Write a map as a file that `read_map` reads, whole or not at all."""
    with whole(path) as part:
        np.savez_compressed(part, map=one.values)


def _numbers(value: Any, where: str) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or not 0 < len(value) <= MOST_KNOTS:
        raise InputError(
            f'{where}: must be a list of 1 to {MOST_KNOTS} numbers, got '
            f'{f"{len(value)} of them" if isinstance(value, list | tuple) else shown(value)}'
        )
    for one in value:
        if not _is_number(one):
            raise InputError(f'{where}: must be finite numbers, got {shown(one)}')
    return tuple(float(one) for one in value)


def _from_rows(rows: list[Any]) -> Any:
    # What is no (H, W) array stays, and is refused.
    try:
        return np.array(rows, np.float64)
    except (ValueError, TypeError, OverflowError):
        return rows


def plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of an effect as a JSON file holds them."""
    return {
        name: value.plain() if isinstance(value, Curve | PixelMap) else value
        for name, value in settings.items()
    }


def _is_number(value: Any) -> bool:
    kinds = int | float | np.integer | np.floating
    return isinstance(value, kinds) and not isinstance(value, bool) and _in_reach(value)


def _in_reach(value: Any) -> bool:
    return -1e9 < value < 1e9  # never true of NaN
