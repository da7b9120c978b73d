"""
The rows of `config/profiles/flexx2_exposure.yaml`: noise of unmeasured modes by their exposure.

Head-on, sigma_z^2 = s0^2 + (h / t)^2, floor and read noise, t the longest exposure. The paper's
pair of modes, Mode_5 at 30 and at 60 fps, gives s0 and h at every distance.
"""

from flexx2_sim_ros.camera import flexx2
import numpy as np

# Longest exposures of another vendor's module with the same imager and mode names, microseconds.
EXPOSURE_US = {
    'Mode_5_15fps': 1430.0,
    'Mode_5_30fps': 710.0,
    'Mode_5_45fps': 470.0,
    'Mode_5_60fps': 350.0,
    'Mode_9_5fps': 1880.0,
    'Mode_9_10fps': 1070.0,
    'Mode_9_15fps': 710.0,
    'Mode_9_20fps': 530.0,
    'Mode_9_30fps': 350.0,
}
_PAIR = 'Mode_5_30fps', 'Mode_5_60fps'
_NEAREST = 0.3  # metres; a, b and c are fitted to larger distances
_POINTS = 200


def run():
    """Print the noise of every mode."""
    print(f'sigma_x goes as t^{_edge_exponent():.2f}')
    for usecase in EXPOSURE_US:
        row = noise_by_exposure(usecase)
        print(f'{usecase}: noise: {{{", ".join(f"{k}: {_plain(v)}" for k, v in row.items())}}}')


def _plain(value):
    return f'{value:.6f}'.rstrip('0').rstrip('.')


def noise_by_exposure(usecase):
    """
    Return a mode's a, b, c, d, n and sigma_x, to the digits of the paper.

    A measured mode keeps its own values. The others start from the measured mode whose noise they
    take by default: d is proportional to 1 / t, sigma_x to a power of t that the pair gives, and
    a, b and c are fitted to the hypothesis by least squares of relative residuals. In Mode_9 the
    fraction of the floor is that of Mode_5 at the same distance, hence the same amplitude; beyond
    2.4 m it is that at 2.4 m.
    """
    mode = flexx2().mode(usecase)
    known, time = mode.noise, EXPOSURE_US[usecase]
    reference = EXPOSURE_US[mode.noise_of]
    if mode.measured:
        a, b, c, d = known.a, known.b, known.c, known.d
    else:
        z = np.linspace(_NEAREST, mode.range_max, _POINTS)
        floor = _floor_share(np.minimum(z, flexx2().mode(_PAIR[0]).range_max), reference)
        sigma = known.sigma_z(z, 0.0) * np.sqrt(floor + (1 - floor) * (reference / time) ** 2)
        a, b, c = _relative_least_squares(z, sigma)
        d = known.d * reference / time
    edges = known.sigma_x * (time / reference) ** _edge_exponent()
    values = {'a': a, 'b': b, 'c': c, 'd': d}
    return {name: round(float(value), 6) for name, value in values.items()} | {
        'n': known.n,
        'sigma_x': round(edges, 3),
    }


def _pair():
    slow, fast = ((EXPOSURE_US[name], flexx2().mode(name).noise) for name in _PAIR)
    return slow, fast


def _floor_share(z, time):
    # The fraction of the floor in Mode_5's variance at an exposure, by distance.
    (slow, at_slow), (fast, at_fast) = _pair()
    calm, noisy = at_slow.sigma_z(z, 0.0) ** 2, at_fast.sigma_z(z, 0.0) ** 2
    read = (noisy - calm) / (fast**-2 - slow**-2)
    floor = np.maximum(calm - read / slow**2, 0.0)
    return floor / (floor + read / time**2)


def _edge_exponent():
    (slow, at_slow), (fast, at_fast) = _pair()
    return round(float(np.log(at_fast.sigma_x / at_slow.sigma_x) / np.log(fast / slow)), 2)


def _relative_least_squares(z, sigma):
    design = np.stack([np.ones_like(z), z, z**2], axis=1) / sigma[:, None]
    return np.linalg.lstsq(design, np.ones_like(z), rcond=None)[0]
