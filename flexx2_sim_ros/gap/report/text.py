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
    """
    Return a number with a few digits, never with an exponent.

    Large numbers are rounded to whole ones, very small numbers to six decimals.
    """
    text = f'{number:.{digits}g}'
    if 'e' not in text:
        return text
    return f'{number:.0f}' if abs(number) >= 1 else f'{number:z.6f}'.rstrip('0').rstrip('.')


def percent(fraction: float) -> str:
    """Return a fraction in percent, as text."""
    return f'{100 * fraction:z.0f} %'  # z: no minus before a zero


def moved(share: float, what: str, ending: str = 's') -> str:
    """
    Return that a fraction is taken away from `what`, or added to it (`share` below 0).

    `ending` is that of the verb: empty after several subjects, or after ``would``.
    """
    if round(share, 2) < 0:
        return f'add{ending} {percent(-share)} to {what}'
    return f'take{ending} away {percent(share)} of {what}'
