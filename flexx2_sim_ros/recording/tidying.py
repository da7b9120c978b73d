"""Bring a recording as people have it into the form that all commands expect."""

from collections.abc import Iterator, Mapping

from flexx2_sim_ros.recording.given import in_metres
from flexx2_sim_ros.recording.reader import ASSUMED, Content, Layout, ONE_EACH, RecordingReader
from flexx2_sim_ros.recording.stamps import in_time
from flexx2_sim_ros.recording.units import factor_of, TRUSTED
import numpy as np


def tidy(reader: RecordingReader, units: bool = True) -> RecordingReader:
    """
    Return a recording with rising stamps, depth in metres and reflectivity up to 1.

    Parameters
    ----------
    reader : RecordingReader
        The file. Notes say what is changed.
    units : bool
        Whether values tell the units; else the user has said them.

    """
    order, notes = in_time(reader.stamp_ns, str(reader.path))
    factors: dict[str, float] = {}
    for key in TRUSTED if units else ():
        factor, note = factor_of(key, _first(reader, key), str(reader.path))
        if note:
            factors[key] = factor
            notes.append(note)
    return reader if order is None and not factors else _Tidied(reader, order, factors, notes)


def _first(reader: RecordingReader, key: str) -> np.ndarray | None:
    # The first image that has a value.
    if key in reader.arrays:
        return reader.arrays[key]
    images = reader.frames(key) if key in reader.layouts else iter(())
    return next((image for image in images if np.nan_to_num(image).any()), None)


class _Tidied(RecordingReader):
    def __init__(
        self,
        source: RecordingReader,
        order: np.ndarray | None,
        factors: Mapping[str, float],
        notes: list[str],
    ) -> None:
        self._source, self._order, self._factors = source, order, factors
        layouts = {
            key: Layout(np.dtype(np.float32), layout.shape) if key in factors else layout
            for key, layout in source.layouts.items()
        }
        arrays = {key: self._array(key, array) for key, array in source.arrays.items()}
        kept = [note for note in source.notes if ASSUMED not in note]
        content = Content(
            layouts, arrays, [*kept, *notes], source.changes, frames=len(source.stamp)
        )
        super().__init__(source.path, source.camera, content, source.profile)

    def _array(self, key: str, array: np.ndarray) -> np.ndarray:
        array = self._scaled(key, array)
        each = key in ONE_EACH and array.ndim in (1, 3) and len(array) == len(self._source.stamp)
        return array[self._order] if each and self._order is not None else array

    def _scaled(self, key: str, image: np.ndarray) -> np.ndarray:
        factor = self._factors.get(key)
        if factor is None:
            return image
        if key != 'reflectivity':
            return in_metres(image, factor)
        return np.asarray(image.astype(np.float32) * np.float32(factor))

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        images = self._source.frames(key)
        if self._order is not None:
            images = _in_order(images, self._order)
        return (self._scaled(key, image) for image in images)


def _in_order(images: Iterator[np.ndarray], order: np.ndarray) -> Iterator[np.ndarray]:
    # Keeps only images that come before one that belongs before them.
    wanted = set(order.tolist())
    kept: dict[int, np.ndarray] = {}
    source = enumerate(images)
    for number in order.tolist():
        while number not in kept:
            at, image = next(source)
            if at in wanted:
                kept[at] = image
        yield kept.pop(number)
