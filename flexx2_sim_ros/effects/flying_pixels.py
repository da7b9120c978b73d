"""Flying pixels: footprints that span an edge."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from flexx2_sim_ros.effects.effect import Effect, parameter
from flexx2_sim_ros.effects.hypothesis import grid, Hypothesis
from flexx2_sim_ros.effects.phasors import frequency_factor, own_frequency, waves
from flexx2_sim_ros.effects.picture import Picture
from flexx2_sim_ros.effects.shapes import Free, MHZ, Shape
from flexx2_sim_ros.effects.tables import optional_number
from flexx2_sim_ros.effects.unwrapping import agree
from flexx2_sim_ros.formulas.scalars import f32, most, where
from flexx2_sim_ros.physics.compiled import compiled, loop
from flexx2_sim_ros.physics.frame_state import FrameState, Stage
from flexx2_sim_ros.physics.philox import fill_uniforms
import numpy as np
import scipy  # its parts are imported on use

# Pixels. Of a square wider than 2, what lies beyond the neighbours counts as theirs, and pixels
# two away from an edge stay as they are.
_WIDEST = 3.0
_REACH = 3.0  # of a Gaussian footprint, standard deviations
_SIDE = Free('footprint', 0.1, _WIDEST)
_WIDTH = Free('width', 0.25, 2.0, log=True)
LEAST_WEIGHT = f32(1e-6)  # weight of the pixels with a return, so that nothing is divided by 0
_ZERO = f32(0.0)
_HALF = f32(0.5)
_ONE = f32(1.0)


def border_place(place: float, jumps: bool) -> float:
    """
    Return where the border between two pixels is: 0 at the centre of the first, 1 of the second.

    ``place`` is its random number, 0..1: where depth jumps, only the pixels of the jump are known.
    A surface that goes on is divided evenly.
    """
    return where(jumps, place, _HALF)


def beyond_border(side: float, away: float) -> float:
    """
    Return the fraction of a square footprint that lies beyond a border.

    ``side`` of the square, and ``away``, from its centre to the border, are in pixels.
    """
    return most(_HALF * side - away, _ZERO) / side


@dataclass(frozen=True)
class FlyingPixels(Effect):
    """
    Footprints that span an edge.

    Where between two pixels an edge is, is not known: a random place that stays as it is. At each
    frequency a pixel sees another mean of foreground and background. If these lie far
    apart, unwrapping makes them agree on a distance that may be far from both.
    """

    name: ClassVar[str] = 'flying_pixels'
    stage: ClassVar[Stage] = Stage.PHASOR
    order: ClassVar[int] = 0
    title: ClassVar[str] = 'footprints that span an edge: values between foreground and background'
    covariate: ClassVar[str] = 'edge'
    changes: ClassVar[tuple[str, ...]] = ('edges',)
    typical: ClassVar[bool] = True
    source: ClassVar[str] = (
        'phasor mixing over the footprint; its side (a pixel and some blur) is assumed'
    )
    hypotheses: ClassVar[tuple[Hypothesis, ...]] = (
        grid('footprint', (0.5, 1.0, 2.0), 0.0, _WIDEST),
        *(
            grid('footprint', (1.0, 2.0), 0.0, _WIDEST, f'at {mhz:g} MHz', mhz=mhz)
            for mhz in (15.0, 32.0, 60.0, 100.0)
        ),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape('square', (_SIDE,)),
        Shape('square, one frequency', (_SIDE, MHZ)),
        Shape('Gaussian', (_WIDTH,), {'frequency_factor': 1.0}),
        Shape('Gaussian, one frequency', (_WIDTH, MHZ)),
    )
    needs_modulation: ClassVar[bool] = True
    nuisances: ClassVar[tuple[str, ...]] = ('edges', 'pose')
    family: ClassVar[str] = 'kernel over neighbours'
    reads_as: ClassVar[tuple[tuple[str, str], ...]] = (('bias', 'edge'), ('gross', 'edge'))
    picture: ClassVar[Picture] = Picture('across_edge')
    stream: ClassVar[int] = 11
    column_stream: ClassVar[int] = 12
    batched: ClassVar[tuple[str, ...] | None] = ('footprint',)

    footprint: float = parameter(
        1.5,
        0.0,
        _WIDEST,
        'px',
        'side of the square that a pixel sees, at strength 1; 3 px at most',
    )
    width: float | None = optional_number(
        'px',
        0.05,
        10.0,
        'standard deviation of a Gaussian footprint at strength 1, in place of a square',
    )
    mhz: float | None = own_frequency()
    frequency_factor: float | None = frequency_factor()

    def constants(self) -> dict[str, float]:
        """Return the side of the footprint, pixels."""
        return {'side': min(self.strength * self.footprint, _WIDEST)}

    def apply(self, state: FrameState) -> None:
        """Mix the phasors of neighbours, next to depth jumps."""
        surface = state.surface
        mask = _near_jumps(surface.row_jumps, surface.column_jumps)
        if self.width is not None:
            reach = int(np.ceil(_REACH * self.strength * self.width))
            mask = scipy.ndimage.binary_dilation(mask, np.ones((3, 3)), max(reach - 1, 1))
        near = np.flatnonzero(mask)
        near = near[np.isfinite(state.depth.reshape(-1)[near])]
        if not near.size or (self.width is None and self.rounded[0] == 0.0):
            return
        amplitude = np.zeros(near.size, np.float32)
        parts = list(waves(state, self.mhz, self.frequency_factor))
        for wave in parts:
            direction = wave.directions()
            mixed = self._mixed(state, state.amplitude * direction, direction, near)
            wave.turn(direction.reshape(-1)[near], mixed, near)
            amplitude += np.float32(wave.weight) * np.abs(mixed)
        state.amplitude.reshape(-1)[near] = amplitude
        if self.mhz is None:  # Each frequency has its own mean of foreground and background.
            ray = parts[0].ray
            factor = np.float32(self.frequency_factor or 1.0)
            agree(state, near, 1.0 if ray is None else factor * ray.reshape(-1)[near])

    def _mixed(
        self, state: FrameState, light: np.ndarray, direction: np.ndarray, near: np.ndarray
    ) -> np.ndarray:
        # (N,) complex64 light of some pixels.
        if self.width is None:
            surface, mixed = state.surface, np.empty(near.size, np.complex64)
            places = _places(state.key.tobytes(), light.shape)
            jumps = surface.row_jumps, surface.column_jumps
            _mix_square(light, direction, *jumps, *places, near, self.rounded[0], mixed)
            return mixed
        there = (direction != 0).astype(np.float32)
        width = self.strength * self.width
        real, imaginary, count = (
            scipy.ndimage.gaussian_filter(
                image, width, mode='constant', truncate=_REACH, output=np.float32
            ).reshape(-1)[near]
            for image in (light.real, light.imag, there)
        )
        around = (real + np.complex64(1j) * imaginary) / np.maximum(count, LEAST_WEIGHT)
        return np.asarray(around, np.complex64)


_border_place = compiled(border_place)
_beyond_border = compiled(beyond_border)


@lru_cache(maxsize=8)  # Environments of one camera share it.
def _places(key: bytes, shape: tuple[int, ...]) -> np.ndarray:
    # (2, H, W) of the borders to the pixel on the right, and below.
    places = np.empty((2, *shape), np.float32)
    zero = np.uint32(0)
    for image, stream in zip(
        places, (FlyingPixels.stream, FlyingPixels.column_stream), strict=True
    ):
        fill_uniforms(np.frombuffer(key, np.uint32).copy(), zero, zero, stream, image.ravel())
    return places


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
def _mix_square(light, direction, row_jumps, column_jumps, rows, columns, pixels, side, out):
    # The mean over the square around a pixel, as far as there is something.
    height, width = light.shape
    across, down = np.empty(3, np.float32), np.empty(3, np.float32)
    for n in range(pixels.size):
        y, x = pixels[n] // width, pixels[n] % width
        across[:] = down[:] = _ZERO
        if x > 0:
            place = _border_place(rows[y, x - 1], row_jumps[y, x - 1] != 0)
            across[0] = _beyond_border(side, _ONE - place)
        if x + 1 < width:
            across[2] = _beyond_border(side, _border_place(rows[y, x], row_jumps[y, x] != 0))
        if y > 0:
            place = _border_place(columns[y - 1, x], column_jumps[y - 1, x] != 0)
            down[0] = _beyond_border(side, _ONE - place)
        if y + 1 < height:
            down[2] = _beyond_border(side, _border_place(columns[y, x], column_jumps[y, x] != 0))
        across[1] = _ONE - across[0] - across[2]
        down[1] = _ONE - down[0] - down[2]
        total = np.complex64(0)
        whole = _ZERO
        for i in range(3):
            for j in range(3):
                weight = down[i] * across[j]
                if weight > _ZERO and direction[y + i - 1, x + j - 1] != 0:
                    total += weight * light[y + i - 1, x + j - 1]
                    whole += weight
        out[n] = total / max(whole, LEAST_WEIGHT)
