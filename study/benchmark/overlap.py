"""Pixels that a diagnosis names, and those that an effect changes."""

from collections.abc import Iterable
import math
import re
from typing import Any

import numpy as np
from study.benchmark.partition import COVARIATES

# Other names for a covariate, and factors to the unit of `COVARIATES`.
_ALIASES = {
    'theta': 'incidence',
    'angle': 'incidence',
    'range': 'distance',
    'depth': 'distance',
    'z': 'distance',
    'fine_distance': 'distance',
}
_REGION = re.compile(r'image region row (\d+) of (\d+), column (\d+) of (\d+)')
_UNITS = {'mm': 1e-3, 'rad': 180 / math.pi, 'min': 60.0}


def overlap(where: Iterable[dict[str, Any]], pixels: dict[str, np.ndarray]) -> float:
    """
    Return the intersection over union of the affected pixels and the named ones.

    * `where`: the diagnosis's list: ``covariate``, ``low``, ``high``, ``unit``. A pixel is named
      if its covariate lies in the interval of any entry. ``all`` names everything, ``image region
      row 1 of 3, column 2 of 4`` that region; covariates that pixels do not have are ignored.
    * `pixels`: a uniform sample of the campaign's pixels, see `truth.Comparison.affected`

    Returns NaN where no pixel is affected.
    """
    affected, samples = pixels['affected'], pixels['samples']
    if not affected.any():
        return math.nan
    named = np.zeros(len(samples), bool)
    for entry in where:
        intervals = _intervals(entry)
        inside = np.full(len(samples), bool(intervals) or entry['covariate'] == 'all')
        for covariate, low, high in intervals:
            values = samples[:, COVARIATES.index(covariate)]
            inside &= (values >= low) & (values <= high)
        named |= inside
    return float((named & affected).sum() / (named | affected).sum())


def _intervals(entry: dict[str, Any]) -> list[tuple[str, float, float]]:
    # Covariate, low and high, in the units of `COVARIATES`; empty for other covariates.
    region = _REGION.fullmatch(entry['covariate'])
    if region:
        row, rows, column, columns = map(int, region.groups())
        return [
            ('y', (row - 1) / rows, row / rows),
            ('x', (column - 1) / columns, column / columns),
        ]
    covariate = _ALIASES.get(entry['covariate'], entry['covariate'])
    if covariate not in COVARIATES:
        return []
    factor = _UNITS.get(entry.get('unit') or '', 1.0)
    low, high = entry['low'], entry['high']
    return [
        (
            covariate,
            -math.inf if low is None else low * factor,
            math.inf if high is None else high * factor,
        )
    ]
