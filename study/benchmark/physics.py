"""
Which covariates the effects of the blind camera depend on, by their formulas.

The scorer's own table: a diagnosis is right about the place of an effect if the first row of its
``where`` names one of these covariates.
"""

from collections.abc import Iterable

# `all`: the effect is the same for all pixels. An error of the pose differs between recordings.
DEPENDS_ON: dict[str, tuple[str, ...]] = {
    'ambient_light': ('amplitude', 'distance'),  # light that competes with the signal
    'amplitude_bias': ('amplitude',),
    'depth_scale': ('distance',),
    'excess_noise': ('all',),
    'fixed_pattern': ('all', 'image region'),  # each pixel has its own error
    'flying_pixels': ('edge',),
    'grazing_dropout': ('incidence',),
    'heavy_tails': ('all',),
    'intrinsics_error': ('image region', 'radius'),
    'lateral_noise': ('edge',),
    'low_signal_dropout': ('amplitude',),
    'motion_artefact': ('speed', 'edge'),
    'motion_dropout': ('speed', 'edge'),
    'multipath': ('concavity', 'amplitude'),  # indirect light, relative to the direct light
    'offset': ('all',),
    'phase_noise_wiggling': ('distance',),
    'pose_error': ('recording', 'edge'),
    'quantisation': ('all',),
    'random_dropout': ('all',),
    'range_wrap': ('distance', 'amplitude'),  # beyond the range, or where noise is large
    'saturation': ('amplitude',),
    'spatial_filter': ('all', 'edge'),
    'stray_light': ('amplitude',),
    'temporal_filter': ('all', 'speed'),
    'time_offset': ('speed', 'edge'),
    'warm_up_drift': ('uptime',),
    'wiggling': ('distance',),
}


def covariate_of(place: str) -> str:
    """Return the covariate that a row of ``where`` names, without the number of its bin."""
    if place.startswith('image region'):
        return 'image region'
    if place == 'structure':  # measured on whole images, such as the step between depths
        return 'all'
    return place.removeprefix('fine_')


def is_physical(place: str, effects: Iterable[str]) -> bool:
    """Return whether one of these effects depends on the covariate of a row."""
    return any(covariate_of(place) in DEPENDS_ON.get(name, ()) for name in effects)
