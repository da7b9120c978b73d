"""A recording whose depth is processed as it is read."""

from collections.abc import Iterator

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.processing.chain import Chain
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.recording.reader import Content, Layout, ONE_EACH, RecordingReader
import numpy as np


class ProcessedRecording(RecordingReader):
    """
    The depth of a recording after a chain; other images at the same pixels, by the nearest.

    What the chain keeps is not used. Raises InputError when the images are too small for the
    stages.
    """

    def __init__(self, reader: RecordingReader, chain: Chain) -> None:
        """Find the lens and which moments remain."""
        self._reader, self._stages = reader, chain.stages
        count, height, width = reader.shape
        try:
            lens = chain.lens(Intrinsics.from_matrix(reader.K, width, height, reader.distortion))
        except InputError as error:
            raise InputError(f'{reader.path}: {error}') from error
        self._kept = chain.kept(reader.stamp_ns)
        layouts = {
            key: Layout(one.dtype, (lens.height, lens.width))
            for key, one in reader.layouts.items()
        }
        stages = ', '.join(one.name for one in chain.stages)
        arrays = {**reader.arrays, 'K': lens.matrix, 'processed': np.array(stages)}
        for key in set(arrays) & set(ONE_EACH):
            if arrays[key].shape[-2:] == (height, width):
                arrays[key] = chain.picked(arrays[key])
            if arrays[key].shape[:1] == (count,) and arrays[key].ndim != 2:
                arrays[key] = arrays[key][self._kept]
        if reader.assumed_stamps:
            arrays['stamp_ns'] = reader.stamp_ns[self._kept]
        content = Content(layouts, arrays, reader.notes, reader.changes, int(self._kept.sum()))
        super().__init__(reader.path, reader.camera, content, reader.profile)

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over processed depth, or over other images at its pixels."""
        chain, dtype = Chain(self._stages), self.layouts[key].dtype
        for image, stamp, kept in zip(
            self._reader.frames(key), self._reader.stamp_ns, self._kept, strict=True
        ):
            if key != 'depth':
                if kept:
                    yield chain.picked(image)
                continue
            processed = chain.step(image, int(stamp))
            if processed is not None:
                yield processed.astype(dtype, copy=False)
