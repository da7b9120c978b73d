"""
Reflectivity of surfaces from gray values, where nothing better is known.

A surface sends back reflectivity * cos(incidence) / depth^2 of the light. So gray values give the
reflectivity, but for a factor of the camera, which is found over all recordings of a campaign.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexx2_sim_ros.physics.nearest import nearest_pixels
from flexx2_sim_ros.physics.reflectance import falloff
from flexx2_sim_ros.truth.clean import Clean
from flexx2_sim_ros.truth.solver import PER_MEDIAN
import numpy as np
from scipy import ndimage

# Bright surfaces of a room: this quantile of all pixels has this reflectivity (assumed: white
# paint and paper, as the white of a printed target).
BRIGHT_QUANTILE, BRIGHT = 0.95, 0.8
_STEEPEST = np.radians(75)  # of incidence; the light of a steeper surface is not used
_CREASE = 0.3  # change of a surface's slope within four pixels: 17 degrees
_STEP = 2  # pixels
_FEW = 16  # pixels; a smaller surface is not used for the scale
_TEXTURE = 2.0  # a surface has a texture if its pixels spread by more than so much noise
_LEAST_USED = 0.3  # of the known pixels; with fewer the surfaces are not found
_SAMPLES = 3000  # pixels of a recording
_ROOT = 0.72  # slope of gray over light in logarithms: between that of a root and of a line
_LEAST_SPAN = 0.1  # mean difference within surfaces of the logarithm of light that tells the two


@dataclass(frozen=True)
class GraySamples:
    """Pixels of a recording that show surfaces, each (N,)."""

    gray: np.ndarray  # above 0
    falloff: np.ndarray  # m^2, see `physics.reflectance.falloff`
    surface: np.ndarray  # int, the number of the surface in its image


@dataclass(frozen=True)
class GrayScale:
    """What gray values mean: reflectivity = factor * gray ** power * falloff."""

    factor: float  # 1/m^2
    power: int  # 1 where gray values are proportional to light, 2: to its root
    spread: float  # standard deviation of the logarithm of the factor between recordings

    def table(self) -> dict[str, Any]:
        """Return what ``truth.yaml`` says of it."""
        return {
            'kind': 'relative',
            'gray': 'root of light' if self.power == 2 else 'proportional to light',
            'factor': float(f'{self.factor:.4g}'),
            'spread': round(self.spread, 3),
            'bright_quantile': BRIGHT_QUANTILE,
            'bright': BRIGHT,
        }


def surfaces(clean: Clean, rays: np.ndarray) -> np.ndarray:
    """Return (H, W) numbers of the connected surfaces of an image; 0 at borders and unknown."""
    # Inverse depth is affine in the pixel on a plane. It bends at depth jumps and creases.
    inside = clean.known & np.isfinite(clean.depth)
    with np.errstate(invalid='ignore', divide='ignore'):
        inverse = 1 / np.where(inside, clean.depth, np.nan)
        across = _bend(inverse, rays[..., 0])
        down = _bend(inverse.T, rays[..., 1].T).T
        smooth = ~(np.fmax(across, down) > _CREASE)
    return np.asarray(ndimage.label(inside & smooth)[0])


def _bend(inverse: np.ndarray, along: np.ndarray) -> np.ndarray:
    # How much the slope of a surface changes along each row around a pixel; 0 beside the unknown.
    s = _STEP
    out = np.zeros(inverse.shape)
    pitch = float(np.nanmedian(np.abs(np.diff(along, axis=1))))
    second = inverse[:, 2 * s :] - 2 * inverse[:, s:-s] + inverse[:, : -2 * s]
    out[:, s:-s] = np.nan_to_num(np.abs(second) / (s * pitch * inverse[:, s:-s]))
    return out


def _shown(
    gray: np.ndarray, clean: Clean, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    # The (H, W) surfaces, usable pixels and falloff of an image. None where most of it is no
    # surface: a rough mesh, or no light.
    label = surfaces(clean, rays)
    with np.errstate(invalid='ignore'):
        usable = (label > 0) & (gray > 0) & (clean.incidence < _STEEPEST)
    if usable.sum() < max(_LEAST_USED * clean.known.sum(), _FEW):
        return None
    return label, usable, falloff(clean.depth, np.cos(clean.incidence))


def gray_samples(gray: np.ndarray, clean: Clean, rays: np.ndarray) -> GraySamples | None:
    """Return pixels that tell what gray values mean; None where most of it is no surface."""
    shown = _shown(gray, clean, rays)
    if shown is None:
        return None
    label, usable, light = shown
    size = np.bincount(label[usable], minlength=label.max() + 1)
    chosen = np.flatnonzero(usable & (size[label] >= _FEW))
    chosen = chosen[:: max(len(chosen) // _SAMPLES, 1)]
    if not len(chosen):
        return None
    return GraySamples(*(image.ravel()[chosen] for image in (gray, light, label)))


def find_scale(samples: Sequence[GraySamples]) -> GrayScale | None:
    """
    Find what gray values mean from all recordings of a campaign; None without samples.

    Recordings have the same exposure. The factor is relative: it makes bright pixels white paint.
    """
    if not samples:
        return None
    power = 2 if _follows_root(samples) else 1
    every = [one.gray**power * one.falloff for one in samples]
    bright = np.array([np.quantile(one, BRIGHT_QUANTILE) for one in every])
    usual = np.quantile(np.concatenate(every), BRIGHT_QUANTILE)
    spread = float(np.std(np.log(bright), ddof=1)) if len(bright) > 1 else 0.0
    return GrayScale(float(BRIGHT / usual), power, spread)


def _follows_root(samples: Sequence[GraySamples]) -> bool:
    # The slope of log(gray) over log(light) through each surface's median: least absolute errors.
    light: list[np.ndarray] = []
    gray: list[np.ndarray] = []
    for one in samples:
        names, place = np.unique(one.surface, return_inverse=True)
        for values, out in ((-np.log(one.falloff), light), (np.log(one.gray), gray)):
            middle = ndimage.median(values, one.surface, names)
            out.append(values - np.asarray(middle)[place])
    x, y = np.concatenate(light), np.concatenate(gray)
    if np.abs(x).mean() < _LEAST_SPAN:
        return False
    x, y = x[x != 0], y[x != 0]
    order = np.argsort(y / x)
    weight = np.cumsum(np.abs(x)[order])
    return bool((y / x)[order][np.searchsorted(weight, weight[-1] / 2)] < _ROOT)


def with_reflectivity(clean: Clean, gray: np.ndarray, rays: np.ndarray, scale: GrayScale) -> Clean:
    """
    Return ground truth with the reflectivity, at most 1, that (H, W) gray values imply.

    Pixels of a surface with a texture keep their own values, others get the median. Pixels without
    light (0), saturated (NaN) and steep ones and borders get that of their surface, or the nearest
    one. Ground truth is unchanged where most of the image shows no surface.
    """
    shown = _shown(gray, clean, rays)
    if shown is None:
        return clean
    label, usable, light = shown
    with np.errstate(invalid='ignore', divide='ignore'):
        value = np.log(scale.factor * gray**scale.power * light)
    names = np.unique(label[usable])
    place = np.searchsorted(names, np.where(np.isin(label, names), label, names[0]))
    middle = _medians(value, label, usable, names)[place]
    spread = PER_MEDIAN * _medians(np.abs(value - middle), label, usable, names)[place]
    noise = PER_MEDIAN / np.sqrt(2) * _medians(*_neighbours(value, label, usable), names)[place]
    value = np.where(usable & (spread > _TEXTURE * noise), value, middle)
    # Elsewhere the nearest pixel that has one.
    near = nearest_pixels(np.isin(label, names))
    something = np.isfinite(clean.depth)
    found, spreads = (
        np.where(something, image[near], np.nan).astype(np.float32)
        for image in (np.minimum(np.exp(value), 1), spread)
    )
    return replace(clean, reflectivity=found, reflectivity_spread=spreads)


def _medians(
    values: np.ndarray, label: np.ndarray, usable: np.ndarray, names: np.ndarray
) -> np.ndarray:
    # Of each named surface; 0 where it has no usable pixel.
    chosen = np.where(usable, label, 0)
    return np.nan_to_num(np.asarray(ndimage.median(values, chosen, names)))


def _neighbours(
    value: np.ndarray, label: np.ndarray, usable: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # Differences between pixels side by side on one surface, the surface, where they are.
    with np.errstate(invalid='ignore'):
        change = np.abs(np.diff(value, axis=1))
    both = usable[:, 1:] & usable[:, :-1] & (label[:, 1:] == label[:, :-1])
    return change, label[:, 1:], both
