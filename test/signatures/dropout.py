"""Pixels without depth: too dark, too bright, too oblique."""

import math

from boards import board
from flexx2_sim_ros.camera import flexx2
import numpy as np

from signatures.tools import close, pair, RAY_X, RAY_Y, SHAPE, signature, STEP_5, U, wall


def logistic(logit, strength):
    """Return how often a chance is taken that is tried `strength` times."""
    return 1 - (1 - 1 / (1 + np.exp(-np.asarray(logit)))) ** strength


def lost(frame, base, where):
    """Return the share of pixels that have depth without the effect and none with it."""
    valid = where & np.isfinite(base.depth)
    assert valid.sum() > 1000
    return float(np.isnan(frame.depth[valid]).mean())


def check_amplitude(name, sign, half, slope, strength, **parameters):
    """Assert a logistic in the logarithm of the amplitude, rising or falling with it."""
    logits = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    off_axis = (np.hypot(RAY_X, RAY_Y) > math.tan(math.radians(14))) & (np.abs(U - 111) < 100)
    flat = np.sqrt(1 + RAY_X**2 + RAY_Y**2)
    shares = []
    for logit in logits:
        amplitude = half * math.exp(sign * logit / slope)
        distance = min(2.0, 1 / math.sqrt(amplitude))
        reflectivity = amplitude * distance**2 * flat
        assert (reflectivity[off_axis] <= 1.3).all()
        distance *= 0.8
        frame, base = pair(
            name,
            wall(distance),
            0,
            reflectivity * 0.64,
            half=half,
            slope=slope,
            strength=strength,
            **parameters,
        )
        shares.append(lost(frame, base, off_axis))
    close(shares, logistic(logits, strength))


@signature
def low_signal_dropout():
    for half, slope, strength in ((0.012, 3.0, 1.0), (0.1, 2.0, 2.5)):
        check_amplitude('low_signal_dropout', -1, half, slope, strength)
    frame, _ = pair('low_signal_dropout', wall(1.0), 0, np.where(U < 112, 1.0, 0.0))
    assert np.isnan(frame.depth[:, 120:]).all()
    assert np.isnan(frame.depth[:, :100]).mean() < 1e-3  # 2e-6


@signature
def random_dropout():
    # Of 300,000 pixels, a fraction is known to 0.1 %: 6 standard deviations are 0.6 %.
    for share, strength in ((0.05, 1.0), (0.3, 1.5)):
        shades = np.where(U < 112, 0.9, 0.1)
        frame, base = pair(
            'random_dropout', wall(1.5), np.arange(8), shades, share=share, strength=strength
        )
        for where in (U < 112, U >= 112):
            some = np.broadcast_to(where, base.depth.shape) & np.isfinite(base.depth)
            assert abs(np.isnan(frame.depth[some]).mean() - share * strength) < 0.006
    dead = np.where(U < 112, 0.0, 1.0)
    frame, base = pair('random_dropout', wall(1.5), np.arange(4), dead=dead)
    assert np.isnan(frame.depth[:, dead == 1]).all()
    np.testing.assert_allclose(frame.depth[:, dead == 0], base.depth[:, dead == 0], rtol=1e-6)


@signature
def motion_dropout():
    # A board before a wall grows by six columns a frame.
    mode, frames, speed = flexx2().mode('Mode_5_30fps'), np.arange(25), 6
    edges = 20 + speed * frames
    clean = np.where(edges[:, None, None] > U, 1.0, 1.5)
    taps = 4
    seconds = mode.raw_frames * (mode.exposure_us[1] + 600) * 1e-6 * (taps - 1) / taps
    columns = np.arange(SHAPE[1]) - edges[1:, None]  # beyond the edge
    for stretch, strength, stamp_at in ((2.0, 1.0, 1.0), (2.0, 1.0, 0.0), (1.0, 3.0, 0.5)):
        settings = {'stretch': stretch, 'strength': strength, 'stamp_at': stamp_at}
        frame, base = pair('motion_dropout', clean, frames * STEP_5, **settings)
        gone = np.isnan(frame.depth) & np.isfinite(base.depth)
        assert not gone[0].any()
        passed = stretch * strength * seconds * speed * 30  # columns
        close(gone[1:].sum() / gone[1:, :, 0].size, passed, rel=0.03)
        # What has seen the wall in this frame, and what will see the board.
        close(gone[1:, :][:, 0][columns >= 0].sum() / gone[1:, 0].sum(), 1 - stamp_at, within=0.08)
    frame, base = pair('motion_dropout', clean, frames * STEP_5, step=0.6, strength=4.0)
    assert np.array_equal(np.isnan(frame.depth), np.isnan(base.depth))


