"""More noise, other noise, and edges that move further."""

from boards import board, edge_sigma
from flexx2_sim_ros.camera import flexx2
import numpy as np

from signatures.tools import close, pair, RAY_X, RAY_Y, SHAPE, signature, spread, wall, wave_number


@signature
def excess_noise():
    for factor, strength, wanted in ((1.3, 1.0, 1.3), (1.5, 2.0, 2.0), (0.5, 1.0, 0.5)):
        noisy, plain = spread(
            'excess_noise', wall(1.0), frames=4, factor=factor, strength=strength
        )
        close(noisy.std() / plain.std(), wanted, rel=0.01)


@signature
def ambient_light():
    levels = np.broadcast_to(np.repeat([1.0, 0.3, 0.1, 0.04], 56), SHAPE)
    for strength, reflected in ((1.0, 1.0), (2.0, 1.0), (1.0, 0.5), (2.0, 0.0)):
        settings = {'k': 0.0008, 'strength': strength, 'reflected': reflected}
        noisy, plain = spread('ambient_light', wall(1.5), levels, **settings)
        background = 1 - reflected * (1 - levels)
        amplitude = levels / np.sqrt(1 + RAY_X**2 + RAY_Y**2) / 1.5**2
        for column in (20, 130, 190):
            part = np.s_[40:130, column : column + 15]
            extra = noisy[:, *part].var() - plain[:, *part].var()
            wanted = np.mean(background[part] * (strength * 0.8 / amplitude[part]) ** 2)
            # White: less than the noise there is already; 81,000 samples know that to 0.5 %.
            close(extra, wanted, within=0.05 * plain[:, *part].var())


@signature
def heavy_tails():
    for share, width, strength in ((0.02, 5.0, 1.0), (0.03, 4.0, 3.0)):
        wild, plain = spread(
            'heavy_tails', wall(1.0), frames=8, share=share, width=width, strength=strength
        )
        changed = np.abs(wild - plain) > 1e-3
        close(changed.mean(), share * strength, rel=0.05)
        close(wild[changed], width * plain[changed], rel=1e-3, within=1e-3)
        close(wild.var() / plain.var(), 1 + share * strength * (width**2 - 1))


@signature
def phase_noise_wiggling():
    # The variance of a wall over that without the effect. Both have the same random numbers.
    for mode in ('Mode_5_30fps', 'Mode_9_30fps'):
        frequencies = flexx2().mode(mode).modulation_hz
        weights = np.square(frequencies) / np.square(frequencies).sum()
        for given, strength in (((0.0, 0.4, 2.0), 1.0), ((0.3, -0.2, 4.0), 2.0)):
            sine, cosine, periods = given
            for distance in (1.0, 1.2, 1.5):
                settings = {'sine': sine, 'cosine': cosine, 'periods': periods}
                noisy, plain = spread(
                    'phase_noise_wiggling',
                    wall(distance),
                    frames=20,
                    strength=strength,
                    usecase=mode,
                    **settings,
                )
                phases = periods * np.array([wave_number(f) for f in frequencies]) * distance
                wave = strength * (sine * np.sin(phases) + cosine * np.cos(phases))
                close(noisy.var() / plain.var(), weights @ (1 + wave), rel=0.01)


@signature
def lateral_noise():
    target = board(1.0, 0, half_width=0.25, background=2.0)
    region = slice(140, 190)
    right = int(np.flatnonzero(np.isfinite(target.incidence[86]))[-1])
    assert region.start + 15 < right < region.stop - 15

    def positions(**parameters):
        """Return where the edge is: (T, H)."""
        frame, _ = pair('lateral_noise', target.depth, np.arange(80), **parameters)
        assert edge_sigma(frame.depth, region) > 0
        return (frame.depth[:, :, region] < 1.5).sum(axis=2) - (right + 1.0 - region.start)

    for factor, strength, wanted in ((1.5, 1.0, 1.5), (1.5, 3.0, 2.5), (0.7, 1.0, 0.7)):
        moved = positions(factor=factor, laplace=0.0, strength=strength)
        close(moved.std(), 0.864 * wanted, rel=0.03)
        close((moved**4).mean() / moved.var() ** 2, 3.0)
    moved = positions(factor=2.5, laplace=1.0)
    close(moved.std(), 0.864 * 2.5, rel=0.04)
    close((moved**4).mean() / moved.var() ** 2, 6.0)  # a Laplacian's
