"""The light of each pixel in a batch: its own, and what multipath and stray_light add to it."""

from collections.abc import Sequence
from typing import Any

from flexx2_sim_ros.batch import light_kernels
from flexx2_sim_ros.batch.bounce import IndirectLight
from flexx2_sim_ros.batch.effect_tables import MOST_FREQUENCIES
from flexx2_sim_ros.batch.history import each_with
from flexx2_sim_ros.batch.images import Images
from flexx2_sim_ros.batch.scatter import ScatteredLight
from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.effects import Effect
import warp as wp


class PixelLight:
    """
    The light of the pixels of a pass, before effects change the phase of each frequency.

    `effects` are of every environment; `profile` gives the number of modulation frequencies.
    """

    def __init__(
        self, effects: Sequence[Sequence[Effect]], profile: Profile, images: Images, device: Any
    ) -> None:
        """Allocate the images."""
        self._images = images
        most = max(len(mode.modulation_hz) for mode in profile.modes)
        frequencies = min(max(most, 1), MOST_FREQUENCIES)
        images.frame.amplitude, images.frame.total, images.frame.shifts = (
            wp.zeros(count * images.pixels, dtype=wp.float32, device=device)
            for count in (1, 1, frequencies)
        )
        bounces = [one is not None for one in each_with('bounce', effects)]
        widths = [None if one is None else one.width for one in each_with('scatter', effects)]
        self._indirect = self._scattered = None
        self._mixes = any(one.name == 'flying_pixels' for own in effects for one in own)
        if any(bounces):
            self._indirect = IndirectLight(bounces, frequencies, images, device)
        if any(widths):
            self._scattered = ScatteredLight(widths, frequencies, images, device)
        wp.load_module(light_kernels, device=device)

    def begin(self) -> None:
        """Register a new frame in all environments."""
        if self._indirect is not None:
            self._indirect.begin()

    def find(self) -> None:
        """Write the light of the environments of the pass."""
        images = self._images
        images.each_pixel(light_kernels.find_light)
        images.each_pixel(light_kernels.clear_shifts)
        if self._mixes and images.lists:
            images.frame.listed.zero_()
            images.each_pixel(light_kernels.list_mixed)
            images.each_listed(light_kernels.mix_listed)
        elif self._mixes:
            images.each_pixel(light_kernels.mix_rows)
        for more in (self._indirect, self._scattered):
            if more is not None:
                more.add()
