"""Where the camera is, and what its lens is."""

from boards import K
import numpy as np

from signatures.tools import close, pair, QUIET, RAY_X, RAY_Y, SHAPE, shift, signature, U, V, wall


def rotation(degrees):
    """Return the rotation by a rotation vector: the matrix exponential's series."""
    x, y, z = np.radians(degrees)
    generator = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    total, term = np.eye(3), np.eye(3)
    for i in range(1, 25):
        term = term @ generator / i
        total = total + term
    return total


def plane(normal, rays, position):
    """Return the depth of the plane normal . X = 1 along rays (3, H, W) from a position."""
    return (1 - normal @ position) / np.tensordot(normal, rays, 1)


@signature
def pose_error():
    rays = np.stack([RAY_X, RAY_Y, np.ones(SHAPE)])
    pose = {'x': 0.03, 'y': -0.02, 'z': 0.05, 'pitch_deg': 2.0, 'yaw_deg': -3.0, 'roll_deg': 4.0}
    for strength in (0.5, 2.0):
        options = {'profile': QUIET, 'strength': strength, 'usecase': 'Mode_9_30fps'}
        position, turn = strength * np.reshape([*pose.values()], (2, 3))
        turned = np.tensordot(rotation(turn), rays, 1)
        for normal in (np.array([0, 0, 0.8]), np.array([0.4, -0.3, 0.7])):
            clean = plane(normal, rays, np.zeros(3))
            wanted = plane(normal, turned, position) / 1.0
            frame, _ = pair('pose_error', clean, **options, **pose)
            np.testing.assert_allclose(frame.depth, wanted, rtol=2e-5)
    # Typical values, one by one: forward is nearer; to the right, the picture goes left.
    still = dict.fromkeys(pose, 0.0)
    close(shift('pose_error', wall(1.5), profile=QUIET, **{**still, 'z': 0.005}), -0.005)
    stripe = np.where(U < 100, 1.0, 0.2)
    frame, _ = pair('pose_error', wall(1.5), 0, stripe, profile=QUIET, **{**still, 'x': 0.05})
    edge = (frame.amplitude[86] > 0.3).sum()
    assert 100 - edge == round(0.05 * K[0, 0] / 1.5)


@signature
def intrinsics_error():
    given = {'focal': 0.01, 'cx': 1.5, 'cy': -2.0, 'aspect': -0.006}
    given |= {'k1': -0.02, 'k2': 0.01, 'p1': 0.002, 'p2': -0.001, 'k3': 0.003}
    for strength in (1.0, 3.0):
        focal, cx, cy, aspect, k1, k2, p1, p2, k3 = (strength * value for value in given.values())
        # The ray whose distorted image is the pixel, by Newton's method with numeric slopes.
        target = np.stack(
            [
                (U - K[0, 2] - cx) / (K[0, 0] * (1 + focal)),
                (V - K[1, 2] - cy) / (K[1, 1] * (1 + focal + aspect)),
            ]
        )

        def bend(x, y):
            r2 = x * x + y * y
            radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3  # noqa: B023
            return np.stack(
                [
                    x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),  # noqa: B023
                    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,  # noqa: B023
                ]
            )

        x, y = target.copy()
        for _ in range(20):
            miss = bend(x, y) - target
            a, b = (bend(x + 1e-6, y) - bend(x, y)) / 1e-6, (bend(x, y + 1e-6) - bend(x, y)) / 1e-6
            det = a[0] * b[1] - a[1] * b[0]
            x, y = (
                x - (miss[0] * b[1] - miss[1] * b[0]) / det,
                y - (miss[1] * a[0] - miss[0] * a[1]) / det,
            )
        for normal in (np.array([0, 0, 0.8]), np.array([0.4, -0.3, 0.7])):
            clean = plane(normal, np.stack([RAY_X, RAY_Y, np.ones(SHAPE)]), np.zeros(3))
            wanted = plane(normal, np.stack([x, y, np.ones(SHAPE)]), np.zeros(3))
            # Beyond the image's border nothing is known of the plane.
            u, v = x * K[0, 0] + K[0, 2], y * K[1, 1] + K[1, 2]
            inside = (u > 0) & (u < SHAPE[1] - 1) & (v > 0) & (v < SHAPE[0] - 1)
            assert inside.mean() > 0.85
            options = {'profile': QUIET, 'strength': strength, 'usecase': 'Mode_9_30fps'}
            frame, _ = pair('intrinsics_error', clean, **options, **given)
            np.testing.assert_allclose(frame.depth[inside], wanted[inside], rtol=2e-5)
