"""
How right sigma_z of single frames is: ``python -m bench.single_frames``.

Each line: the correlation of neighbouring pixels of simulated noise behind a Gaussian filter, and
two estimates of its standard deviation relative to the truth: what planes fitted to 8 x 8 pixels
leave, and with what such planes hide, as ``flexx2 characterize fit`` writes it into the profile.
"""

from pathlib import Path
import tempfile

from flexx2_sim_ros.characterize.measure import measure
from flexx2_sim_ros.characterize.tiles import whole_noise
import numpy as np
from scipy import ndimage

SIZE, COUNT = (172, 224), 20
K = np.array([[210.0, 0.0, 111.5], [0.0, 210.0, 83.5], [0.0, 0.0, 1.0]])
DISTANCE, SIGMA = 1.0, 0.003  # metres
BLURS = 0.0, 0.5, 0.85  # pixels
SEED = 1


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(SEED)
    print('| correlation | planes | profile |\n|---|---|---|')
    for blur in BLURS:
        noise = ndimage.gaussian_filter(
            rng.standard_normal((COUNT, *SIZE)), (0, blur, blur), mode='wrap'
        )
        noise /= noise.std()
        correlation = np.mean(noise[..., 1:] * noise[..., :-1])
        planes, whole = np.sqrt(np.mean([_variances(frame) for frame in noise], axis=0)) / SIGMA
        print(f'| {correlation:.2f} | {planes:.3f} | {whole:.3f} |')


def _variances(noise: np.ndarray) -> tuple[float, float]:
    depth = (DISTANCE + SIGMA * noise).astype(np.float32)[None]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'board.npz'
        np.savez(path, depth=depth, K=K, stamp=np.zeros(1), usecase='tof')
        tiles = measure(path).tiles
    return float(tiles.variance.mean()), float(whole_noise(tiles).variance.mean())


if __name__ == '__main__':
    main()
