"""Read PNG and TIFF files (gray images, masks) within a limit of size; encode small pictures."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
import warnings

from flexx2_sim_ros.config_file import is_regular_file
from flexx2_sim_ros.errors import InputError, shown, shown_path
import numpy as np
from PIL import Image

MOST_PIXELS = 1 << 25
TIFFS = ('.tif', '.tiff')
_BITS = {'1': 1, 'L': 8, 'I;16': 16, 'I;16B': 16, 'I': 16, 'F': 32}  # of Pillow's modes


def check_gray(path: Path, bits: tuple[int, ...]) -> tuple[int, int]:
    """
    Return the size, height and width, of a gray PNG or TIFF without reading its pixels.

    ``bits`` are which of 1, 8, 16 and 32 bits a pixel may have; 32 are only in a TIFF. Raises
    InputError when it is no such file, too large, not gray, or has other bits or several images.
    """
    with _opened(path) as image:
        return _checked(shown_path(path), image, bits)


def read_gray(path: Path, bits: tuple[int, ...]) -> np.ndarray:
    """
    Read a gray PNG or TIFF; parameters and errors as `check_gray`.

    It is (H, W) bool, uint8, uint16, or of a TIFF also int32 or float32.
    """
    with _opened(path) as image:
        return _pixels(shown_path(path), image, bits)


def decode_gray(content: bytes, name: str, bits: tuple[int, ...]) -> np.ndarray:
    """
    Return the pixels of a gray PNG, or TIFF, that is not in a file of its own; see `read_gray`.

    It is a TIFF only where pixels may have 32 bits. ``name`` is what to call it in errors.
    """
    kinds = ('PNG', 'TIFF') if 32 in bits else ('PNG',)
    with _decoding(BytesIO(content), name, kinds) as image:
        return _pixels(name, image, bits)


def read_mask_png(path: Path) -> np.ndarray:
    """
    Read a PNG of any kind as a mask, (H, W) bool, False where the image is black.

    Transparency is not used. Raises InputError when it is no PNG or too large.
    """
    with _opened(path) as image:
        _check_size(shown_path(path), image)
        pixels = np.asarray(image if image.mode in _BITS else image.convert('RGB'))
        return np.asarray((pixels.reshape(*pixels.shape[:2], -1) > 0).any(axis=-1))


def encode_png(index: np.ndarray, palette: np.ndarray) -> bytes:
    """
    Return a PNG of (H, W) uint8, the colour of each pixel in a palette.

    The palette is (N, 3) uint8 red, green and blue of at most 256 colours.
    """
    image = Image.fromarray(np.ascontiguousarray(index, np.uint8)).convert('P')
    image.putpalette(palette.astype(np.uint8).tobytes())
    file = BytesIO()
    image.save(file, format='PNG', optimize=True)
    return file.getvalue()


def _pixels(name: str, image: Image.Image, bits: tuple[int, ...]) -> np.ndarray:
    _checked(name, image, bits)
    dtype = {1: bool, 8: np.uint8, 16: np.uint16}.get(_bits(image))
    return np.array(image, dtype)


def _checked(name: str, image: Image.Image, bits: tuple[int, ...]) -> tuple[int, int]:
    _check_size(name, image)
    if _bits(image) not in bits:
        kinds = {'RGB': 'colours', 'RGBA': 'colours', 'P': 'a palette', 'LA': 'transparency'}
        got = kinds.get(image.mode, f'{_bits(image) or "unknown"} bits')
        can = [str(one) for one in bits if one < 32 or image.format == 'TIFF']
        raise InputError(
            f'{name}: must be a gray {image.format} of {" or ".join(can)} bits a pixel, got {got}'
        )
    if image.format == 'TIFF':
        with suppress(EOFError):
            image.seek(1)
            raise InputError(f'{name}: must have one image, got several')
    return image.height, image.width


def _bits(image: Image.Image) -> int:
    # A PNG of 16 bits and a TIFF of 32 can have the same mode.
    of_tiff = image.format == 'TIFF' and image.mode == 'I'
    return 32 if of_tiff else _BITS.get(image.mode, 0)


def _check_size(name: str, image: Image.Image) -> None:
    if image.width * image.height > MOST_PIXELS:
        raise _too_large(name, f'{image.width} x {image.height}')


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    kind = 'TIFF' if path.suffix.lower() in TIFFS else 'PNG'
    if not is_regular_file(path):
        raise InputError(f'{shown_path(path)}: must be a {kind} file, got none')
    with _decoding(path, shown_path(path), (kind,)) as image:
        yield image


@contextmanager
def _decoding(source: Path | BytesIO, name: str, kinds: tuple[str, ...]) -> Iterator[Image.Image]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', UserWarning)  # of damaged tags
            warnings.simplefilter('error', Image.DecompressionBombWarning)
            with Image.open(source, formats=kinds) as image:
                yield image
    except InputError:
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise _too_large(name, 'more') from error
    except Exception as error:  # Pillow lets errors of all kinds out.
        raise InputError(
            f'{name}: must be a {" or ".join(kinds)}, got a file that is none or is damaged '
            f'({shown(type(error).__name__)})'
        ) from error


def _too_large(name: str, got: str) -> InputError:
    return InputError(f'{name}: must be an image of at most {MOST_PIXELS} pixels, got {got}')
