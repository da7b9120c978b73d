"""
One function an effect: on a scene made for it, it changes what its parameters say.

Direction and within 15 %, against formulas written here, not those of the effect; a file for each
family of effects. Cameras with and without an effect share their noise, so differences
show the effect alone; `QUIET` has none at all. All is seeded; where something random is measured,
the tolerance is at least 6 standard errors (false failure below 2e-9 were the seeds to change).
"""

from signatures import (  # noqa: F401  Each registers its signatures.
    delay,
    dropout,
    filtering,
    geometry,
    mixing,
    motion,
    noise,
    wrapping,
)
from signatures.tools import pair, QUIET, SIGNATURES

__all__ = ['pair', 'QUIET', 'SIGNATURES']
