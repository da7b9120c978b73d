"""Flying pixels: footprints that span an edge."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.phasors import frequency_factor, own_frequency, waves
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, MHZ, Shape
from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.effects.unwrapping import agree
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.geometry import ray_length
import numpy as np
from scipy import ndimage

_REACH = 3.0  # of a Gaussian footprint, standard deviations


def footprint(own: float, total: float, count: float, share: float) -> float:
    """
    Return a pixel's light: a fraction of it is the mean of the 3 x 3 pixels around.

    It holds for the real and for the imaginary part.

    Parameters
    ----------
    own, total : float
        The light of the pixel, and the sum over those of the 3 x 3 that have a return.
    count : float
        How many these are, the pixel included.
    share : float
        0..1.

    """
    return own + share * (total / count - own)


@dataclass(frozen=True)
class FlyingPixels(Effect):
    """
    Footprints that span an edge.

    At each frequency a pixel sees another mean of foreground and background. If these lie far
    apart, unwrapping makes them agree on a distance that may be far from both.
    """

    name: ClassVar[str] = 'flying_pixels'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'footprints that span an edge: values between foreground and background'
    covariate: ClassVar[str] = 'edge'
    changes: ClassVar[tuple[str, ...]] = ('edges',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'phasor mixing over the footprint; the fraction is assumed'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('share', (0.12, 0.3, 0.6), 0.0, 1.0),
        *(
            grid('share', (0.2, 0.6), 0.0, 1.0, f'at {mhz:g} MHz', mhz=mhz)
            for mhz in (15.0, 32.0, 60.0, 100.0)
        ),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('3 x 3 pixels', (Free('share', 0.0, 1.0),)),
        Shape(
            'Gaussian footprint',
            (Free('width', 0.25, 2.0, log=True),),
            {'share': 1.0, 'frequency_factor': 1.0},
        ),
        Shape(
            'Gaussian footprint at one frequency',
            (Free('width', 0.25, 2.0, log=True), MHZ),
            {'share': 1.0},
        ),
    )
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('edges', 'pose')
    family: ClassVar[str] = 'kernel over neighbours'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'edge'), ('gross', 'edge'))
    picture: ClassVar[Picture] = Picture('across_edge')
    batched: ClassVar[tuple[str, ...] | None] = ()

    share: float = parameter(
        0.3,
        0.0,
        1.0,
        '',
        'fraction of the light that comes from the 3 x 3 pixels around, at strength 1',
    )
    width: float | None = optional_number(
        'px', 0.05, 10.0, 'standard deviation of a Gaussian footprint, in place of 3 x 3 pixels'
    )
    mhz: float | None = own_frequency()
    frequency_factor: float | None = frequency_factor()

    def constants(self) -> dict[str, float]:
        """Return the fraction of the light that comes from around."""
        return {'from_around': min(self.strength * self.share, 1.0)}

    def apply(self, state: FrameState) -> None:
        """Mix the phasors of neighbours, next to depth jumps."""
        surface = state.surface
        mask = _near_jumps(surface.row_jumps, surface.column_jumps)
        if self.width is not None:
            reach = int(np.ceil(_REACH * self.width))
            mask = ndimage.binary_dilation(mask, np.ones((3, 3)), max(reach - 1, 1))
        near = np.flatnonzero(mask)
        near = near[np.isfinite(state.depth.reshape(-1)[near])]
        if not near.size:
            return
        amplitude = np.zeros(near.size, np.float32)
        for wave in waves(state, self.mhz, self.frequency_factor):
            direction = wave.directions()
            mixed = self._mixed(state.amplitude * direction, direction, near)
            wave.turn(direction.reshape(-1)[near], mixed, near)
            amplitude += np.float32(wave.weight) * np.abs(mixed)
        state.amplitude.reshape(-1)[near] = amplitude
        self._unwrap(state, near)

    def _unwrap(self, state: FrameState, near: np.ndarray) -> None:
        # Each frequency has its own mean of foreground and background.
        if self.frequency_factor is not None:
            ray = ray_length(state.intrinsics.matrix, state.depth.shape).reshape(-1)[near]
            agree(state, near, (self.frequency_factor * ray).astype(np.float32))
        elif self.mhz is None:
            agree(state, near)

    def _mixed(self, light: np.ndarray, direction: np.ndarray, near: np.ndarray) -> np.ndarray:
        # (N,) complex64 light of some pixels.
        (share,) = self.rounded
        if self.width is None:
            mixed = np.empty(near.size, np.complex64)
            _mix_around(light, direction, near, share, mixed)
            return mixed
        there = (direction != 0).astype(np.float32)
        real, imaginary, count = (
            ndimage.gaussian_filter(
                image, self.width, mode='constant', truncate=_REACH, output=np.float32
            ).reshape(-1)[near]
            for image in (light.real, light.imag, there)
        )
        around = (real + np.complex64(1j) * imaginary) / np.maximum(count, np.float32(1e-6))
        own = light.reshape(-1)[near]
        return np.asarray(own + share * (around - own), np.complex64)


_footprint = compiled(footprint)


@loop()
def _near_jumps(row_jumps, column_jumps):
    # Pixels whose 3 x 3 neighbourhood has a depth jump in it.
    height, width = row_jumps.shape
    near = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            if row_jumps[y, x]:
                near[max(y - 1, 0) : y + 2, x : x + 2] = True
            if column_jumps[y, x]:
                near[y : y + 2, max(x - 1, 0) : x + 2] = True
    return near


@loop(error_model='numpy')
def _mix_around(light, direction, pixels, share, out):
    # (1 - share) of a pixel's own light and `share` of the mean of the 3 x 3 around it, as far as
    # there is something.
    height, width = light.shape
    for n in range(pixels.size):
        y, x = pixels[n] // width, pixels[n] % width
        total = np.complex64(0)
        count = 0
        for yy in range(max(y - 1, 0), min(y + 2, height)):
            for xx in range(max(x - 1, 0), min(x + 2, width)):
                total += light[yy, xx]
                count += direction[yy, xx] != 0
        own, number = light[y, x], np.float32(count)
        out[n] = complex(
            _footprint(own.real, total.real, number, share),
            _footprint(own.imag, total.imag, number, share),
        )
