"""How far the frames of `BatchCamera`, on the CPU and on a GPU, are from those of `Camera`."""

from bench.scenes import room
from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.effects import registry
import numpy as np
import warp as wp

_EFFECT_MODES = ('Mode_5_30fps', 'Mode_9_30fps', 'Mode_9_5fps')
_FRAMES = 3
_ROUNDING = 1e-6  # metres; float32 at a few metres
_DECISION = 5e-4  # metres; beyond it an edge moved or a value was rounded the other way


def run(repeats=12):
    """Print the largest differences, and how many pixels differ by more than rounding."""
    wp.config.log_level = wp.LOG_WARNING
    for device in ('cpu', 'cuda')[: 1 + wp.is_cuda_available()]:
        _table(device, repeats)


def _table(device, repeats):
    names = list(registry())
    print(
        f'{device:20s}   pixels   largest difference (mm)   beyond {_ROUNDING * 1e3:g} mm   '
        f'beyond {_DECISION * 1e3:g} mm or validity differs'
    )
    _print(device, 'none', flexx2().names, {}, repeats)
    for name in names:
        _print(device, name, _EFFECT_MODES, {name: None}, 1)
    _print(device, 'all', _EFFECT_MODES, dict.fromkeys(names), 1)


def _print(device, title, modes, effects, repeats):
    differences = np.concatenate(
        [_differences(device, modes, effects, seed).ravel() for seed in range(repeats)]
    )
    decided = differences > _DECISION  # or infinite
    print(
        f'{title:20s} {differences.size:8d} {1e3 * differences[~decided].max():25.4f} '
        f'{int((differences > _ROUNDING).sum()):17d} {int(decided.sum()):14d}',
        flush=True,
    )


def _differences(device, modes, effects, seed):
    # (frames, modes, H, W) metres, infinite where only one of the two is valid.
    count, matrix = len(modes), flexx2().intrinsics.matrix
    scenes = np.stack([room(8 + (seed + i) % 9) for i in range(count)])
    shades = np.random.default_rng(seed).uniform(0, 1, scenes.shape).astype(np.float32)
    shades[:, 60:90] *= 0.02  # a dark stripe
    batch = BatchCamera(count, modes, effects=effects, seed=seed, device=device)
    cameras = [Camera(mode, effects=effects, seed=seed + i) for i, mode in enumerate(modes)]
    out = []
    for frame in range(_FRAMES):
        clean = scenes - np.float32(0.02 * frame)
        seen = batch(*(wp.array(one, device=device) for one in (clean, shades))).numpy()
        for i, camera in enumerate(cameras):
            stamp = frame * round(1e9 / camera.mode.rate_hz)
            alone = camera.capture(clean[i], matrix, stamp, shades[i]).depth
            apart = np.abs(np.nan_to_num(seen[i] - alone))
            out.append(np.where(np.isnan(seen[i]) == np.isnan(alone), apart, np.inf))
    return np.stack(out)
