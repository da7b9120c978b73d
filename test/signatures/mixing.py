"""Light of several surfaces in one pixel."""

import math

from boards import board, K
import numpy as np

from signatures.tools import (
    close,
    pair,
    QUIET,
    RAY_X,
    RAY_Y,
    SHAPE,
    shift,
    signature,
    SPEED_OF_LIGHT,
    step,
    U,
    V,
    wall,
    wave_number,
)


def mixtures(near, far, numbers, shares):
    """Return the light of the columns at a step, (frequencies, rows, 2), by what they see."""
    own, other = np.array([near, far]), np.array([far, near])
    lights = [np.exp(1j * numbers[:, None, None] * z) / z**2 for z in (own, other)]
    return (1 - shares) * lights[0] + shares * lights[1]


def shares_at(step_to, near, far):
    """Return how much of the other side the two columns at a step see, from their depths."""
    k, grid = wave_number(), np.linspace(0, 0.5, 5001)
    mixed = mixtures(near, far, np.array([k]), np.repeat(grid[:, None], 2, 1))[0]
    seen = np.angle(mixed * np.exp(-1j * k * np.array([near, far]))) / k + [near, far]
    return np.stack(
        [np.interp(step_to[:, 0], seen[:, 0], grid), np.interp(-step_to[:, 1], -seen[:, 1], grid)],
        axis=1,
    )


@signature
def flying_pixels():
    near, far = 1.2, 2.0
    assert far - near < SPEED_OF_LIGHT / (4 * 60e6)
    clean = step(near, far)
    for strength in (0.5, 1.0, 1.8):
        side = 1.5 * strength
        frame, _ = pair('flying_pixels', clean, profile=QUIET, strength=strength, footprint=1.5)
        both = frame.depth[:, 111:113]
        assert ((both >= np.float32(near)) & (both <= np.float32(far))).all()
        np.testing.assert_array_equal(
            np.delete(frame.depth, (111, 112), axis=1),
            np.delete(clean.astype(np.float32), (111, 112), axis=1),
        )
        # The border is anywhere between the two pixels; a square around each sees what is beyond.
        shares = shares_at(both, near, far)
        left = shares[:, 0]
        away = np.where(left > 1e-4, side / 2 - side * left, np.nan)
        right = np.maximum(side / 2 - 1 + away, 0) / side
        seen = left > 1e-4
        close(shares[seen, 1], right[seen], rel=1e-2, within=1e-3)
        assert abs(seen.mean() - min(side / 2, 1)) < 0.2  # 172 rows: at least 5 sigma
        assert away[seen].min() < 0.1
        assert away[seen].max() > 0.7 * min(side / 2, 1)
        close(
            frame.amplitude[:, 111:113] * np.hypot(1, np.hypot(RAY_X, RAY_Y))[:, 111:113],
            abs(mixtures(near, far, np.array([wave_number()]), shares)[0]),
            rel=0.02,
        )
    frame, _ = pair('flying_pixels', clean, profile=QUIET, footprint=0.0)
    np.testing.assert_array_equal(frame.depth, clean.astype(np.float32))
    # Along the step the walls may slope: they go on, and are divided evenly.
    slope = clean + 0.004 * (V - 86)
    frame, _ = pair('flying_pixels', slope, profile=QUIET, footprint=1.0)
    same = frame.depth[:, 111:113] == slope.astype(np.float32)[:, 111:113]
    assert (same.sum(1) == 1).all()  # The border is nearer to one of the two.
    # Each frequency mixes for itself. Across a high step they see different distances, and
    # unwrapping finds one for both.
    frame, _ = pair('flying_pixels', clean, profile=QUIET)
    shares = shares_at(frame.depth[:, 111:113], near, far)
    for more in ({}, {'frequency_factor': 1.0}):
        for far in np.linspace(2.0, 4.2, 9):
            frame, _ = pair(
                'flying_pixels', step(near, far), profile=QUIET, usecase='Mode_9_30fps', **more
            )
            length = np.hypot(1, np.hypot(RAY_X, RAY_Y))[:, 111:113] if more else 1.0
            close(frame.depth[:, 111:113], agreed(near, far, shares, length), rel=1e-3)


def agreed(near, far, shares, length):
    """Return the depths of the two columns at a step, as cameras of 80 and 60 MHz unwrap them."""
    numbers = 4e6 * math.pi * np.array([80.0, 60.0]) / SPEED_OF_LIGHT
    weights = np.array([16.0, 9.0]) / 25
    wraps = np.stack(np.meshgrid(np.arange(5), np.arange(4), indexing='ij'), -1).reshape(-1, 2)
    own, other = np.array([near, far]) * length, np.array([far, near]) * length
    lights = [np.exp(1j * numbers[:, None, None] * z) / z**2 for z in (own, other)]
    angle = np.angle((1 - shares) * lights[0] + shares * lights[1]) % (2 * math.pi)
    seen = (angle[..., None] + 2 * math.pi * wraps.T[:, None, None]) / numbers[:, None, None, None]
    mean = np.tensordot(weights, seen, 1)
    misfit = np.tensordot(weights, (seen - mean) ** 2, 1)
    misfit[mean > SPEED_OF_LIGHT / 40e6] = np.inf
    best = np.argmin(misfit, axis=-1)[..., None]
    return np.take_along_axis(mean, best, -1)[..., 0] / length


