"""Bring a recording as people have it into the form that all commands expect."""

from functools import partial

from flexx2_sim_ros.recording.corrections import ChangedRecording, in_metres
from flexx2_sim_ros.recording.reader import ONE_EACH, RecordingReader
from flexx2_sim_ros.recording.stamps import in_time
import numpy as np

# Units that people use by mistake: millimetres, and reflectivity in percent or bytes.
TRUSTED = 'depth', 'clean_depth', 'reflectivity'  # keys whose values tell the unit
_FARTHEST = 100.0  # metres; beyond what a depth camera sees, and 0.1 m in millimetres
_BRIGHTEST = 10.0  # reflectivity that an amplitude may imply
_SCALES = {100: 'percent', 255: 'bytes', 65535: '16 bits'}  # of reflectivity


def tidy(reader: RecordingReader, units: bool = True) -> RecordingReader:
    """
    Return a recording with rising stamps, depth in metres and reflectivity up to 1.

    Notes say what is changed. With ``units``, values tell the units; else the user has said them.
    """
    order, notes = in_time(reader.stamp_ns, str(reader.path))
    factors: dict[str, float] = {}
    for key in TRUSTED if units else ():
        factor, note = factor_of(key, _first(reader, key), str(reader.path))
        if note:
            factors[key] = factor
            notes.append(note)
    if order is None and not factors:
        return reader
    change = {key: partial(_scaled, key, factor) for key, factor in factors.items()}
    arrays = dict(reader.arrays)
    for key, array in arrays.items():
        arrays[key] = array = change[key](array) if key in change else array
        each = key in ONE_EACH and array.ndim in (1, 3) and len(array) == len(reader.stamp)
        if each and order is not None:
            arrays[key] = array[order]
    return ChangedRecording(reader, arrays, change, notes, order)


def factor_of(key: str, image: np.ndarray | None, path: str) -> tuple[float, str]:
    """
    Return what an image must be multiplied with, and a note; 1 and no note in the usual unit.

    ``key`` is one of `TRUSTED`; ``image`` are some of its values (not finite and not positive ones
    say nothing), or None; ``path`` is for the note.
    """
    if image is None or image.dtype.kind not in 'fiu':
        return 1.0, ''
    with np.errstate(invalid='ignore'):
        values = image.astype(np.float64)
        values = values[(values > 0) & (values < 1e6)]
    middle = float(np.median(values)) if len(values) else 0.0
    if key != 'reflectivity':
        if middle <= _FARTHEST:
            return 1.0, ''
        return 0.001, f'{path}: {key}: its median is {middle:.4g}: taken for millimetres'
    most = float(values.max()) if middle > 1 else 0.0  # single pixels may shine
    for scale, name in _SCALES.items():
        if _BRIGHTEST < most <= scale:
            return 1 / scale, f'{path}: {key}: up to {most:.4g}: taken for {name}'
    return 1.0, ''


def _first(reader: RecordingReader, key: str) -> np.ndarray | None:
    # The first image that has a value.
    if key in reader.arrays:
        return reader.arrays[key]
    images = reader.frames(key) if key in reader.layouts else iter(())
    return next((image for image in images if np.nan_to_num(image).any()), None)


def _scaled(key: str, factor: float, image: np.ndarray) -> np.ndarray:
    if key != 'reflectivity':
        return in_metres(image, factor)
    return np.asarray(image.astype(np.float32) * np.float32(factor))
