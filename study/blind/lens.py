"""Effects on light before it reaches a pixel: footprints, multipath, stray light."""

import math

import numpy as np
from study.blind.bounce import bounced_light
from study.blind.frame import Effect
from study.blind.views import cast_rays, phasors, View

_SAMPLES = 4  # samples along a side of the footprint


class FlyingPixels(Effect):
    """A pixel collects light from an area wider than itself, sampled near edges."""

    name = 'flying_pixels'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the footprint's width, pixels."""
        self._width = self.optics.internals.footprint_px * self.strength
        self.parameters = {'width_px': self._width}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Sum the phasors over the footprint instead of using its centre."""
        chosen = np.flatnonzero(view.near_edge)
        if not chosen.size:
            return light
        camera, K = self.optics.intrinsics, self.optics.wavenumbers
        mean = np.zeros((len(K), chosen.size), np.complex64)
        for down, across, weight in _footprint(self.optics.internals.footprint):
            shift = self._width * across / camera.fx, self._width * down / camera.fy
            rays = view.rays[chosen] + shift
            depth, reflectivity, normal = cast_rays(view.solids, view.R, view.origin, rays)
            length = np.sqrt(1 + (rays**2).sum(-1))
            world = np.column_stack([rays, np.ones(len(rays))]) @ view.R.T
            cosine = -(world * normal).sum(-1) / length
            amplitude = np.nan_to_num(reflectivity * cosine / depth**2)
            mean += np.complex64(weight) * phasors(
                amplitude.astype(np.float32), np.nan_to_num(depth * length).astype(np.float32), K
            )
        out = light.copy()
        # Changes by other effects to the central ray apply to the whole footprint.
        before = view.light.reshape(len(K), -1)[:, chosen]
        flat = out.reshape(len(K), -1)
        flat[:, chosen] += mean - before
        return out


def _footprint(shape: str) -> list[tuple[float, float, float]]:
    # Samples down and across, in widths, and their weights, which add up to 1.
    reach = 1.5 if shape == 'gauss' else 0.5
    count = 2 * _SAMPLES if shape == 'gauss' else _SAMPLES
    places = ((np.arange(count) + 0.5) / count - 0.5) * 2 * reach
    down, across = (one.ravel() for one in np.meshgrid(places, places, indexing='ij'))
    square = down**2 + across**2
    weight = {
        'square': np.ones_like(square),
        'round': (square <= 0.25).astype(float),
        'gauss': np.exp(-0.5 * square / 0.4**2),
    }[shape]
    weight = weight / weight.sum()
    return [(float(a), float(b), float(w)) for a, b, w in zip(down, across, weight, strict=True)]


class Multipath(Effect):
    """Light that is reflected twice before it returns; see `bounce`."""

    name = 'multipath'

    def draw(self, rng: np.random.Generator) -> None:
        """Set the gain."""
        self.parameters = {'gain': self.strength}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Add the indirect light."""
        return light + np.complex64(self.strength) * bounced_light(view)


class StrayLight(Effect):
    """The lens scatters a fraction of the light over the whole image, most of it nearby."""

    name = 'stray_light'

    def draw(self, rng: np.random.Generator) -> None:
        """Build the scatter function at full resolution."""
        height, width = self.optics.shape
        inside = self.optics.internals
        core = inside.scatter_px * width / 224
        y = np.minimum(np.arange(2 * height), 2 * height - np.arange(2 * height))
        x = np.minimum(np.arange(2 * width), 2 * width - np.arange(2 * width))
        square = (y[:, None] ** 2 + x[None, :] ** 2) / core**2
        kernel = {
            'tail': (1 + square) ** -1.25,
            'gauss': np.exp(-0.5 * square),
            'even': np.ones_like(square),
        }[inside.scatter]
        self._spectrum = np.fft.fft2(kernel / kernel.sum()).astype(np.complex64)
        self._share = 0.02 * self.strength
        self.parameters = {'share': self._share}

    def scatter(self, view: View, light: np.ndarray) -> np.ndarray:
        """Convolve the light with the scatter function."""
        height, width = self.optics.shape
        spectrum = np.fft.fft2(light, s=(2 * height, 2 * width))
        spread = np.fft.ifft2(spectrum * self._spectrum)[:, :height, :width]
        share = self._share
        return ((1 - share) * light + share * spread).astype(np.complex64)


def footprint_slope(view: View) -> np.ndarray:
    """Return how much the range changes across a pixel, (H, W) float32 metres."""
    tangent = np.tan(np.arccos(np.clip(view.cosine, math.cos(1.55), 1)))
    return (view.path * tangent / _focal(view)).astype(np.float32)


def _focal(view: View) -> float:
    """Return the focal length in pixels of the full resolution (224 pixels wide)."""
    return view.optics.intrinsics.fx * 224 / view.optics.intrinsics.width
