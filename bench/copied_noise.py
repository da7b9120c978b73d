"""
Draw the depth noise that training programs copy beside that of a Flexx2, on one clean image.

``python -m bench.copied_noise [PICTURE]`` writes docs/copied_noise.png and prints the errors of
both. The stages and constants are those of ``utils/noise`` in
https://github.com/project-instinct/InstinctLab (commit ef1e920), written anew from what they do.
"""

from pathlib import Path
import sys

from flexx2_sim_ros.batch import depth_noise
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.cli.effects_view import room
from flexx2_sim_ros.pictures import colours, picture
import numpy as np
from scipy.ndimage import gaussian_filter

_MODE = 'Mode_9_30fps'
_FRAMES = 60
# Contours: a pixel is 0 where a weighted difference to a neighbour is larger, metres.
_CONTOUR = 2.0
_WEIGHTS = {(0, 1): 1.2, (1, 0): 0.1, (1, 1): 0.5, (1, -1): 0.5}  # the opposite ones likewise
# Stereo: up to so much is added to each pixel, below and beyond a distance, metres.
_NEAR, _FAR, _BEYOND = 0.02, 0.08, 2.0
_PATCHES, _SIDE, _SPREAD = 1e-4, 2.0, 0.5  # probability in a pixel; pixels
_BLUR = 1.0  # pixels, in a kernel of 3 x 3


def copied(clean, rng):
    """
    Return an image as the copied pipeline makes it: contours, patches, stereo noise, blur.

    `clean`: (H, W) metres. Returns (H, W) float32 metres; too small where depth was removed: the
    blur mixes it with 0.
    """
    lost = np.zeros(clean.shape, bool)
    framed = np.pad(clean, 1)  # The copied convolution sees 0 beyond the image.
    for (down, right), weight in _WEIGHTS.items():
        for sign in (1, -1):
            beside = np.roll(framed, (sign * down, sign * right), (0, 1))[1:-1, 1:-1]
            lost |= weight * np.abs(clean - beside) > _CONTOUR
    depth = np.where(lost, 0.0, clean)
    for y, x in np.argwhere((rng.random(depth.shape) < _PATCHES) & (depth > 0)):
        half = np.maximum(rng.normal(_SIDE, _SPREAD, 2), 0) / 2
        (top, left), (end, right) = np.rint([(y, x) - half, (y, x) + half]).astype(int).clip(0)
        depth[top:end, left:right] = 0
    depth += rng.random(depth.shape) * np.where(depth > _BEYOND, _FAR, _NEAR)
    return gaussian_filter(depth, _BLUR, radius=1).astype(np.float32)


def table(clean, seen):
    """Yield lines of a table of the errors of (T, H, W) depths, NaN or 0 where invalid."""
    yield '| | below 2 m: mean error, sigma | beyond 2 m | invalid | wrong by more than 0.1 m |'
    yield '|---|---|---|---|---|'
    for name, depth in seen.items():
        error = 1000 * (np.where(depth > 0, depth, np.nan) - clean)
        parts = []
        for where in (clean <= _BEYOND, clean > _BEYOND):
            mean = np.nanmedian(np.nanmean(error[:, where], axis=0))
            sigma = np.nanmedian(np.nanstd(error[:, where], axis=0))
            parts.append(f'{mean:+.1f} mm, {sigma:.1f} mm')
        parts += [
            f'{100 * share:.1f} %'
            for share in (np.isnan(error).mean(), (np.abs(error) > 100).mean())
        ]
        yield f'| {" | ".join([name, *parts])} |'


def draw(path, clean, seen):
    """Write a picture of the clean image, and of one image and its error for each way."""
    images = {'clean': clean}
    images |= {name: depth[0] for name, depth in seen.items()}
    with picture(path, 2, 3, dpi=80, figsize=(12, 6.4)) as (figure, axes):
        for axis, (name, image) in zip(axes[0], images.items(), strict=True):
            valid = np.where(image > 0.1, image, np.nan)
            limits = {'vmin': 0.5, 'vmax': 7, 'interpolation': 'nearest'}
            shown = axis.imshow(valid, cmap=colours('turbo_r'), **limits)
            axis.set_title(f'{name}, m', fontsize=10)
        figure.colorbar(shown, ax=axes[0], shrink=0.8)
        for axis, (name, depth) in zip(axes[1, 1:], seen.items(), strict=True):
            error = 1000 * (np.where(depth[0] > 0.1, depth[0], np.nan) - clean)
            limits = {'vmin': -100, 'vmax': 100, 'interpolation': 'nearest'}
            shown = axis.imshow(error, cmap=colours('RdBu'), **limits)
            axis.set_title(f'{name} minus clean, mm', fontsize=10)
        figure.colorbar(shown, ax=axes[1], shrink=0.8)
        _draw_row(axes[1, 0], seen)
        for axis in [*axes[0], *axes[1, 1:]]:
            axis.set(xticks=[], yticks=[])


def _draw_row(axis, seen):
    for name, depth in seen.items():
        row = depth[:, depth.shape[1] // 2]
        axis.plot(1000 * np.nanstd(np.where(row > 0, row, np.nan), axis=0), label=name)
    axis.set(title='sigma over time, middle row, mm', ylim=(0, 80), xlabel='column')
    axis.title.set_fontsize(10)
    axis.legend(frameon=False, fontsize=9)


def main(words):
    """Draw and print."""
    scene, rng = room(), np.random.default_rng(0)
    clean, light = (image.astype(np.float32) for image in (scene.depth, scene.reflectivity))
    seen = {'copied': np.stack([copied(clean, rng) for _ in range(_FRAMES)])}
    for name, effects in {'noise model': (), 'typical effects': 'typical'}.items():
        noise = depth_noise(mode=_MODE, effects=effects, K=flexx2().intrinsics.matrix)
        seen[f'Flexx2, {name}'] = np.stack(
            [noise(clean[np.newaxis], light[np.newaxis])[0] for _ in range(_FRAMES)]
        )
    print('\n'.join(table(clean, seen)))
    del seen['Flexx2, noise model']
    draw(Path(words[0]) if words else Path('docs/copied_noise.png'), clean, seen)


if __name__ == '__main__':
    main(sys.argv[1:])
