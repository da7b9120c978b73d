"""The light of each pixel in a batch: its own, and what multipath and stray_light add to it."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import light_kernels
from flexx2_sim_ros.batch.bounce import IndirectLight
from flexx2_sim_ros.batch.effect_tables import MOST_FREQUENCIES
from flexx2_sim_ros.batch.history import each_with
from flexx2_sim_ros.batch.images import Images, launch
from flexx2_sim_ros.batch.scatter import ScatteredLight
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import Effect
import warp as wp


class PixelLight:
    """
    The light of the pixels of a pass, before effects change the phase of each frequency.

    Parameters
    ----------
    effects : sequence of sequence of Effect
        Of every environment.
    profile : Profile
        For the number of modulation frequencies.
    images : Images
    device : warp.Device

    Attributes
    ----------
    phasors : light_kernels.Phasors
        Of the pass.

    """

    def __init__(
        self, effects: Sequence[Sequence[Effect]], profile: Profile, images: Images, device: Any
    ) -> None:
        """Allocate the images."""
        self._images = images
        most = max(len(mode.modulation_hz) for mode in profile.modes)
        frequencies = min(max(most, 1), MOST_FREQUENCIES)
        pixels = images.count * images.height * images.width

        def zeros(size: int) -> wp.array:
            return wp.zeros(size, dtype=wp.float32, device=device)

        phasors = self.phasors = light_kernels.Phasors()
        phasors.amplitude, phasors.total = zeros(pixels), zeros(pixels)
        phasors.shifts, phasors.pitch = zeros(frequencies * pixels), pixels
        bounces = [one is not None for one in each_with('bounce', effects)]
        widths = [None if one is None else one.width for one in each_with('scatter', effects)]
        self._indirect = self._scattered = None
        self._mixes = any(one.name == 'flying_pixels' for own in effects for one in own)
        if any(bounces):
            self._indirect = IndirectLight(bounces, frequencies, images, device)
        if any(widths):
            self._scattered = ScatteredLight(widths, frequencies, images, device)
        wp.load_module(light_kernels, device=device)

    def begin(self, is_first: wp.array) -> None:
        """Register a new frame in all environments; ``is_first`` is (N,) uint8."""
        if self._indirect is not None:
            self._indirect.begin(is_first)

    def find(
        self,
        surfaces: Any,
        first: int,
        count: int,
        facing: wp.array,
        effects: wp.array,
        lights: wp.array,
        keys: wp.array,
    ) -> None:
        """
        Write the light of some environments into `phasors`.

        Parameters
        ----------
        surfaces : Surfaces
            Of these environments.
        first, count : int
            Which.
        facing : warp.array
            Flat float32, cosine of the incidence angle of each pixel.
        effects, lights : warp.array
            `Effects` and `Light` of all environments.
        keys : warp.array
            (N,) vec2ui, the cameras' random keys.

        """
        images, phasors = self._images, self.phasors
        grid, chunk = images.grid(count)
        part = surfaces, images.lens, first
        listed = images.listed, images.pixel_list
        images.listed.zero_()
        light = effects, lights, facing, phasors, images.lists, *listed
        launch(light_kernels.find_light, grid, *part, chunk, *light)
        rows = effects, lights, keys, phasors
        if self._mixes and images.lists:
            threads, each = images.list_grid(count)
            launch(light_kernels.mix_listed, threads, *part, each, *rows, *listed)
        elif self._mixes:
            launch(light_kernels.mix_rows, (count, images.height), *part, *rows)
        if self._indirect is not None:
            self._indirect.add(surfaces, first, count, effects, lights, phasors)
        if self._scattered is not None:
            self._scattered.add(surfaces, first, count, effects, lights, phasors)
