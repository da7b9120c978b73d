"""An occupancy map by OctoMap."""

from typing import Any, ClassVar

from flexx2_sim_ros.consumers.consumer import CameraView
from flexx2_sim_ros.errors import InputError
import numpy as np
from scipy import ndimage

# Corner and size of the volume that is compared, metres and voxels, and the size of a voxel.
_FIRST, _VOXELS, _SIZE = (0.2, -1.0, -0.2), (40, 40, 24), 0.05
_FAR = 3.0  # metres: longer rays end there
_FRAMES = 3
_FREE, _OCCUPIED = 0, 1  # pyoctomap's labels; -1 is unknown


class OccupancyMap:
    """An occupancy map of OctoMap (pyoctomap): voxels of 5 cm up to 2.2 m ahead of the camera."""

    name = 'occupancy_map'
    measures: ClassVar[dict[str, str]] = {'wrongly_occupied': 'voxels', 'wrongly_free': 'voxels'}

    def __init__(self) -> None:
        """Load OctoMap."""
        try:
            import pyoctomap
        except ImportError as error:
            raise InputError(
                'needs pyoctomap, which is not installed: pip install flexx2_sim_ros[cost]'
            ) from error
        self._tree: Any = pyoctomap.OcTree
        axes = (
            low + _SIZE * (np.arange(count) + 0.5)
            for low, count in zip(_FIRST, _VOXELS, strict=True)
        )
        self._centres = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)

    def look(self, view: CameraView) -> np.ndarray:
        """Return (40, 40, 24) labels: 0 free, 1 occupied, -1 unknown."""
        tree = self._tree(_SIZE)
        for t in range(max(len(view.depth) - _FRAMES, 0), len(view.depth)):
            points = view.points(t)
            if len(points):
                tree.insertPointCloud(points, view.position, max_range=_FAR, lazy_eval=True)
        tree.updateInnerOccupancy()
        return np.asarray(tree.getLabels(self._centres)).reshape(_VOXELS)

    def errors(self, seen: np.ndarray, true: np.ndarray) -> dict[str, float]:
        """Return how many voxels are wrong; one voxel beside the truth is right."""
        around = np.ones((3, 3, 3), bool)
        near = ndimage.binary_dilation(true == _OCCUPIED, around)
        found = ndimage.binary_dilation(seen == _OCCUPIED, around)
        return {
            'wrongly_occupied': float(((seen == _OCCUPIED) & ~near & (true == _FREE)).sum()),
            'wrongly_free': float(((seen == _FREE) & (true == _OCCUPIED) & ~found).sum()),
        }
