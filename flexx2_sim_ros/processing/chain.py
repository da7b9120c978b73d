"""A chain of stages, with what they keep between images."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import takewhile
import logging
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import read_config
from flexx2_sim_ros.entry_points import entry_points
from flexx2_sim_ros.errors import InputError, shown, shown_path, unquoted
from flexx2_sim_ros.processing.stage import Stage
from flexx2_sim_ros.processing.stages import STAGES
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

GROUP = 'flexx2_sim_ros.processing'
_MOST = 50  # stages in a file; assumed
_log = logging.getLogger(__name__)


class Chain:
    """
    Stages one after the other, for one camera or for those of many environments.

    Examples
    --------
    >>> import numpy as np
    >>> chain = parse_chain([{'crop': {'left': 2}}, {'normalise': {'high': 2.0}}])
    >>> images, stamps = chain.run(np.ones((3, 4, 6), np.float32), np.arange(3))
    >>> images.shape, float(images.max())
    ((3, 4, 4), 0.5)

    """

    def __init__(self, stages: Sequence[Stage]) -> None:
        """Start without a memory."""
        self.stages = tuple(stages)
        self._memories: list[dict[str, Any]] = [{} for _ in self.stages]
        self._shape: tuple[int, ...] = ()
        self._last: int | None = None

    def step(self, images: np.ndarray, stamp: int) -> np.ndarray | None:
        """
        Process the images of one moment.

        Parameters
        ----------
        images : numpy.ndarray
            (H, W), or (N, H, W) of N environments; float32, metres, NaN where invalid.
        stamp : int
            Nanoseconds. Where it goes back, or the size changes, all starts anew.

        Returns
        -------
        numpy.ndarray or None
            (..., h, w) float32; None where a rate leaves this moment out.

        Raises
        ------
        InputError
            For images that are too small for the stages, or no images.

        """
        out = np.asarray(images, np.float32)
        if out.ndim < 2:
            raise InputError(f'images: must be of shape (..., H, W), got {out.shape}')
        if out.shape != self._shape or (self._last is not None and stamp < self._last):
            height, width = out.shape[-2:]
            self.lens(Intrinsics(width, height, width, height, 0.0, 0.0))  # complains
            self.reset()
        self._shape, self._last = out.shape, stamp
        for stage, memory in zip(self.stages, self._memories, strict=True):
            processed = stage.apply(out, int(stamp), memory)
            if processed is None:
                return None
            out = processed
        return np.array(out, np.float32)

    def run(self, images: Iterable[np.ndarray], stamps: Any) -> tuple[np.ndarray, np.ndarray]:
        """
        Process a sequence from its start.

        Parameters
        ----------
        images : iterable of numpy.ndarray
            (T, H, W), as for `step`.
        stamps : array_like
            (T,) int64, nanoseconds.

        Returns
        -------
        tuple of numpy.ndarray
            (t, h, w) float32 and (t,) int64, of the moments that are not left out.

        """
        self.reset()
        pairs = [
            (self.step(image, stamp), stamp) for image, stamp in zip(images, stamps, strict=True)
        ]
        kept = [(image, stamp) for image, stamp in pairs if image is not None]
        if not kept:
            raise InputError('images: must be one or more, got none')
        return np.stack([image for image, _ in kept]), np.array([stamp for _, stamp in kept])

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget earlier images: of all, or of the environments of a mask, (N,) bool."""
        if mask is None:
            self._memories = [{} for _ in self.stages]
            self._last = None
            return
        for memory in self._memories:
            memory['masked'] = True
            for key, kept in memory.items():
                for one in kept if key == 'images' else [kept]:
                    if isinstance(one, np.ndarray) and one.dtype == np.float32:
                        one[mask] = np.nan

    def kept(self, stamps: np.ndarray) -> np.ndarray:
        """Return (T,) bool: which moments of a sequence, (T,) nanoseconds, are not left out."""
        out = np.ones(len(stamps), bool)
        nothing = np.zeros((1, 1), np.float32)
        for stage in self.stages:
            memory: dict[str, Any] = {}
            for i in np.flatnonzero(out) if stage.leaves_out else ():
                out[i] = stage.apply(nothing, int(stamps[i]), memory) is not None
        return out

    def lens(self, camera: Intrinsics) -> Intrinsics:
        """Return the lens of the processed images; an `InputError` if there would be none."""
        for stage in self.stages:
            camera = stage.lens(camera)
        return camera

    def in_metres(self) -> tuple[Stage, ...]:
        """Return the stages before the first that makes other numbers of depth."""
        return tuple(takewhile(lambda stage: stage.in_metres, self.stages))

    def picked(self, images: np.ndarray) -> np.ndarray:
        """Return other images of the camera, (..., H, W), at the pixels of the processed ones."""
        for stage in self.stages:
            images = stage.picked(images)
        return images


@cache
def stage_kinds() -> dict[str, type[Stage]]:
    """Return all stages by name, with those of other packages; bad ones are named in the log."""
    kinds = {kind.name: kind for kind in STAGES}

    def leave_out(name: str, error: BaseException) -> None:
        _log.warning('processing: plug-in %s is left out: %s', unquoted(name), shown(error))

    for point in entry_points(GROUP, leave_out):
        try:
            kind = point.load()
            if not (isinstance(kind, type) and issubclass(kind, Stage)) or kind.name in kinds:
                raise InputError('must be a subclass of Stage with a name of its own')
            kind()
        except Exception as error:
            leave_out(point.name, error)
        else:
            kinds[kind.name] = kind
    return kinds


def parse_chain(stages: Any, where: str = 'process') -> Chain:
    """
    Make a chain from a list, as of a file.

    Parameters
    ----------
    stages : list
        Of tables with one name and its options, or of names.
    where : str
        What to call it in errors.

    Raises
    ------
    InputError
        Names what cannot be used.

    """
    if not isinstance(stages, list) or not len(stages) <= _MOST:
        raise InputError(f'{where}: must be a list of at most {_MOST} stages, got {shown(stages)}')
    kinds, found = stage_kinds(), []
    for one in stages:
        table = {one: None} if isinstance(one, str) else one
        if not isinstance(table, Mapping) or len(table) != 1 or next(iter(table)) not in kinds:
            raise InputError(
                f'{where}: must be stages out of {", ".join(kinds)}, each with a table of '
                f'options, got {shown(one)}'
            )
        try:
            found += [kinds[name].from_mapping(options) for name, options in table.items()]
        except InputError as error:
            raise InputError(f'{where}: {error}') from error
    return Chain(found)


def load_chain(path: str | Path) -> Chain:
    """
    Read a chain from a YAML file with ``schema: 1`` and ``process:``, a list of stages.

    Raises
    ------
    InputError
        When the file cannot be read or something in it cannot be used.

    """
    content = read_config(Path(path))
    if set(content) != {'schema', 'process'}:
        raise InputError(f'{shown_path(path)}: must have schema and process, and nothing else')
    return parse_chain(content['process'], f'{shown_path(path)}: process')
