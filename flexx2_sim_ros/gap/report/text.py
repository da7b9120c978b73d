"""Names and fractions as text for people."""


def spaced(name: str) -> str:
    """Return a name without underscores."""
    return name.replace('_', ' ')


def percent(fraction: float) -> str:
    """Return a fraction in percent, as text."""
    return f'{100 * fraction:.0f} %'
