"""Read PNG files (gray images and masks, within a limit of size), and encode small pictures."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
import warnings

from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, shown, shown_path
import numpy as np
from PIL import Image

MOST_PIXELS = 1 << 25
_BITS = {'1': 1, 'L': 8, 'I;16': 16, 'I;16B': 16, 'I': 16}  # of Pillow's modes for PNG


def check_png(path: Path, bits: tuple[int, ...]) -> tuple[int, int]:
    """
    Return the size of a gray PNG without reading its pixels.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    bits : tuple of int
        Which of 1, 8 and 16 bits a pixel may have.

    Returns
    -------
    tuple of int
        Height and width.

    Raises
    ------
    InputError
        When it is no PNG, too large, not gray, or has other bits.

    """
    with _opened(path) as image:
        return _checked(shown_path(path), image, bits)


def read_png(path: Path, bits: tuple[int, ...]) -> np.ndarray:
    """
    Read a gray PNG; parameters and errors as `check_png`.

    Returns
    -------
    numpy.ndarray
        (H, W) bool, uint8 or uint16.

    """
    with _opened(path) as image:
        return _pixels(shown_path(path), image, bits)


def decode_png(content: bytes, name: str, bits: tuple[int, ...]) -> np.ndarray:
    """
    Return the pixels of a gray PNG that is not in a file of its own.

    Parameters
    ----------
    content : bytes
        The PNG.
    name : str
        What to call it in errors.
    bits : tuple of int
        As for `check_png`.

    """
    with _decoding(BytesIO(content), name) as image:
        return _pixels(name, image, bits)


def read_mask_png(path: Path) -> np.ndarray:
    """
    Read a PNG of any kind as a mask.

    Parameters
    ----------
    path : pathlib.Path
        The file; transparency is not used.

    Returns
    -------
    numpy.ndarray
        (H, W) bool, False where the image is black.

    Raises
    ------
    InputError
        When it is no PNG or too large.

    """
    with _opened(path) as image:
        _check_size(shown_path(path), image)
        pixels = np.asarray(image if image.mode in _BITS else image.convert('RGB'))
        return np.asarray((pixels.reshape(*pixels.shape[:2], -1) > 0).any(axis=-1))


def encode_png(index: np.ndarray, palette: np.ndarray) -> bytes:
    """
    Return a PNG with a palette.

    Parameters
    ----------
    index : numpy.ndarray
        (H, W) uint8, the colour of each pixel.
    palette : numpy.ndarray
        (N, 3) uint8 red, green and blue of at most 256 colours.

    """
    image = Image.fromarray(np.ascontiguousarray(index, np.uint8)).convert('P')
    image.putpalette(palette.astype(np.uint8).tobytes())
    file = BytesIO()
    image.save(file, format='PNG', optimize=True)
    return file.getvalue()


def _pixels(name: str, image: Image.Image, bits: tuple[int, ...]) -> np.ndarray:
    _checked(name, image, bits)
    dtype = {1: bool, 8: np.uint8, 16: np.uint16}[_BITS[image.mode]]
    return np.array(image).astype(dtype)


def _checked(name: str, image: Image.Image, bits: tuple[int, ...]) -> tuple[int, int]:
    _check_size(name, image)
    if _BITS.get(image.mode) not in bits:
        kinds = {'RGB': 'colours', 'RGBA': 'colours', 'P': 'a palette', 'LA': 'transparency'}
        got = kinds.get(image.mode, f'{_BITS.get(image.mode, "unknown")} bits')
        raise InputError(
            f'{name}: must be a gray PNG of {" or ".join(map(str, bits))} bits a pixel, got {got}'
        )
    return image.height, image.width


def _check_size(name: str, image: Image.Image) -> None:
    if image.width * image.height > MOST_PIXELS:
        raise _too_large(name, f'{image.width} x {image.height}')


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    if not is_regular_file(path):
        raise InputError(f'{shown_path(path)}: must be a PNG file, got none')
    with _decoding(path, shown_path(path)) as image:
        yield image


@contextmanager
def _decoding(source: Path | BytesIO, name: str) -> Iterator[Image.Image]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', Image.DecompressionBombWarning)
            with Image.open(source, formats=['PNG']) as image:
                yield image
    except InputError:
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise _too_large(name, 'more') from error
    except Exception as error:  # Pillow lets errors of all kinds out.
        raise InputError(
            f'{name}: must be a PNG, got a file that is none or is damaged '
            f'({shown(type(error).__name__)})'
        ) from error


def _too_large(name: str, got: str) -> InputError:
    return InputError(f'{name}: must be an image of at most {MOST_PIXELS} pixels, got {got}')
