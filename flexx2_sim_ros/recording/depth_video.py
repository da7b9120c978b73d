"""Depth in videos of 12 bits, as LeRobot writes them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, one_sentence, shown, shown_path
from flexx2_sim_ros.limits import is_finite
import numpy as np

_CODES = 4096
_FARTHEST = 1000.0  # metres
_FORMAT = 'gray12le'  # another one would be converted, which changes the codes
_TOLERANCE = 1e-3  # seconds; float32 stamps of two hours are exact to half of it
_MARGIN = 64  # pixels that a codec may add to either side


@dataclass(frozen=True)
class Coding:
    """
    How depth becomes codes: in equal steps of depth, or of the logarithm of depth + shift.

    ``depth_min`` and ``depth_max`` are the depth of the first and the last code; with ``shift``,
    in metres.
    """

    depth_min: float
    depth_max: float
    shift: float
    use_log: bool

    def table(self) -> np.ndarray:
        """
        Return the depth of each code: (4096,) float32 metres.

        The first and the last one are NaN: they also stand for what is nearer, such as the 0 of
        invalid pixels, and for what is farther.
        """
        ends = np.array([self.depth_min, self.depth_max])
        shift = self.shift if self.use_log else 0.0
        low, high = np.log(ends + shift) if self.use_log else ends
        steps = np.linspace(low, high, _CODES)
        depth = ((np.exp(steps) - shift) if self.use_log else steps).astype(np.float32)
        depth[[0, -1]] = np.nan
        return depth

    def step(self, depth: float) -> float:
        """Return how many metres two codes are apart, at the code nearest to a depth."""
        table = self.table()[1:-1]
        return float(np.diff(table)[np.abs(table[:-1] - depth).argmin()])


def coding_of(where: str, info: Mapping[str, Any]) -> Coding:
    """
    Return the coding of a feature.

    ``info`` is its ``info`` in ``meta/info.json``, with the keys ``video.depth_min`` and so on,
    and ``where`` file and feature, for errors. Raises InputError when a key is missing or is no
    number that can be.
    """
    found: dict[str, Any] = {}
    for name in ('depth_min', 'depth_max', 'shift'):
        found[name] = info.get(f'video.{name}')
        if not is_finite(found[name]) or abs(found[name]) > _FARTHEST:
            raise InputError(
                f'{where}: video.{name}: must be metres, at most {_FARTHEST:g}, without which the '
                f'depth of the video is not known, got {shown(found[name])}'
            )
    use_log = info.get('video.use_log')
    if not isinstance(use_log, bool):
        raise InputError(f'{where}: video.use_log: must be true or false, got {shown(use_log)}')
    coding = Coding(use_log=use_log, **found)
    if not 0 <= coding.depth_min < coding.depth_max:
        raise InputError(
            f'{where}: video.depth_max: must be above video.depth_min, {coding.depth_min:g}, '
            f'which is not below 0, got {coding.depth_max:g}'
        )
    if use_log and coding.depth_min + coding.shift <= 0:
        raise InputError(
            f'{where}: video.shift: must be above {-coding.depth_min:g}, got {coding.shift:g}'
        )
    return coding


def depth_frames(
    path: Path, coding: Coding, times: np.ndarray, size: tuple[int, int]
) -> Iterator[np.ndarray]:
    """
    Iterate over images of an MP4 video, (H, W) float32 metres, NaN where invalid; needs PyAV.

    ``times`` are the (T,) rising seconds of the images that are wanted, in the video; ``size`` is
    the height and width that it must have. Raises InputError when it cannot be read, has another
    size or format, or lacks an image.
    """
    import av

    name, table = shown_path(path), coding.table()
    if not is_regular_file(path):
        raise InputError(f'{name}: must be a video, got no file')
    left = times.tolist()[::-1]
    # Opened here, as one format: FFmpeg would follow what a playlist names.
    with (
        one_sentence(f'{name}: cannot be read'),
        path.open('rb') as file,
        av.open(file, 'r', format='mp4') as container,
    ):
        stream = container.streams.video[0]
        pixels = (size[0] + _MARGIN) * (size[1] + _MARGIN)
        stream.codec_context.options = {'max_pixels': str(pixels)}
        container.seek(max(0, round(left[-1] / (stream.time_base or 1)) - 1), stream=stream)
        for frame in container.decode(stream):
            got = frame.height, frame.width, frame.format.name
            if got != (*size, _FORMAT):
                raise InputError(
                    f'{name}: must be {size[1]} x {size[0]} pixels of {_FORMAT}, got {got[1]} x '
                    f'{got[0]} of {got[2]}'
                )
            time = -1.0 if frame.time is None else frame.time
            if time > left[-1] + _TOLERANCE:
                break
            if time >= left[-1] - _TOLERANCE:
                left.pop()
                yield table[frame.to_ndarray()]
                if not left:
                    return
        raise InputError(f'{name}: must have an image at {left[-1]:.4f} s, got none')
