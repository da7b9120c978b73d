"""Depth that is wrong by a function of distance, pixel, amplitude or time."""

import math

from boards import K
from flexx2_sim_ros.camera import Camera
import numpy as np

from signatures.tools import (
    close,
    QUIET,
    ramp,
    RAY_X,
    RAY_Y,
    SHAPE,
    shift,
    signature,
    U,
    wall,
    wave_number,
)


def harmonics(error, distance, frequency):
    """Return amplitudes of sine and cosine, orders 1 to 5, of an error over distance."""
    phase = wave_number(frequency) * distance
    design = np.stack([f(n * phase) for n in range(1, 6) for f in (np.sin, np.cos)], axis=1)
    return np.linalg.lstsq(design, error, rcond=None)[0]


@signature
def wiggling():
    clean = ramp(0.15, 2.35)
    given = {
        'a1': 0.006,
        'b1': 0,
        'a2': 0.0,
        'b2': -0.005,
        'a3': 0.004,
        'b3': 0.0,
        'a4': 0.0,
        'b4': 0.003,
    }
    for strength in (1.0, 3.0):
        seen = shift('wiggling', clean, strength=strength, **given)[86]
        valid = np.isfinite(seen)
        close(
            harmonics(seen[valid], clean[86][valid], 60e6),
            strength * np.array([*given.values(), 0, 0]),
            within=2e-5,
        )
    # Typical: the fourth harmonic, 3 mm RMS.
    seen = shift('wiggling', clean)[86]
    close(np.sqrt(np.nanmean(seen**2)), 0.003)
    # With two frequencies each has its own period; they are weighted by their squares.
    seen = shift('wiggling', ramp(0.15, 6.8), usecase='Mode_9_30fps', profile=QUIET)[86]
    z = np.linspace(0.15, 6.8, SHAPE[1])
    close(
        seen,
        0.0042
        * (0.64 * np.sin(4 * wave_number(80e6) * z) + 0.36 * np.sin(4 * wave_number(60e6) * z)),
        within=2e-5,
    )


@signature
def fixed_pattern():
    one = shift('fixed_pattern', wall(0.6), usecase='Mode_9_30fps')
    other = shift('fixed_pattern', ramp(1.0, 4.0), 10**9, usecase='Mode_9_30fps', strength=2.0)
    close(one.std(), 0.0015)
    close(other.std(), 0.003)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.999
    # Grain: it has no slow part, and neighbours do not share it.
    smooth = one.reshape(43, 4, 56, 4).mean(axis=(1, 3))
    assert smooth.std() < 0.2 * one.std()
    stranger = Camera(effects={'fixed_pattern': None}, seed=7, name='right')
    plain = Camera(seed=7, name='right')
    third = stranger.capture(wall(0.6), K, 0).depth - plain.capture(wall(0.6), K, 0).depth
    assert abs(np.corrcoef(one.ravel(), third.ravel())[0, 1]) < 6 / math.sqrt(one.size)


@signature
def amplitude_bias():
    levels = np.repeat([1.0, 0.5, 0.2, 0.1, 0.03, 0.01, 0.0], 32)
    amplitude = levels[None] / np.sqrt(1 + RAY_X**2 + RAY_Y**2) / 0.8**2
    seen = shift(
        'amplitude_bias',
        wall(0.8),
        0,
        np.broadcast_to(levels, SHAPE),
        slope=-0.004,
        intercept=0.002,
        knee=0.8,
        span=3.0,
        strength=1.5,
    )
    with np.errstate(divide='ignore'):
        wanted = 1.5 * (0.002 - 0.004 * np.clip(np.log(amplitude / 0.8), -3, 0))
    close(seen, wanted, rel=0.01, within=1e-6)
    # Typical: black squares seem farther than white ones, by mm.
    seen = shift('amplitude_bias', wall(1.2), 0, np.where(U < 112, 0.8, 0.08))
    close(np.median(seen[:, 150:]) - np.median(seen[:, :60]), 0.003 * math.log(10))


@signature
def offset():
    for bias, strength in ((0.005, 1.0), (-0.02, 2.5)):
        for distance in (0.5, 2.0):
            close(
                shift('offset', wall(distance), bias=bias, strength=strength),
                bias * strength,
                rel=1e-3,
            )


@signature
def depth_scale():
    for fraction, strength in ((0.02, 1.0), (-0.01, 2.5)):
        clean = ramp(0.6, 2.0)
        seen = shift('depth_scale', clean, fraction=fraction, strength=strength)
        close(seen, fraction * strength * clean, rel=1e-3)


@signature
def warm_up_drift():
    seconds = np.array([0.0, 60.0, 900.0, 1800.0, 7200.0])
    small = np.ones((4, 4))
    for uptime in (0.0, 900.0):
        seen = shift('warm_up_drift', wall(1.0), seconds + 55.0, uptime=uptime, strength=1.5)
        close(
            seen.mean(axis=(1, 2)),
            0.015 * np.exp(-(seconds + uptime) / 900.0),
            rel=0.01,
            within=1e-6,
        )
    camera = Camera(effects={'warm_up_drift': {'bias': 0.05}}, profile=QUIET)
    shown = [camera.capture(small, K, stamp).depth[0, 0] - 1 for stamp in (0.0, 900.0, 5.0)]
    close(shown, [0.05, 0.05 / math.e, 0.05], rel=0.01)  # An earlier stamp: switched on anew.
