"""Pictures that matplotlib draws, as PNG files."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import whole

_INVALID = '#3a3a3a'


@contextmanager
def picture(path: Path, *shape: int, dpi: int = 100, **more: Any) -> Iterator[tuple[Any, Any]]:
    """
    Yield a figure and its axes, as `pyplot.subplots` makes them; at the end it is a PNG file.

    Nothing is shown on a screen. Raises `InputError` when the file cannot be written.
    """
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(*shape, layout='constrained', **more)
    try:
        yield figure, axes
        with whole(path) as part:
            figure.savefig(part, dpi=dpi, format='png')
    finally:
        pyplot.close(figure)


def colours(name: str) -> Any:
    """Return a colour map in which invalid pixels, NaN, are dark gray."""
    from matplotlib import colormaps

    return colormaps[name].with_extremes(bad=_INVALID)