def corner(apex):
    """Return two walls that meet at right angles on the optical axis."""
    return apex / (1 + np.abs(RAY_X))


def bounce(clean, reflectivity, columns, k):
    """Return the error of depth in row 86 of a corner, by the light of all pixels."""
    points = np.stack([RAY_X, RAY_Y, np.ones(SHAPE)], -1) * clean[..., None]
    normals = np.stack([-np.sign(RAY_X), 0 * U, -np.ones(SHAPE)], -1) / math.sqrt(2)
    ranges = np.linalg.norm(points, axis=-1)
    cosine = -(normals * points).sum(-1) / ranges
    solid = (clean / ranges) ** 3 / (K[0, 0] * K[1, 1])
    power = reflectivity * solid  # of a pixel: irradiance cos / r^2 times area solid r^2 / cos
    errors = []
    for column in columns:
        here, normal = points[86, column], normals[86, column]
        way = points - here
        length = np.linalg.norm(way, axis=-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            light = (
                power
                * np.maximum(way @ normal, 0)
                * np.maximum(-(way * normals).sum(-1), 0)
                / (math.pi * length**4)
            )
        light[86, column] = 0
        detour = ranges + length - ranges[86, column]
        direct = cosine[86, column] / ranges[86, column] ** 2
        gamma = (light * np.exp(0.5j * k * detour)).sum() / direct
        errors.append(np.angle(1 + gamma) / k * clean[86, column] / ranges[86, column])
    return np.array(errors)


@signature
def multipath():
    columns = [8, 30, 60, 80, 95, 130, 150, 190, 215]
    for apex, reflectivity in ((1.0, 0.9), (2.0, 0.6)):
        clean = corner(apex)
        frame, base = pair('multipath', clean, 0, np.full(SHAPE, reflectivity), profile=QUIET)
        error = frame.depth.astype(np.float64) - base.depth
        close(error[86, columns], bounce(clean, reflectivity, columns, wave_number()))
        assert (error > 0).all()
        assert (frame.amplitude[:, 100:124] > 1.02 * base.amplitude[:, 100:124]).all()
        # No detour at the apex itself, hence least there: it stands before the planes that fit
        # the walls.
        ridge, between, far = error[86, 111], error[86, 60:90].max(), error[86, 0]
        assert ridge < far < between
        walls = error[86, 20:95]
        fit = np.polyfit(np.arange(20, 95), walls + clean[86, 20:95], 3)
        assert error[86, 111] + clean[86, 111] < np.polyval(fit, 111) - 0.25 * between
    twice = shift('multipath', clean, 0, np.full(SHAPE, 0.2), strength=2.0, profile=QUIET)
    once = shift('multipath', clean, 0, np.full(SHAPE, 0.4), profile=QUIET)
    close(twice[86, columns], once[86, columns], rel=1e-3)
    for flat in (wall(1.0), board(1.0, 40).depth):
        assert np.abs(shift('multipath', flat, profile=QUIET)).max() < 1e-5


@signature
def stray_light():
    clean, k = step(0.8, 2.0), wave_number()
    reflectivity = np.where(U < 112, 0.9, 0.05)
    cosine = 1 / np.hypot(1, np.hypot(RAY_X, RAY_Y))
    light = reflectivity * cosine / clean**2 * np.exp(1j * k * clean)
    width = 0.2 * SHAPE[1]

    def kernel(y, x):
        """Return a kernel that is half its peak at `width`."""
        return (1 + (2 ** (2 / 3) - 1) * (y**2 + x**2) / width**2) ** -1.5

    every = np.mgrid[-SHAPE[0] : SHAPE[0], -SHAPE[1] : SHAPE[1]]
    norm = kernel(*every).sum()
    for strength in (1.0, 2.0):
        frame, base = pair(
            'stray_light',
            clean,
            0,
            reflectivity,
            profile=QUIET,
            share=0.02,
            width=0.2,
            strength=strength,
        )
        error = frame.depth.astype(np.float64) - base.depth
        for y, x in ((40, 130), (86, 160), (86, 200), (150, 220), (86, 20)):
            scattered = (kernel(V - y, U - x) * light).sum() / norm
            mixed = light[y, x] + 0.02 * strength * scattered
            turned = np.angle(mixed / light[y, x]) / k
            close(error[y, x], turned, within=1e-4)
            close(frame.amplitude[y, x], abs(mixed), rel=0.05)
        # Dark and far is pulled towards bright and near; the other way round hardly.
        assert (error[:, 130:] < 0).all()
        assert np.abs(error[:, :90]).max() < 0.1 * np.abs(error[:, 130:]).min()
    # What sends no light of its own shows nothing but scattered light.
    black = np.where(U < 112, 0.9, 0.0)
    assert (shift('stray_light', clean, 0, black, profile=QUIET)[:, 130:] < -0.9).all()
