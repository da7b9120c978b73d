"""Effects outside the catalogue: a diagnosis has to answer `unknown` or `partly`."""

import numpy as np


def _row_noise(depth, table):
    return depth + 0.002 * table['rng'].standard_normal((*depth.shape[:2], 1))


def _flicker(depth, table):
    phase = np.arange(len(depth))[:, None, None] * 2.1 + table['index']
    return depth + 0.003 * np.sin(phase)


def _column_bands(depth, table):
    return depth + 0.002 * (-1.0) ** (np.arange(depth.shape[2]) // 2)


def _lost_rows(depth, table):
    lost = table['rng'].random(depth.shape[:2]) < 0.04
    return np.where(lost[..., None], np.nan, depth)


def _slant_bias(depth, table):
    # Moves slanted pixels towards the camera; the slant is computed from the depth itself.
    clean = np.broadcast_to(table['clean_depth'], depth.shape)
    slope = np.abs(np.gradient(clean, axis=1)) + np.abs(np.gradient(clean, axis=2))
    return depth - np.clip(0.4 * slope, 0, 0.012)


def _vignette_noise(depth, table):
    y, x = (np.linspace(-1, 1, n) for n in depth.shape[1:])
    radius = np.hypot(y[:, None], x[None, :])
    return depth + 0.003 * radius**4 * table['rng'].standard_normal(depth.shape)


def _ring(depth, table):
    y, x = (np.linspace(-1, 1, n) for n in depth.shape[1:])
    return depth + 0.006 * np.cos(9 * np.hypot(y[:, None], x[None, :]))


def _blobs(depth, table):
    count, height, width = depth.shape
    coarse = table['rng'].standard_normal((count, -(-height // 8), -(-width // 8)))
    return depth + 0.002 * coarse.repeat(8, axis=1).repeat(8, axis=2)[:, :height, :width]


def _stutter(depth, table):
    out = depth.copy()
    out[3::4] = out[2::4][: len(out[3::4])]
    return out


def _dead_patch(depth, table):
    out = depth.copy()
    height, width = depth.shape[1:]
    out[:, height // 5 : height // 3, width // 6 : width // 3] = np.nan
    return out


NOVEL = {
    'row_noise': _row_noise,
    'flicker': _flicker,
    'column_bands': _column_bands,
    'lost_rows': _lost_rows,
    'slant_bias': _slant_bias,
    'vignette_noise': _vignette_noise,
    'ring': _ring,
    'blobs': _blobs,
    'stutter': _stutter,
    'dead_patch': _dead_patch,
}
# Of these, what is a special form of an effect of the catalogue: the answer may name that effect.
# Bands are the same in every scene and differ from one pixel to the next: the map of a fixed
# pattern holds them. A ring is the same in every scene, too, but smooth: no such map holds it.
NAMEABLE = {'column_bands': 'fixed_pattern'}
