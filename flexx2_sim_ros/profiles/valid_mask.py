"""The pixels of a camera that may have depth, as an image in a file beside the profile."""

from dataclasses import dataclass
from pathlib import Path

from flexx2_sim_ros.atomic import whole
from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
import numpy as np

SUFFIXES = ('.png', '.npy')
_MOST_BYTES = 64 * 1024**2
_ROOM = 0.5 + 1e-6  # pixels beyond the image's border: what rounding makes of a pixel on it


@dataclass(frozen=True)
class ValidMask:
    """
    Which pixels of a camera's image may have depth; its distortion is not used.

    ``bits`` are eight pixels a byte, row by row, as `numpy.packbits` makes them; 1: may have
    depth.
    """

    bits: bytes
    camera: Intrinsics

    @property
    def image(self) -> np.ndarray:
        """Return it as (H, W) bool."""
        shape = self.camera.height, self.camera.width
        flat = np.unpackbits(np.frombuffer(self.bits, np.uint8), count=shape[0] * shape[1])
        return flat.reshape(shape).astype(bool)

    def outside(self, camera: Intrinsics) -> np.ndarray:
        """
        Return the pixels of another image that never have depth, (H, W) bool.

        That image may be a crop or have another resolution: rays are compared. True where the ray
        leaves the mask's image, too.
        """
        own = self.camera
        columns = (np.arange(camera.width) - camera.cx) / camera.fx * own.fx + own.cx
        rows = (np.arange(camera.height) - camera.cy) / camera.fy * own.fy + own.cy
        known = np.logical_and.outer(_inside(rows, own.height), _inside(columns, own.width))
        nearest = np.ix_(
            np.clip(np.rint(rows), 0, own.height - 1).astype(int),
            np.clip(np.rint(columns), 0, own.width - 1).astype(int),
        )
        outside: np.ndarray = ~(known & self.image[nearest])
        return outside


def _inside(places: np.ndarray, size: int) -> np.ndarray:
    inside: np.ndarray = (places >= -_ROOM) & (places <= size - 1 + _ROOM)
    return inside


def mask_of(image: np.ndarray, camera: Intrinsics) -> ValidMask:
    """Return (H, W) bool of a camera's whole image as a mask."""
    return ValidMask(np.packbits(image).tobytes(), camera)


def read_mask(path: Path, camera: Intrinsics) -> ValidMask:
    """
    Read a mask, of the size of the profile's camera.

    It is a PNG, or an ``.npy`` file of bool or whole numbers; what is not 0 (in a PNG: not black)
    may have depth. Raises InputError when the file cannot be read, or has another size or no pixel
    that may have depth.
    """
    name = shown_path(path)
    if path.suffix.lower() not in SUFFIXES or not is_regular_file(path):
        raise InputError(f'{name}: must be an existing {" or ".join(SUFFIXES)} file')
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(f'{name}: must be at most {_MOST_BYTES} bytes long')
    try:
        image = _read_image(path)
    except InputError:
        raise
    except Exception as error:  # A damaged .npy file raises errors of all kinds.
        raise InputError(
            f'{name}: must be an image, got no readable one: {shown(error)}'
        ) from error
    wanted = camera.height, camera.width
    if image.shape != wanted or image.dtype.kind not in 'biu':
        raise InputError(
            f'{name}: must be {wanted} bool or whole numbers, the size of the profile, got '
            f'{image.dtype} of shape {image.shape}'
        )
    if not image.any():
        raise InputError(f'{name}: must have a pixel that may have depth, got none')
    return mask_of(image != 0, camera)


def write_mask(path: Path, mask: ValidMask) -> None:
    """Write a mask as ``.npy``, whole or not at all."""
    with whole(path) as part, part.open('wb') as file:
        np.save(file, mask.image)


def _read_image(path: Path) -> np.ndarray:
    if path.suffix.lower() == '.npy':
        return np.asarray(np.load(path, allow_pickle=False))
    # Imported here: few profiles have a PNG, and all commands read a profile.
    from flexx2_sim_ros.png import read_mask_png

    return read_mask_png(path)
