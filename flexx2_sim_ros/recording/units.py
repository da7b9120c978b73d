"""Units that people use by mistake: millimetres, and reflectivity in percent or bytes."""

import numpy as np

TRUSTED = 'depth', 'clean_depth', 'reflectivity'  # keys whose values tell the unit
_FARTHEST = 100.0  # metres; beyond what a depth camera sees, and 0.1 m in millimetres
_BRIGHTEST = 10.0  # reflectivity that an amplitude may imply
_SCALES = {100: 'percent', 255: 'bytes', 65535: '16 bits'}  # of reflectivity


def factor_of(key: str, image: np.ndarray | None, path: str) -> tuple[float, str]:
    """
    Return what an image must be multiplied with, and a note; 1 and no note in the usual unit.

    Parameters
    ----------
    key : str
        One of `TRUSTED`.
    image : numpy.ndarray or None
        Some of its values; not finite and not positive ones say nothing.
    path : str
        The recording, for the note.

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
