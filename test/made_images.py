"""Folders of PNG files with a calibration."""

from io import BytesIO

import numpy as np
from PIL import Image
import yaml

SIZE = 8, 10
K = [60.0, 0.0, 4.5, 0.0, 61.0, 3.5, 0.0, 0.0, 1.0]
EIGHT = [0.1, -0.2, 0.001, 0.002, 0.05, 0.3, 0.2, 0.1]
COUNT = 3


def counts(seed=1, shape=(COUNT, *SIZE)):
    """Return (COUNT, H, W) uint16 millimetres, 0 for invalid."""
    images = np.random.default_rng(seed).integers(300, 4000, shape).astype(np.uint16)
    images[:, 2, 3] = 0
    return images


def metres(unit=0.001, **given):
    images = counts(**given)
    return np.where(images > 0, images * np.float32(unit), np.nan)


def ost(**changes):
    """Return a file as camera_calibration writes it."""
    height, width = SIZE
    content = {
        'image_width': width,
        'image_height': height,
        'camera_name': 'flexx',
        'camera_matrix': {'rows': 3, 'cols': 3, 'data': K},
        'distortion_model': 'plumb_bob',
        'distortion_coefficients': {'rows': 1, 'cols': 5, 'data': EIGHT[:5]},
        'rectification_matrix': {'rows': 3, 'cols': 3, 'data': [1, 0, 0, 0, 1, 0, 0, 0, 1]},
        'projection_matrix': {'rows': 3, 'cols': 4, 'data': [60.0] * 12},
    }
    return yaml.safe_dump({k: v for k, v in (content | changes).items() if v is not None})


def save(path, pixels):
    path.parent.mkdir(exist_ok=True, parents=True)
    Image.fromarray(pixels).save(path)


def encoded(pixels, form='PNG'):
    """Return the bytes of an image file."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, form)
    return file.getvalue()


def folder_of(path, names):
    for name, image in zip(names, counts(), strict=True):
        save(path / name, image)
    (path / 'ost.yaml').write_text(ost())
    return path
