"""
One function an effect: on a scene made for it, it changes what its parameters say.

Direction and within 15 %, against formulas written here, not those of the effect. Cameras with
and without an effect share their noise, so differences show the effect alone; `QUIET` has none
at all. All is seeded; where something random is measured, the tolerance is at least 6 standard
errors (false failure below 2e-9 were the seeds to change).
"""

from collections.abc import Callable
from dataclasses import replace
import math
from typing import Any

from boards import board, edge_sigma, K
from flexx2_sim_ros.camera import Camera, flexx2, Frame, NoiseModel, Profile
import numpy as np

SPEED_OF_LIGHT = 299_792_458.0
SHAPE = (172, 224)
STEP_5, STEP_9 = 33_333_333, 33_333_333
V, U = np.mgrid[:SHAPE[0], :SHAPE[1]].astype(np.float64)
RAY_X, RAY_Y = (U - K[0, 2]) / K[0, 0], (V - K[1, 2]) / K[1, 1]
_NONE = NoiseModel(0.0, 0.0, 0.0, 0.0, 2.7, 0.0)
QUIET = replace(flexx2(), modes=tuple(replace(mode, noise=_NONE) for mode in flexx2().modes))
SIGNATURES: dict[str, Callable[[], None]] = {}


def signature(function: Callable[[], None]) -> Callable[[], None]:
    """Register the signature of the effect that the function is named after."""
    SIGNATURES[function.__name__] = function
    return function


def pair(name: str, clean: Any, stamp: Any = 0, reflectivity: Any = None, *,
         usecase: str = 'Mode_5_30fps', profile: Profile | None = None,
         **parameters: float) -> tuple[Frame, Frame]:
    """Return what a camera with an effect and one without it see."""
    with_it, without = (
        Camera(usecase, profile=profile, effects=effects, seed=7).capture(
            clean, K, stamp, reflectivity)
        for effects in ({name: parameters}, ()))
    return with_it, without


def shift(name: str, clean: Any, stamp: Any = 0, reflectivity: Any = None,
          **options: Any) -> np.ndarray:
    """Return by how much an effect changes depth, metres."""
    with_it, without = pair(name, clean, stamp, reflectivity, **options)
    return with_it.depth.astype(np.float64) - without.depth


def wave_number(frequency: float = 60e6) -> float:
    """Return radians a metre of depth."""
    return 4 * math.pi * frequency / SPEED_OF_LIGHT


def close(found: Any, wanted: Any, rel: float = 0.15, within: float = 0.0) -> None:
    """Assert that all are within 15 % of what is wanted."""
    np.testing.assert_allclose(found, wanted, rtol=rel, atol=within)


def ramp(near: float, far: float) -> np.ndarray:
    """Return distances that grow from left to right, without jumps."""
    return np.broadcast_to(np.linspace(near, far, SHAPE[1]), SHAPE)


def wall(distance: float) -> np.ndarray:
    return np.full(SHAPE, distance)


# Geometry


def rotation(degrees: np.ndarray) -> np.ndarray:
    """Return the rotation by a rotation vector: the matrix exponential's series."""
    x, y, z = np.radians(degrees)
    generator = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    total, term = np.eye(3), np.eye(3)
    for i in range(1, 25):
        term = term @ generator / i
        total = total + term
    return total


