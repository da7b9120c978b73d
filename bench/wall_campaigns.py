"""Simulated campaigns of bare walls, one in each recording, of the cameras that are shipped."""

import math

from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import ageing, registry
from flexx2_sim_ros.profiles.files import find_profile
import numpy as np

PROFILES = 'flexx2', 'azure_kinect_nfov', 'kinect_v2', 'realsense_d435'
# A wall that does not move has no edges, no corners and no motion: it does not show the others.
SHOWN = (
    'amplitude_bias',
    'excess_noise',
    'fixed_pattern',
    'heavy_tails',
    'intrinsics_error',
    'low_signal_dropout',
    'offset',
    'quantisation',
    'range_wrap',
    'saturation',
    'spatial_filter',
    'temporal_filter',
    'warm_up_drift',
    'wiggling',
)
_DISTANCES = 0.5, 2.8  # metres, log-uniform
_LARGEST_ANGLE = 50.0  # degrees about the vertical, uniform
_UPTIMES = 5.0, 60.0, 300.0, 900.0, 2400.0  # seconds


def profile_for(seed, effects):
    """Return a camera that can have the effects: the one of this seed, or the Flexx2."""
    profile = find_profile(PROFILES[seed % len(PROFILES)])
    stereo = any(not mode.modulation_hz for mode in profile.modes)
    if stereo and any(registry()[name].needs_modulation for name in effects):
        return find_profile('flexx2')
    return profile


def write_walls(folder, *, profile, effects, seed, recordings, frames, width, pose):
    """
    Write recordings of walls; the user knows their distance and angle inexactly.

    * `folder`: an existing folder
    * `profile`: the camera, in its default mode
    * `effects`: parameters of its effects, by name
    * `seed`: seed of all random numbers
    * `recordings`, `frames`: number of recordings, and of frames in each
    * `width`: pixels of a row; the image is three quarters as high
    * `pose`: standard deviation of the error of distance and angle, metres and degrees
    """
    rng = np.random.default_rng([seed, 2])
    own = profile.intrinsics
    size = round(width * 3 / 4), width
    focal = own.fx * width / own.width
    K = np.array([[focal, 0, (size[1] - 1) / 2], [0, focal, (size[0] - 1) / 2], [0, 0, 1]])
    mode = profile.mode(profile.default_usecase)
    near, far = map(math.log, _DISTANCES)
    for i in range(recordings):
        distance = math.exp(rng.uniform(near, far))
        angle = rng.uniform(-_LARGEST_ANGLE, _LARGEST_ANGLE)
        wrong, turned = rng.standard_normal(2) * pose
        uptime = float(rng.choice(_UPTIMES)) * rng.uniform(0.7, 1.3)
        table = {name: dict(values) for name, values in effects.items()}
        for name in ageing(table):
            table[name]['uptime'] = uptime
        stamp = np.arange(frames) / mode.rate_hz
        camera = Camera(mode.name, profile=profile, effects=table, seed=seed + i)
        true = wall(distance + wrong, angle + turned, K, size)
        np.savez(
            folder / f'wall_{i:02d}.npz',
            depth=camera.capture(true, K, stamp).depth,
            clean_depth=wall(distance, angle, K, size),
            K=K,
            stamp=100.0 * i + stamp,
            uptime=uptime + stamp,
            usecase=mode.name,
        )


def wall(
    distance,
    angle_deg,
    K,  # noqa: N803
    size,
):
    """Return (H, W) float32 metres of a wall turned about a vertical line on the optical axis."""
    u = (np.arange(size[1]) - K[0, 2]) / K[0, 0]
    row = distance / (1 - math.tan(math.radians(angle_deg)) * u)
    return np.tile(row.astype(np.float32), (size[0], 1))