@signature
def saturation():
    for half, slope, strength in ((3.5, 6.0, 1.0), (2.0, 4.0, 2.5)):
        check_amplitude('saturation', 1, half, slope, strength, gloss=0.5, lobe_deg=4.0)
    # Head-on, a glossy surface sends more: (1 + gloss) times as much.
    incidence = np.arctan(np.hypot(RAY_X, RAY_Y))
    distance = 1 / math.sqrt(2.0)
    for low, high in ((0, 6), (18, 24)):
        ring = (np.degrees(incidence) >= low) & (np.degrees(incidence) < high)
        shares, wanted = [], []
        for gloss in (0.0, 0.6):
            frame, base = pair(
                'saturation',
                wall(distance),
                np.arange(8),
                lobe_deg=12.0,
                gloss=gloss,
                usecase='Mode_9_30fps',
            )
            shares.append(np.isnan(frame.depth[:, ring]).mean())
            lobe = 1 + gloss * np.exp(-((np.degrees(incidence) / 12) ** 2))
            logit = 6 * np.log(2.0 * np.cos(incidence) * lobe / 3.5)
            wanted.append(logistic(logit[ring], 1.0).mean())
        close(shares, wanted)
    # The gray image is white there.
    gone = np.isnan(frame.depth) & np.isfinite(base.depth)
    assert (frame.amplitude[gone] >= base.amplitude[gone]).all()
    # A spot's light bleeds along its columns, and falls by e in so many pixels.
    light, reach = np.full(SHAPE, 0.1), 8.0
    light[80, 60:160] = 1.0
    spot = {'usecase': 'Mode_9_30fps', 'gloss': 0.0, 'half': 0.4, 'slope': 4.0}
    frame, _ = pair('saturation', wall(1.0), np.arange(40), light, bleed=reach, **spot)
    for away in (0, 4, 8):
        bright = np.log(np.maximum(np.exp(-away / reach), 0.1) * math.cos(0.1) / 0.4)
        lost = np.isnan(frame.depth[:, [80 - away, 80 + away], 80:145]).mean()
        close(lost, logistic(4.0 * bright, 1.0), rel=0.1)
    assert np.isnan(frame.depth[:, 80, :40]).mean() < 0.05


@signature
def grazing_dropout():
    for half_deg, width_deg, strength in ((60.0, 4.0, 1.0), (50.0, 6.0, 2.0)):
        for distance in (0.5, 1.5):
            shares, wanted = [], []
            for turn in (40, 55):
                target = board(distance, turn)
                frame, base = pair(
                    'grazing_dropout',
                    target.depth,
                    np.arange(6),
                    half_deg=half_deg,
                    width_deg=width_deg,
                    distance=1.0,
                    strength=strength,
                    usecase='Mode_9_30fps',
                )
                logit = (np.degrees(target.incidence) - half_deg) / width_deg + np.log(
                    target.depth
                )
                for middle in (-1.5, 0.0, 1.5):
                    there = np.abs(logit - middle) < 0.25
                    valid = there & np.isfinite(base.depth)
                    if valid.sum() > 2000:
                        shares.append(np.isnan(frame.depth[valid]).mean())
                        wanted.append(logistic(logit[there], strength).mean())
            assert len(shares) >= 2
            close(shares, wanted)
