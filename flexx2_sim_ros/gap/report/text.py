"""Names, numbers and fractions as text for people."""

from collections.abc import Sequence


def spaced(name: str) -> str:
    """Return a name without underscores."""
    return name.replace('_', ' ')


def listed(names: Sequence[str]) -> str:
    """Return the names of effects as text: none, one, or several with commas and `and`."""
    shown = list(map(spaced, names))
    return ' and '.join(filter(None, [', '.join(shown[:-1]), shown[-1]])) if shown else ''


def short(number: float, digits: int = 2) -> str:
    """Return a number with a few digits, or rounded to whole numbers; never with an exponent."""
    text = f'{number:.{digits}g}'
    return f'{number:.0f}' if 'e+' in text else text


def percent(fraction: float) -> str:
    """Return a fraction in percent, as text."""
    return f'{100 * fraction:.0f} %'
