"""
What each constant of the diagnosis says of itself: unit, meaning, and what it comes from.

The constants are in the modules `data`, `features`, `inference` and `forms`, each for the
folder of that name in ``gap/``. What belongs to one effect (the values that are simulated of
it, how much it is doubted) is in that effect's own file.

Most values were chosen by hand while `DEVELOPMENT` was run on seeds below 100, until campaigns
without an effect gave ``none`` and those with one named it; the tables of these runs were not
kept. A value of which no trial is on record is `ASSUMED`. `DEFINITION` marks what only fixes a
resolution or a unit.
"""

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import TypeVar

T = TypeVar('T')
DEVELOPMENT = (
    'python -m bench.gap_development of aac5156 --seeds <below 100>; by hand, tables not kept'
)
FIRST_RELEASE = (
    'raised from 4.5 after flexx2 gap benchmark --seed-set test --release of commit e3bc15f, '
    'new test seeds were drawn after that'
)
MANY = 'python -m bench.gap_many --count 4,8,12 --seeds 1-5; by hand, tables not kept'
ASSUMED = 'assumed; no trial is on record'
DEFINITION = 'definition'


def constant(value: T, unit: str, meaning: str, source: str = ASSUMED) -> T:
    """Return a dataclass field: a constant with its unit, meaning and source."""
    about = {'unit': unit, 'meaning': meaning, 'source': source}
    return field(default=value, metadata=about)


def table(values: Mapping[str, T], unit: str, meaning: str, source: str) -> Mapping[str, T]:
    """Return a dataclass field: a table of constants with their unit, meaning and source."""
    about = {'unit': unit, 'meaning': meaning, 'source': source}
    return field(default_factory=lambda: MappingProxyType(dict(values)), metadata=about)
