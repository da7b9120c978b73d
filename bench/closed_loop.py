"""The simulated noise, measured by the procedure of the paper, against the model."""

from pathlib import Path
import sys

from flexx2_sim_ros.camera import Camera, flexx2
from flexx2_sim_ros.characterize.divergence import mean_kl
from flexx2_sim_ros.characterize.lateral import edge_sigma
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / 'test'))

from boards import board  # noqa: E402, I100

_ANGLES = (0, 15, 30, 45, 60)
_DISTANCES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
_FRAMES = 600


def run() -> None:
    """Print a table for each measured mode."""
    for mode in flexx2().modes:
        if not mode.measured:
            continue
        print(
            f'{mode.name}: realised / modelled sigma_z (mean KL in nats; {_FRAMES} frames make '
            f'{1 / _FRAMES:.4f} of it)'
        )
        print('   z \\ theta' + ''.join(f'{angle:>16d}' for angle in _ANGLES))
        scores = []
        for distance in _DISTANCES:
            if distance >= mode.range_max:
                continue
            cells = []
            for angle in _ANGLES:
                ratio, kl, score = _axial(mode.name, distance, angle)
                cells.append(f'{ratio:8.4f} ({kl:.4f})')
                scores.append(score)
            print(f'{distance:8.1f} m  ' + ''.join(cells))
        print(
            f'   bias: largest of {len(scores)} cells {np.abs(scores).max():.2f} standard '
            f'errors, root mean square {np.sqrt(np.mean(np.square(scores))):.2f}'
        )
        edges = ', '.join(f'{angle} deg {_lateral(mode.name, angle):.3f}' for angle in (0, 15, 30))
        print(f'   sigma_x: modelled {mode.noise.sigma_x:.3f} px, realised {edges}\n')


def _axial(usecase: str, distance: float, angle: int) -> tuple[float, float, float]:
    mode = flexx2().mode(usecase)
    target = board(distance, angle, size=(40, 40))
    model = mode.noise.sigma_z(target.depth, target.incidence)
    camera = Camera(usecase, seed=11, name=f'{distance}/{angle}')
    stamps = np.arange(_FRAMES) * int(1e9 / mode.rate_hz)
    seen = camera.capture(target.depth, target.K, stamps).depth
    inside = target.depth + 6 * model < mode.range_max
    samples, clean, sigma = seen[:, inside].astype(np.float64), target.depth[inside], model[inside]
    ratio = np.sqrt(samples.var(axis=0, ddof=1).mean() / np.mean(sigma**2))
    score = np.mean((samples - clean) / sigma) * np.sqrt(samples.size)
    return float(ratio), mean_kl(samples, clean, sigma), float(score)


def _lateral(usecase: str, angle: int) -> float:
    target = board(1.0, angle, half_width=0.25, background=2.2)
    seen = Camera(usecase, seed=3).capture(target.depth, target.K, np.arange(300)).depth
    right = np.flatnonzero(np.isfinite(target.incidence[86]))[-1]
    return edge_sigma(seen, slice(right - 14, right + 15))
