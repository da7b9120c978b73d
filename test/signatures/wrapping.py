"""Depth beyond the range, and periods counted wrongly."""

import math

import numpy as np

from signatures.tools import close, pair, QUIET, signature, SPEED_OF_LIGHT, wall


@signature
def range_wrap():
    half = SPEED_OF_LIGHT / (2 * 60e6)
    for distance in (2.9, 3.7, 6.0):
        frame, base = pair('range_wrap', wall(distance), profile=QUIET)
        assert np.isnan(base.depth).all()
        close(frame.depth, distance % half, rel=1e-5)
    frame, _ = pair('range_wrap', wall(3.0), share=0.3, strength=2.0)
    close(np.isfinite(frame.depth).mean(), 0.6, rel=0.03)
    # Two frequencies: the lattice of c / 2f1 and c / 2f2, likelier the more noise there is.
    d1, d2 = SPEED_OF_LIGHT / 160e6, SPEED_OF_LIGHT / 120e6
    assert (round(d1, 2), round(d2, 2)) == (1.87, 2.5)
    shares = []
    for distance, strength in ((3.0, 1.0), (6.0, 1.0), (6.6, 1.0), (6.0, 2.0)):
        frame, base = pair(
            'range_wrap', wall(distance), np.arange(12), usecase='Mode_9_30fps', strength=strength
        )
        jump = (frame.depth - base.depth)[np.isfinite(base.depth)]
        jumped = np.isfinite(jump) & (np.abs(jump) > 0.1)
        shares.append(jumped.mean())
        sigma = np.nanmean(base.sigma)
        # Errors e of f^-1 each; apart by more than half a step d1 d2 / 7.5 m.
        apart = strength * sigma * math.sqrt((80**2 + 60**2) * (80**-2 + 60**-2))
        close(shares[-1], math.erfc(d1 * d2 / 7.495 / 2 / apart / math.sqrt(2)), within=1e-4)
        # By m steps: n wraps of each, weighted by f^2, less whole beats.
        lattice = np.array(
            [
                0.64 * d1 * a + 0.36 * d2 * b
                for a in range(-4, 5)
                for b in range(-3, 4)
                if abs(a * d1 - b * d2) < 1.3
            ]
        )
        assert all(np.abs(lattice - one).min() < 0.002 for one in np.unique(jump[jumped]))
    assert shares == sorted(shares)
    assert shares[0] == 0
    one_step = jump[jumped & (np.abs(jump + 0.64 * d1 + 0.36 * d2) < 0.01)]
    assert one_step.size > 0.4 * jumped.sum()
