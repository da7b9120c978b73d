"""Flying pixels: footprints that span an edge."""

from dataclasses import dataclass
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.phasors import phases, turn
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
import numpy as np


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
    """Footprints that span an edge."""

    name: ClassVar[str] = 'flying_pixels'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'footprints that span an edge: values between foreground and background'
    covariate: ClassVar[str] = 'edge'
    changes: ClassVar[tuple[str, ...]] = ('edges',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = 'phasor mixing over the footprint; the fraction is assumed'
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (grid('share', (0.12, 0.3, 0.6), 0.0, 1.0),)
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

    def constants(self) -> dict[str, float]:
        """Return the fraction of the light that comes from around."""
        return {'from_around': min(self.strength * self.share, 1.0)}

    def apply(self, state: FrameState) -> None:
        """Mix the phasors of neighbours, next to depth jumps."""
        surface = state.surface
        near = np.flatnonzero(_near_jumps(surface.row_jumps, surface.column_jumps))
        near = near[np.isfinite(state.depth.reshape(-1)[near])]
        if not near.size:
            return
        amplitude = np.zeros(near.size, np.float32)
        for k, weight, shift in zip(state.wave_numbers, state.weights, state.shifts, strict=True):
            direction = phases(state, k, shift)
            mixed = np.empty(near.size, np.complex64)
            _mix_around(state.amplitude * direction, direction, near, *self.rounded, mixed)
            turned = np.zeros(near.size, np.float32)
            turn(direction.reshape(-1)[near], mixed, np.float32(k), turned)
            shift.reshape(-1)[near] += turned
            amplitude += np.float32(weight) * np.abs(mixed)
        state.amplitude.reshape(-1)[near] = amplitude


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