def plane(normal: np.ndarray, rays: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the depth of the plane normal . X = 1 along rays (3, H, W) from a position."""
    return (1 - normal @ position) / np.tensordot(normal, rays, 1)


@signature
def pose_error() -> None:
    rays = np.stack([RAY_X, RAY_Y, np.ones(SHAPE)])
    pose = {'x': 0.03, 'y': -0.02, 'z': 0.05, 'pitch_deg': 2.0, 'yaw_deg': -3.0, 'roll_deg': 4.0}
    for strength in (0.5, 2.0):
        position = strength * np.array([pose['x'], pose['y'], pose['z']])
        turned = np.tensordot(rotation(strength * np.array(
            [pose['pitch_deg'], pose['yaw_deg'], pose['roll_deg']])), rays, 1)
        for normal in (np.array([0, 0, 0.8]), np.array([0.4, -0.3, 0.7])):
            clean = plane(normal, rays, np.zeros(3))
            wanted = plane(normal, turned, position) / 1.0
            frame, _ = pair('pose_error', clean, profile=QUIET, strength=strength,
                            usecase='Mode_9_30fps', **pose)
            np.testing.assert_allclose(frame.depth, wanted, rtol=2e-5)
    # Typical values, one by one: forward is nearer; to the right, the picture goes left.
    close(shift('pose_error', wall(1.5), profile=QUIET, x=0, y=0, z=0.005, pitch_deg=0, yaw_deg=0,
                roll_deg=0), -0.005)
    stripe = np.where(U < 100, 1.0, 0.2)
    frame, _ = pair('pose_error', wall(1.5), 0, stripe, profile=QUIET, x=0.05, y=0, z=0,
                    pitch_deg=0, yaw_deg=0, roll_deg=0)
    edge = (frame.amplitude[86] > 0.3).sum()
    assert 100 - edge == round(0.05 * K[0, 0] / 1.5)


@signature
def intrinsics_error() -> None:
    given = {'focal': 0.01, 'cx': 1.5, 'cy': -2.0, 'k1': -0.02, 'k2': 0.01, 'p1': 0.002,
             'p2': -0.001, 'k3': 0.003}
    for strength in (1.0, 3.0):
        focal, cx, cy, k1, k2, p1, p2, k3 = (strength * value for value in given.values())
        # The ray whose distorted image is the pixel, by Newton's method with numeric slopes.
        target = np.stack([(U - K[0, 2] - cx) / (K[0, 0] * (1 + focal)),
                           (V - K[1, 2] - cy) / (K[1, 1] * (1 + focal))])

        def bend(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            r2 = x * x + y * y
            radial = 1 + k1 * r2 + k2 * r2 ** 2 + k3 * r2 ** 3  # noqa: B023
            return np.stack([x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),  # noqa: B023
                             y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])  # noqa: B023
        x, y = target.copy()
        for _ in range(20):
            miss = bend(x, y) - target
            a, b = (bend(x + 1e-6, y) - bend(x, y)) / 1e-6, (bend(x, y + 1e-6) - bend(x, y)) / 1e-6
            det = a[0] * b[1] - a[1] * b[0]
            x, y = (x - (miss[0] * b[1] - miss[1] * b[0]) / det,
                    y - (miss[1] * a[0] - miss[0] * a[1]) / det)
        for normal in (np.array([0, 0, 0.8]), np.array([0.4, -0.3, 0.7])):
            clean = plane(normal, np.stack([RAY_X, RAY_Y, np.ones(SHAPE)]), np.zeros(3))
            wanted = plane(normal, np.stack([x, y, np.ones(SHAPE)]), np.zeros(3))
            # Beyond the image's border nothing is known of the plane.
            u, v = x * K[0, 0] + K[0, 2], y * K[1, 1] + K[1, 2]
            inside = (u > 0) & (u < SHAPE[1] - 1) & (v > 0) & (v < SHAPE[0] - 1)
            assert inside.mean() > 0.85
            frame, _ = pair('intrinsics_error', clean, profile=QUIET, strength=strength,
                            usecase='Mode_9_30fps', **given)
            np.testing.assert_allclose(frame.depth[inside], wanted[inside], rtol=2e-5)


# Motion


def moving(speed: float, start: float = 1.5, frames: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Return a wall's distances in successive frames, and their stamps."""
    stamps = np.arange(frames) * STEP_5
    distances = start + speed * stamps * 1e-9
    return np.broadcast_to(distances[:, None, None], (frames, *SHAPE)), stamps


@signature
def time_offset() -> None:
    for speed in (-1.2, 0.7):
        clean, stamps = moving(speed, frames=10)
        for latency, strength in ((0.02, 1.0), (0.02, 4.0), (-0.02, 1.0), (0.12, 1.5)):
            seen = shift('time_offset', clean, stamps, profile=QUIET, latency=latency,
                         strength=strength)
            close(seen[-2:], -speed * latency * strength, rel=1e-3)
    # Before it has seen enough, it shows the first frame.
    frame, _ = pair('time_offset', clean, stamps, profile=QUIET, latency=0.1)
    close(frame.depth[1], clean[0], rel=1e-6)


@signature
def motion_artefact() -> None:
    mode = flexx2().mode('Mode_5_30fps')
    duration = mode.raw_frames * (mode.exposure_us[1] + 600) * 1e-6
    for speed in (-1.0, 1.5):  # Towards the camera, what was seen before is farther away.
        for strength, stretch in ((1.0, 1.0), (2.0, 1.5)):
            errors = np.array([
                shift('motion_artefact', *moving(speed, start, 2), profile=QUIET, stretch=stretch,
                      strength=strength)[-1, 0, 0] for start in np.linspace(1.2, 2.2, 40)])
            # Its sign is certain; taps at four moments let it swing about half the time.
            assert (np.sign(errors) == -np.sign(speed)).all()
            close(errors.mean(), -0.5 * speed * strength * stretch * duration)
            close(np.ptp(errors), 0.25 * abs(speed) * strength * stretch * duration)
        # Stamped at the beginning, it is as much the other way.
        errors = np.array([
            shift('motion_artefact', *moving(speed, start, 2), profile=QUIET, strength=1.0,
                  stamp_at=0.0)[-1, 0, 0] for start in np.linspace(1.2, 2.2, 40)])
        close(errors.mean(), 0.5 * speed * duration)
    assert not shift('motion_artefact', *moving(0.0), profile=QUIET).any()
    # A border between two colours that goes by on a wall: raw frames of both, here and there, in
    # up to 3/4 of the pixels that it goes over in that time; at some phases they do not matter.
    colours = np.array([np.where(border > U, 0.8, 0.2) for border in (100, 140)])
    walls = np.broadcast_to(wall(1.5), (2, *SHAPE))
    errors = shift('motion_artefact', walls, np.array([0, STEP_5]), colours, profile=QUIET)[1]
    passed = (U >= 100) & (U < 140)
    assert not errors[~passed].any()
    both = np.mean(np.abs(errors[passed]) > 0.01) / (duration / (STEP_5 * 1e-9))
    assert 0.4 < both < 0.75


# Mixtures


def step(near: float, far: float) -> np.ndarray:
    return np.where(U < 112, near, far)


@signature
def flying_pixels() -> None:
    k, near, far = wave_number(), 1.2, 2.0
    assert far - near < SPEED_OF_LIGHT / (4 * 60e6)
    clean = step(near, far)
    for strength in (1.0, 2.5):
        frame, _ = pair('flying_pixels', clean, profile=QUIET, strength=strength, share=0.3)
        both = frame.depth[10:-10, 111:113]
        assert ((both > near) & (both < far)).all()
        np.testing.assert_array_equal(np.delete(frame.depth, (111, 112), axis=1),
                                      np.delete(clean.astype(np.float32), (111, 112), axis=1))
        share = 0.3 * strength
        phasors = {z: np.exp(1j * k * z) / z ** 2 for z in (near, far)}
        for own, other, column in ((near, far, 0), (far, near, 1)):
            mixed = (1 - share) * phasors[own] + share * (6 * phasors[own]
                                                          + 3 * phasors[other]) / 9
            turned = np.angle(mixed / phasors[own]) / k
            close(both[:, column] - own, turned)
            flat = np.hypot(1, np.hypot(RAY_X, RAY_Y))[10:-10, 111]
            close(frame.amplitude[10:-10, 111 + column] * flat, abs(mixed), rel=0.02)
    # Both frequencies mix for themselves.
    frame, _ = pair('flying_pixels', clean, profile=QUIET, usecase='Mode_9_30fps')
    assert ((frame.depth[:, 111:113] > near) & (frame.depth[:, 111:113] < far)).all()


def corner(apex: float) -> np.ndarray:
    """Return two walls that meet at right angles on the optical axis."""
    return apex / (1 + np.abs(RAY_X))


def bounce(clean: np.ndarray, reflectivity: float, columns: list[int], k: float) -> np.ndarray:
    """Return the error of depth in row 86 of a corner, by the light of all pixels."""
    points = np.stack([RAY_X, RAY_Y, np.ones(SHAPE)], -1) * clean[..., None]
    normals = np.stack([-np.sign(RAY_X), 0 * U, -np.ones(SHAPE)], -1) / math.sqrt(2)
    ranges = np.linalg.norm(points, axis=-1)
    cosine = -(normals * points).sum(-1) / ranges
    solid = (clean / ranges) ** 3 / (K[0, 0] * K[1, 1])
    power = reflectivity * solid  # of a pixel: irradiance cos / r^2 times area solid r^2 / cos
    errors = []
    for column in columns:
        here, normal = points[86, column], normals[86, column]
        way = points - here
        length = np.linalg.norm(way, axis=-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            light = (power * np.maximum(way @ normal, 0) * np.maximum(-(way * normals).sum(-1), 0)
                     / (math.pi * length ** 4))
        light[86, column] = 0
        detour = ranges + length - ranges[86, column]
        direct = cosine[86, column] / ranges[86, column] ** 2
        gamma = (light * np.exp(0.5j * k * detour)).sum() / direct
        errors.append(np.angle(1 + gamma) / k * clean[86, column] / ranges[86, column])
    return np.array(errors)


@signature
def multipath() -> None:
    columns = [8, 30, 60, 80, 95, 130, 150, 190, 215]
    for apex, reflectivity in ((1.0, 0.9), (2.0, 0.6)):
        clean = corner(apex)
        frame, base = pair('multipath', clean, 0, np.full(SHAPE, reflectivity), profile=QUIET)
        error = frame.depth.astype(np.float64) - base.depth
        close(error[86, columns], bounce(clean, reflectivity, columns, wave_number()))
        assert (error > 0).all()
        assert (frame.amplitude[:, 100:124] > 1.02 * base.amplitude[:, 100:124]).all()
        # No detour at the apex itself, hence least there: it stands before the planes that fit
        # the walls.
        ridge, between, far = error[86, 111], error[86, 60:90].max(), error[86, 0]
        assert ridge < far < between
        walls = error[86, 20:95]
        fit = np.polyfit(np.arange(20, 95), walls + clean[86, 20:95], 3)
        assert error[86, 111] + clean[86, 111] < np.polyval(fit, 111) - 0.25 * between
    twice = shift('multipath', clean, 0, np.full(SHAPE, 0.2), strength=2.0, profile=QUIET)
    once = shift('multipath', clean, 0, np.full(SHAPE, 0.4), profile=QUIET)
    close(twice[86, columns], once[86, columns], rel=1e-3)
    for flat in (wall(1.0), board(1.0, 40).depth):
        assert np.abs(shift('multipath', flat, profile=QUIET)).max() < 1e-5


@signature
def stray_light() -> None:
    clean, k = step(0.8, 2.0), wave_number()
    reflectivity = np.where(U < 112, 0.9, 0.05)
    cosine = 1 / np.hypot(1, np.hypot(RAY_X, RAY_Y))
    light = reflectivity * cosine / clean ** 2 * np.exp(1j * k * clean)
    width = 0.2 * SHAPE[1]

    def kernel(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return a kernel that is half its peak at `width`."""
        return (1 + (2 ** (2 / 3) - 1) * (y ** 2 + x ** 2) / width ** 2) ** -1.5
    every = np.mgrid[-SHAPE[0]:SHAPE[0], -SHAPE[1]:SHAPE[1]]
    norm = kernel(*every).sum()
    for strength in (1.0, 2.0):
        frame, base = pair('stray_light', clean, 0, reflectivity, profile=QUIET, share=0.02,
                           width=0.2, strength=strength)
        error = frame.depth.astype(np.float64) - base.depth
        for y, x in ((40, 130), (86, 160), (86, 200), (150, 220), (86, 20)):
            scattered = (kernel(V - y, U - x) * light).sum() / norm
            mixed = light[y, x] + 0.02 * strength * scattered
            turned = np.angle(mixed / light[y, x]) / k
            close(error[y, x], turned, within=1e-4)
            close(frame.amplitude[y, x], abs(mixed), rel=0.05)
        # Dark and far is pulled towards bright and near; the other way round hardly.
        assert (error[:, 130:] < 0).all()
        assert np.abs(error[:, :90]).max() < 0.1 * np.abs(error[:, 130:]).min()
    # What sends no light of its own shows nothing but scattered light.
    black = np.where(U < 112, 0.9, 0.0)
    assert (shift('stray_light', clean, 0, black, profile=QUIET)[:, 130:] < -0.9).all()


# Delays


def harmonics(error: np.ndarray, distance: np.ndarray, frequency: float) -> np.ndarray:
    """Return amplitudes of sine and cosine, orders 1 to 5, of an error over distance."""
    phase = wave_number(frequency) * distance
    design = np.stack([f(n * phase) for n in range(1, 6) for f in (np.sin, np.cos)], axis=1)
    return np.linalg.lstsq(design, error, rcond=None)[0]


@signature
def wiggling() -> None:
    clean = ramp(0.15, 2.35)
    given = {'a1': 0.006, 'b1': 0, 'a2': 0.0, 'b2': -0.005, 'a3': 0.004, 'b3': 0.0, 'a4': 0.0,
             'b4': 0.003}
    for strength in (1.0, 3.0):
        seen = shift('wiggling', clean, strength=strength, **given)[86]
        valid = np.isfinite(seen)
        close(harmonics(seen[valid], clean[86][valid], 60e6),
              strength * np.array([*given.values(), 0, 0]), within=2e-5)
    # Typical: the fourth harmonic, 3 mm RMS.
    seen = shift('wiggling', clean)[86]
    close(np.sqrt(np.nanmean(seen ** 2)), 0.003)
    # With two frequencies each has its own period; they are weighted by their squares.
    seen = shift('wiggling', ramp(0.15, 6.8), usecase='Mode_9_30fps', profile=QUIET)[86]
    z = np.linspace(0.15, 6.8, SHAPE[1])
    close(seen, 0.0042 * (0.64 * np.sin(4 * wave_number(80e6) * z)
                          + 0.36 * np.sin(4 * wave_number(60e6) * z)), within=2e-5)


@signature
def fixed_pattern() -> None:
    one = shift('fixed_pattern', wall(0.6), usecase='Mode_9_30fps')
    other = shift('fixed_pattern', ramp(1.0, 4.0), 10 ** 9, usecase='Mode_9_30fps', strength=2.0)
    close(one.std(), 0.0015)
    close(other.std(), 0.003)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.999
    # Grain: it has no slow part, and neighbours do not share it.
    smooth = one.reshape(43, 4, 56, 4).mean(axis=(1, 3))
    assert smooth.std() < 0.2 * one.std()
    stranger = Camera(effects={'fixed_pattern': None}, seed=7, name='right')
    plain = Camera(seed=7, name='right')
    third = stranger.capture(wall(0.6), K, 0).depth - plain.capture(wall(0.6), K, 0).depth
    assert abs(np.corrcoef(one.ravel(), third.ravel())[0, 1]) < 6 / math.sqrt(one.size)


@signature
def amplitude_bias() -> None:
    levels = np.repeat([1.0, 0.5, 0.2, 0.1, 0.03, 0.01, 0.0], 32)
    amplitude = levels[None] / np.sqrt(1 + RAY_X ** 2 + RAY_Y ** 2) / 0.8 ** 2
    seen = shift('amplitude_bias', wall(0.8), 0, np.broadcast_to(levels, SHAPE), slope=-0.004,
                 intercept=0.002, knee=0.8, span=3.0, strength=1.5)
    with np.errstate(divide='ignore'):
        wanted = 1.5 * (0.002 - 0.004 * np.clip(np.log(amplitude / 0.8), -3, 0))
    close(seen, wanted, rel=0.01, within=1e-6)
    # Typical: black squares seem farther than white ones, by mm.
    seen = shift('amplitude_bias', wall(1.2), 0, np.where(U < 112, 0.8, 0.08))
    close(np.median(seen[:, 150:]) - np.median(seen[:, :60]), 0.003 * math.log(10))


@signature
def offset() -> None:
    for bias, strength in ((0.005, 1.0), (-0.02, 2.5)):
        for distance in (0.5, 2.0):
            close(shift('offset', wall(distance), bias=bias, strength=strength), bias * strength,
                  rel=1e-3)


@signature
def warm_up_drift() -> None:
    seconds = np.array([0.0, 60.0, 900.0, 1800.0, 7200.0])
    small = np.ones((4, 4))
    for uptime in (0.0, 900.0):
        seen = shift('warm_up_drift', wall(1.0), seconds + 55.0, uptime=uptime, strength=1.5)
        close(seen.mean(axis=(1, 2)), 0.015 * np.exp(-(seconds + uptime) / 900.0), rel=0.01,
              within=1e-6)
    camera = Camera(effects={'warm_up_drift': {'bias': 0.05}}, profile=QUIET)
    shown = [camera.capture(small, K, stamp).depth[0, 0] - 1 for stamp in (0.0, 900.0, 5.0)]
    close(shown, [0.05, 0.05 / math.e, 0.05], rel=0.01)  # An earlier stamp: switched on anew.


# Noise


def spread(name: str, clean: Any, reflectivity: Any = None, frames: int = 60,
           **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of a still scene, with the effect and without, mm; (T, H, W)."""
    stamps = np.arange(frames)
    return tuple((frame.depth.astype(np.float64) - clean) * 1e3  # type: ignore[return-value]
                 for frame in pair(name, clean, stamps, reflectivity, **options))


@signature
def excess_noise() -> None:
    for factor, strength, wanted in ((1.3, 1.0, 1.3), (1.5, 2.0, 2.0), (0.5, 1.0, 0.5)):
        noisy, plain = spread('excess_noise', wall(1.0), frames=4, factor=factor,
                              strength=strength)
        close(noisy.std() / plain.std(), wanted, rel=0.01)


@signature
def ambient_light() -> None:
    levels = np.broadcast_to(np.repeat([1.0, 0.3, 0.1, 0.04], 56), SHAPE)
    for strength in (1.0, 2.0):
        noisy, plain = spread('ambient_light', wall(1.5), levels, k=0.0008, strength=strength)
        amplitude = levels / np.sqrt(1 + RAY_X ** 2 + RAY_Y ** 2) / 1.5 ** 2
        for column in (20, 130, 190):
            part = np.s_[40:130, column:column + 15]
            extra = noisy[:, *part].var() - plain[:, *part].var()
            wanted = np.mean((strength * 0.8 / amplitude[part]) ** 2)
            # White: less than the noise there is already; 81,000 samples know that to 0.5 %.
            close(extra, wanted, within=0.05 * plain[:, *part].var())


@signature
def heavy_tails() -> None:
    for share, width, strength in ((0.02, 5.0, 1.0), (0.03, 4.0, 3.0)):
        wild, plain = spread('heavy_tails', wall(1.0), frames=8, share=share, width=width,
                             strength=strength)
        changed = np.abs(wild - plain) > 1e-3
        close(changed.mean(), share * strength, rel=0.05)
        close(wild[changed], width * plain[changed], rel=1e-3, within=1e-3)
        close(wild.var() / plain.var(), 1 + share * strength * (width ** 2 - 1))


@signature
def lateral_noise() -> None:
    target = board(1.0, 0, half_width=0.25, background=2.0)
    region = slice(140, 190)
    right = int(np.flatnonzero(np.isfinite(target.incidence[86]))[-1])
    assert region.start + 15 < right < region.stop - 15

    def positions(**parameters: float) -> np.ndarray:
        """Return where the edge is: (T, H)."""
        frame, _ = pair('lateral_noise', target.depth, np.arange(80), **parameters)
        assert edge_sigma(frame.depth, region) > 0
        return (frame.depth[:, :, region] < 1.5).sum(axis=2) - (right + 1.0 - region.start)
    for factor, strength, wanted in ((1.5, 1.0, 1.5), (1.5, 3.0, 2.5), (0.7, 1.0, 0.7)):
        moved = positions(factor=factor, laplace=0.0, strength=strength)
        close(moved.std(), 0.864 * wanted, rel=0.03)
        close((moved ** 4).mean() / moved.var() ** 2, 3.0)
    moved = positions(factor=2.5, laplace=1.0)
    close(moved.std(), 0.864 * 2.5, rel=0.04)
    close((moved ** 4).mean() / moved.var() ** 2, 6.0)  # a Laplacian's


# Wrap, filters, storage


@signature
def range_wrap() -> None:
    half = SPEED_OF_LIGHT / (2 * 60e6)
    for distance in (2.9, 3.7, 6.0):
        frame, base = pair('range_wrap', wall(distance), profile=QUIET)
        assert np.isnan(base.depth).all()
        close(frame.depth, distance % half, rel=1e-5)
    frame, _ = pair('range_wrap', wall(3.0), share=0.3, strength=2.0)
    close(np.isfinite(frame.depth).mean(), 0.6, rel=0.03)
    # Two frequencies: the lattice of c / 2f1 and c / 2f2, likelier the more noise there is.
    d1, d2 = SPEED_OF_LIGHT / 160e6, SPEED_OF_LIGHT / 120e6
    assert (round(d1, 2), round(d2, 2)) == (1.87, 2.5)
    shares = []
    for distance, strength in ((3.0, 1.0), (6.0, 1.0), (6.6, 1.0), (6.0, 2.0)):
        frame, base = pair('range_wrap', wall(distance), np.arange(12), usecase='Mode_9_30fps',
                           strength=strength)
        jump = (frame.depth - base.depth)[np.isfinite(base.depth)]
        jumped = np.isfinite(jump) & (np.abs(jump) > 0.1)
        shares.append(jumped.mean())
        sigma = np.nanmean(base.sigma)
        # Errors e of f^-1 each; apart by more than half a step d1 d2 / 7.5 m.
        apart = strength * sigma * math.sqrt((80 ** 2 + 60 ** 2) * (80 ** -2 + 60 ** -2))
        close(shares[-1], math.erfc(d1 * d2 / 7.495 / 2 / apart / math.sqrt(2)), within=1e-4)
        # By m steps: n wraps of each, weighted by f^2, less whole beats.
        lattice = np.array([0.64 * d1 * a + 0.36 * d2 * b for a in range(-4, 5)
                            for b in range(-3, 4) if abs(a * d1 - b * d2) < 1.3])
        assert all(np.abs(lattice - one).min() < 0.002 for one in np.unique(jump[jumped]))
    assert shares == sorted(shares)
    assert shares[0] == 0
    one_step = jump[jumped & (np.abs(jump + 0.64 * d1 + 0.36 * d2) < 0.01)]
    assert one_step.size > 0.4 * jumped.sum()


def neighbour_correlation(errors: np.ndarray) -> float:
    return float(np.corrcoef(errors[:, :, 1:].ravel(), errors[:, :, :-1].ravel())[0, 1])


@signature
def spatial_filter() -> None:
    for mix, strength in ((0.9, 1.0), (0.3, 2.0)):
        smooth, plain = spread('spatial_filter', wall(1.0), frames=8, mix=mix, strength=strength,
                               gate=12.0)
        weights = np.full((3, 3), mix * strength / 9)
        weights[1, 1] += 1 - mix * strength
        close(smooth[:, 5:-5, 5:-5].var() / plain.var(), (weights ** 2).sum())
        close(neighbour_correlation(smooth[:, 5:-5, 5:-5]),
              (weights[:, 1:] * weights[:, :-1]).sum() / (weights ** 2).sum())
    # Typical: as measured on a Kinect v2.
    smooth, plain = spread('spatial_filter', wall(1.0), frames=8)
    assert 0.6 < neighbour_correlation(smooth[:, 5:-5, 5:-5]) < 0.7
    # Never across an edge.
    frame, _ = pair('spatial_filter', step(1.0, 2.0), profile=QUIET)
    np.testing.assert_array_equal(frame.depth, step(1.0, 2.0).astype(np.float32))


@signature
def temporal_filter() -> None:
    for share, strength in ((0.4, 1.0), (0.2, 3.0)):
        smooth, plain = spread('temporal_filter', wall(1.0), frames=80, share=share,
                               strength=strength)
        a, settled = share * strength, smooth[20:]
        close(np.mean(settled[1:] * settled[:-1]) / settled.var(), a, rel=0.03)
        close(settled.var() / plain.var(), (1 - a) / (1 + a), rel=0.03)
    # It starts afresh where depth changes by more than 6 sigma.
    clean = np.concatenate([np.full((5, *SHAPE), 1.0), np.full((1, *SHAPE), 1.5)])
    frame, base = pair('temporal_filter', clean, np.arange(6))
    np.testing.assert_allclose(frame.depth[5], base.depth[5], rtol=2e-7)


@signature
def quantisation() -> None:
    for size, strength in ((0.004, 1.0), (0.0117, 2.0)):
        frame, base = pair('quantisation', ramp(0.5, 2.0), step=size, strength=strength)
        q = size * strength
        steps = frame.depth.astype(np.float64) / q
        valid = np.isfinite(steps)
        assert np.abs(steps - np.rint(steps))[valid].max() < 1e-3
        rest = (frame.depth.astype(np.float64) - base.depth)[valid]
        assert np.abs(rest).max() < 0.501 * q
        close(rest.std(), q / math.sqrt(12), rel=0.05)


# Dropouts


def logistic(logit: Any, strength: float) -> np.ndarray:
    """Return how often a chance is taken that is tried `strength` times."""
    return 1 - (1 - 1 / (1 + np.exp(-np.asarray(logit)))) ** strength


def lost(frame: Frame, base: Frame, where: np.ndarray) -> float:
    """Return the share of pixels that have depth without the effect and none with it."""
    valid = where & np.isfinite(base.depth)
    assert valid.sum() > 1000
    return float(np.isnan(frame.depth[valid]).mean())


def check_amplitude(name: str, sign: int, half: float, slope: float, strength: float,
                    **parameters: float) -> None:
    """Assert a logistic in the logarithm of the amplitude, rising or falling with it."""
    logits = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    off_axis = (np.hypot(RAY_X, RAY_Y) > math.tan(math.radians(14))) & (np.abs(U - 111) < 100)
    flat = np.sqrt(1 + RAY_X ** 2 + RAY_Y ** 2)
    shares = []
    for logit in logits:
        amplitude = half * math.exp(sign * logit / slope)
        distance = min(2.0, 1 / math.sqrt(amplitude))
        reflectivity = amplitude * distance ** 2 * flat
        assert (reflectivity[off_axis] <= 1.3).all()
        distance *= 0.8
        frame, base = pair(name, wall(distance), 0, reflectivity * 0.64, half=half, slope=slope,
                           strength=strength, **parameters)
        shares.append(lost(frame, base, off_axis))
    close(shares, logistic(logits, strength))


@signature
def low_signal_dropout() -> None:
    for half, slope, strength in ((0.012, 3.0, 1.0), (0.1, 2.0, 2.5)):
        check_amplitude('low_signal_dropout', -1, half, slope, strength)
    frame, _ = pair('low_signal_dropout', wall(1.0), 0, np.where(U < 112, 1.0, 0.0))
    assert np.isnan(frame.depth[:, 120:]).all()
    assert np.isnan(frame.depth[:, :100]).mean() < 1e-3  # 2e-6


@signature
def saturation() -> None:
    for half, slope, strength in ((3.5, 6.0, 1.0), (2.0, 4.0, 2.5)):
        check_amplitude('saturation', 1, half, slope, strength, gloss=0.5, lobe_deg=4.0)
    # Head-on, a glossy surface sends more: (1 + gloss) times as much.
    incidence = np.arctan(np.hypot(RAY_X, RAY_Y))
    distance = 1 / math.sqrt(2.0)
    for low, high in ((0, 6), (18, 24)):
        ring = (np.degrees(incidence) >= low) & (np.degrees(incidence) < high)
        shares, wanted = [], []
        for gloss in (0.0, 0.6):
            frame, base = pair('saturation', wall(distance), np.arange(8), lobe_deg=12.0,
                               gloss=gloss, usecase='Mode_9_30fps')
            shares.append(np.isnan(frame.depth[:, ring]).mean())
            lobe = 1 + gloss * np.exp(-(np.degrees(incidence) / 12) ** 2)
            logit = 6 * np.log(2.0 * np.cos(incidence) * lobe / 3.5)
            wanted.append(logistic(logit[ring], 1.0).mean())
        close(shares, wanted)
    # The gray image is white there.
    gone = np.isnan(frame.depth) & np.isfinite(base.depth)
    assert (frame.amplitude[gone] >= base.amplitude[gone]).all()


@signature
def grazing_dropout() -> None:
    for half_deg, width_deg, strength in ((60.0, 4.0, 1.0), (50.0, 6.0, 2.0)):
        for distance in (0.5, 1.5):
            shares, wanted = [], []
            for turn in (40, 55):
                target = board(distance, turn)
                frame, base = pair('grazing_dropout', target.depth, np.arange(6),
                                   half_deg=half_deg, width_deg=width_deg, distance=1.0,
                                   strength=strength, usecase='Mode_9_30fps')
                logit = ((np.degrees(target.incidence) - half_deg) / width_deg
                         + np.log(target.depth))
                for middle in (-1.5, 0.0, 1.5):
                    there = np.abs(logit - middle) < 0.25
                    valid = there & np.isfinite(base.depth)
                    if valid.sum() > 2000:
                        shares.append(np.isnan(frame.depth[valid]).mean())
                        wanted.append(logistic(logit[there], strength).mean())
            assert len(shares) >= 2
            close(shares, wanted)
