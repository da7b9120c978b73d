"""Entry points of other packages, also where one installed package is damaged."""

from collections.abc import Callable, Iterator
from importlib.metadata import distributions, EntryPoint
from pathlib import Path


def entry_points(
    group: str, leave_out: Callable[[str, BaseException], None]
) -> Iterator[EntryPoint]:
    """
    Yield the entry points of a group, for example ``flexx2_sim_ros.effects``.

    ``leave_out`` is called with the name of each distribution that cannot be read, and the error:
    it must not hide the entry points of other distributions.
    """
    seen = set()
    for distribution in distributions():
        try:
            name = distribution.metadata['Name']
            points = [point for point in distribution.entry_points if point.group == group]
        except Exception as error:
            leave_out(Path(str(getattr(distribution, '_path', distribution))).name, error)
            continue
        if name is None or name not in seen:
            yield from points
        seen.add(name)
