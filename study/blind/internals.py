"""What is inside a camera and differs from what its profile says."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Internals:
    """
    The inside of one blind camera; the defaults are what the effects have without it.

    Effects read it from `Optics`, each the part that concerns it. None changes what a camera
    without effects measures.

    * `mhz`: its one modulation frequency; 0: those of the mode
    * `wave_m`: period along the range of the error of `wiggling`, metres; 0: harmonics of the
      modulation
    * `axial`: whether delays are constant in depth along the optical axis instead of in range
    * `footprint`: weight over the footprint of `flying_pixels`: ``square``, ``round`` or ``gauss``
    * `footprint_px`: its width at strength 1, pixels
    * `scatter`: scatter function of `stray_light`: ``tail`` (a power law), ``gauss`` or ``even``
      (the same over the whole image)
    * `scatter_px`: its width, pixels of an image that is 224 wide
    * `window`: weights of `spatial_filter`: ``alike`` (bilateral, 5 x 5), ``box`` or ``gauss``, or
      a ``median`` of depths
    * `window_px`: width of box, median or the Gaussian's support, pixels; odd
    * `memory`: `temporal_filter`: ``first`` order, ``second`` order, or ``mean`` of the last
      frames
    * `memory_frames`: how many frames the mean has
    * `light_scale`: factor on the amplitudes at which `low_signal_dropout` and `saturation` act
    * `knee`: charge at which the lag of `amplitude_bias` is halved, 1/m^2
    * `latency_s`: age of the image in `time_offset` at strength 1, seconds
    * `lost`: fraction of the pixels that `random_dropout` loses at strength 1
    * `dead`: whether these are the same pixels in every frame
    * `bleed_px`: charge that overflows a full well of `saturation` falls by a factor of e in so
      many pixels of its column; 0: it stays there
    * `aspect`: fraction by which `intrinsics_error` makes fy longer than fx, at strength 1
    * `tangential`: its tangential distortion, at strength 1
    """

    mhz: float = 0.0
    wave_m: float = 0.0
    axial: bool = False
    footprint: str = 'square'
    footprint_px: float = 1.5
    scatter: str = 'tail'
    scatter_px: float = 4.0
    window: str = 'alike'
    window_px: int = 5
    memory: str = 'first'
    memory_frames: int = 4
    light_scale: float = 1.0
    knee: float = 0.15
    latency_s: float = 0.05
    lost: float = 0.1
    dead: bool = False
    bleed_px: float = 0.0
    aspect: float = 0.0
    tangential: float = 0.0


# Effects, and what differs inside: cameras whose causes keep their names. Each is one campaign.
VARIED: tuple[tuple[str, dict[str, Any]], ...] = (
    *(
        (effect, {'mhz': mhz})
        for effect in ('wiggling', 'range_wrap', 'multipath', 'flying_pixels', 'stray_light')
        for mhz in (60.24, 31.0)
    ),
    ('offset', {'mhz': 60.24}),
    ('amplitude_bias', {'mhz': 60.24}),
    *(('wiggling', {'wave_m': wave}) for wave in (0.31, 0.8, 1.7)),
    ('range_wrap', {'mhz': 100.0}),
    ('offset', {'axial': True}),
    ('wiggling', {'wave_m': 0.5, 'axial': True}),
    ('warm_up_drift', {'axial': True}),
    ('amplitude_bias', {'knee': 0.03}),
    ('amplitude_bias', {'knee': 1.0}),
    ('flying_pixels', {'footprint': 'gauss', 'footprint_px': 1.5}),
    ('flying_pixels', {'footprint': 'round', 'footprint_px': 3.0}),
    ('stray_light', {'scatter': 'gauss', 'scatter_px': 10.0}),
    ('stray_light', {'scatter': 'even'}),
    ('spatial_filter', {'window': 'box', 'window_px': 3}),
    ('spatial_filter', {'window': 'gauss', 'window_px': 9}),
    ('temporal_filter', {'memory': 'second'}),
    ('temporal_filter', {'memory': 'mean', 'memory_frames': 2}),
    ('temporal_filter', {'memory': 'mean', 'memory_frames': 5}),
    ('low_signal_dropout', {'light_scale': 0.2}),
    ('low_signal_dropout', {'light_scale': 8.0}),
    ('saturation', {'light_scale': 0.2}),
    ('random_dropout', {'lost': 0.3}),
    ('random_dropout', {'lost': 0.03}),
    ('time_offset', {'latency_s': 0.115}),
    ('time_offset', {'latency_s': 0.21}),
    ('time_offset', {'latency_s': -0.06}),
)
