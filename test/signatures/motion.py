"""Late stamps, and surfaces that move between raw frames."""

from flexx2_sim_ros.camera import flexx2
import numpy as np

from signatures.tools import close, pair, QUIET, SHAPE, shift, signature, STEP_5, U, wall


def moving(speed, start=1.5, frames=4):
    """Return a wall's distances in successive frames, and their stamps."""
    stamps = np.arange(frames) * STEP_5
    distances = start + speed * stamps * 1e-9
    return np.broadcast_to(distances[:, None, None], (frames, *SHAPE)), stamps


@signature
def time_offset():
    for speed in (-1.2, 0.7):
        clean, stamps = moving(speed, frames=10)
        for latency, strength in ((0.02, 1.0), (0.02, 4.0), (-0.02, 1.0), (0.12, 1.5)):
            seen = shift(
                'time_offset', clean, stamps, profile=QUIET, latency=latency, strength=strength
            )
            close(seen[-2:], -speed * latency * strength, rel=1e-3)
    # Before it has seen enough, it shows the first frame.
    frame, _ = pair('time_offset', clean, stamps, profile=QUIET, latency=0.1)
    close(frame.depth[1], clean[0], rel=1e-6)


@signature
def motion_artefact():
    mode = flexx2().mode('Mode_5_30fps')
    duration = mode.raw_frames * (mode.exposure_us[1] + 600) * 1e-6
    for speed in (-1.0, 1.5):  # Towards the camera, what was seen before is farther away.
        for strength, stretch in ((1.0, 1.0), (2.0, 1.5)):
            errors = np.array(
                [
                    shift(
                        'motion_artefact',
                        *moving(speed, start, 2),
                        profile=QUIET,
                        stretch=stretch,
                        strength=strength,
                    )[-1, 0, 0]
                    for start in np.linspace(1.2, 2.2, 40)
                ]
            )
            # Its sign is certain; taps at four moments let it swing about half the time.
            assert (np.sign(errors) == -np.sign(speed)).all()
            close(errors.mean(), -0.5 * speed * strength * stretch * duration)
            close(np.ptp(errors), 0.25 * abs(speed) * strength * stretch * duration)
        # Stamped at the beginning, it is as much the other way.
        errors = np.array(
            [
                shift(
                    'motion_artefact',
                    *moving(speed, start, 2),
                    profile=QUIET,
                    strength=1.0,
                    stamp_at=0.0,
                )[-1, 0, 0]
                for start in np.linspace(1.2, 2.2, 40)
            ]
        )
        close(errors.mean(), 0.5 * speed * duration)
    assert not shift('motion_artefact', *moving(0.0), profile=QUIET).any()
    # A border between two colours that goes by on a wall, 20 pixels in a frame. Raw frames see
    # both colours in the pixels that it has just left, or that it comes to next; at some phases
    # they do not matter.
    colours = np.array([np.where(border > U, 0.8, 0.2) for border in (100, 120)])
    walls = np.broadcast_to(wall(1.5), (2, *SHAPE))
    reach = 20 * duration / (STEP_5 * 1e-9)
    for stamp_at, sign in ((1.0, 1), (0.0, -1)):
        errors = shift(
            'motion_artefact',
            walls,
            np.array([0, STEP_5]),
            colours,
            profile=QUIET,
            stretch=2.0,
            stamp_at=stamp_at,
        )[1]
        passed = (sign * (119.5 - U) > 0) & (sign * (119.5 - U) < 2 * reach + 1)
        assert not errors[~passed].any()
        assert 0.4 < np.mean(np.abs(errors[passed]) > 0.01) * passed[0].sum() / (2 * reach) < 0.9
