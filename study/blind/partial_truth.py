"""Ground truth that is unknown in parts of the image, as it is after a room was scanned."""

from pathlib import Path

from flexx2_sim_ros.atomic import whole
import numpy as np
from scipy import ndimage

_KNOWN = 0.7  # of all pixels, at most
_JUMP = 0.1  # relative step of depth to the next pixel, where scans have errors
_BORDER = 2  # pixels around a jump
_SIDE = 5  # a patch is a fifth of the image in both directions


def hide_truth(folder: Path, seed: int) -> None:
    """
    Hide about 30 % of the ground truth of all recordings of a campaign.

    * `folder`: recordings (``.npz``), which are written again
    * `seed`: of the places of the patches
    """
    for i, path in enumerate(sorted(folder.glob('*.npz'))):
        with np.load(path) as archive:
            content = dict(archive)
        clean = content['clean_depth']
        known = known_part(clean, seed + i)
        hidden = np.where(known, clean, np.float32(np.nan))
        with whole(path) as part, part.open('wb') as file:
            np.savez(file, **{**content, 'known': known, 'clean_depth': hidden})


def known_part(clean: np.ndarray, seed: int) -> np.ndarray:
    """
    Choose where the ground truth is known: not next to jumps of depth, nor in some patches.

    * `clean`: (H, W) or (T, H, W) metres
    * `seed`: of the places of the patches

    Returns bool, of the same shape.
    """
    frames = clean if clean.ndim == 3 else clean[None]
    rng = np.random.default_rng(seed)
    known = np.ones(frames.shape, bool)
    for image, mask in zip(frames, known, strict=True):
        with np.errstate(divide='ignore'):
            inverse = np.nan_to_num(1 / image, posinf=0.0)
        steps = np.hypot(*np.gradient(inverse))
        mask &= ~ndimage.binary_dilation(steps > _JUMP * inverse, iterations=_BORDER)
    height, width = frames.shape[1:]
    while known.mean() > _KNOWN:
        top, left = rng.integers(0, height), rng.integers(0, width)
        known[:, top : top + height // _SIDE, left : left + width // _SIDE] = False
    return known.reshape(clean.shape)
