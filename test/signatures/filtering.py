"""Filters, and depth that comes in steps."""

import math

import numpy as np

from signatures.tools import close, pair, QUIET, ramp, SHAPE, signature, spread, step, wall


def neighbour_correlation(errors):
    return float(np.corrcoef(errors[:, :, 1:].ravel(), errors[:, :, :-1].ravel())[0, 1])


@signature
def spatial_filter():
    for mix, strength in ((0.9, 1.0), (0.3, 2.0)):
        smooth, plain = spread(
            'spatial_filter', wall(1.0), frames=8, mix=mix, strength=strength, gate=12.0
        )
        weights = np.full((3, 3), mix * strength / 9)
        weights[1, 1] += 1 - mix * strength
        close(smooth[:, 5:-5, 5:-5].var() / plain.var(), (weights**2).sum())
        close(
            neighbour_correlation(smooth[:, 5:-5, 5:-5]),
            (weights[:, 1:] * weights[:, :-1]).sum() / (weights**2).sum(),
        )
    # Typical: as measured on a Kinect v2.
    smooth, plain = spread('spatial_filter', wall(1.0), frames=8)
    assert 0.6 < neighbour_correlation(smooth[:, 5:-5, 5:-5]) < 0.7
    # A median of nine normals has 0.166 of their variance.
    smooth, plain = spread('spatial_filter', wall(1.0), frames=8, mix=1.0, gate=20.0, median=3.0)
    close(smooth[:, 5:-5, 5:-5].var() / plain.var(), 0.166)
    # Never across an edge.
    frame, _ = pair('spatial_filter', step(1.0, 2.0), profile=QUIET)
    np.testing.assert_array_equal(frame.depth, step(1.0, 2.0).astype(np.float32))


@signature
def temporal_filter():
    for share, strength in ((0.4, 1.0), (0.2, 3.0)):
        smooth, plain = spread(
            'temporal_filter', wall(1.0), frames=80, share=share, strength=strength
        )
        a, settled = share * strength, smooth[20:]
        close(np.mean(settled[1:] * settled[:-1]) / settled.var(), a, rel=0.03)
        close(settled.var() / plain.var(), (1 - a) / (1 + a), rel=0.03)
    # It starts afresh where depth changes by more than 6 sigma.
    clean = np.concatenate([np.full((5, *SHAPE), 1.0), np.full((1, *SHAPE), 1.5)])
    frame, base = pair('temporal_filter', clean, np.arange(6))
    np.testing.assert_allclose(frame.depth[5], base.depth[5], rtol=2e-7)


@signature
def quantisation():
    for size, strength in ((0.004, 1.0), (0.0117, 2.0)):
        frame, base = pair('quantisation', ramp(0.5, 2.0), step=size, strength=strength)
        q = size * strength
        steps = frame.depth.astype(np.float64) / q
        valid = np.isfinite(steps)
        assert np.abs(steps - np.rint(steps))[valid].max() < 1e-3
        rest = (frame.depth.astype(np.float64) - base.depth)[valid]
        assert np.abs(rest).max() < 0.501 * q
        close(rest.std(), q / math.sqrt(12), rel=0.05)
