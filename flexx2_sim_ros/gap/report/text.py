"""Names and fractions as text for people."""

from collections.abc import Sequence


def spaced(name: str) -> str:
    """Return a name without underscores."""
    return name.replace('_', ' ')


def listed(names: Sequence[str]) -> str:
    """Return the names of effects as text: none, one, or several with commas and `and`."""
    shown = list(map(spaced, names))
    return ' and '.join(filter(None, [', '.join(shown[:-1]), shown[-1]])) if shown else ''


def percent(fraction: float) -> str:
    """Return a fraction in percent, as text."""
    return f'{100 * fraction:.0f} %'
