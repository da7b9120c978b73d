"""The ground truth of the frames that are compared."""

from dataclasses import replace

from flexx2_sim_ros.recording.truth import Truth
import numpy as np


def of_frames(truth: Truth, chosen: np.ndarray) -> Truth:
    """Return the truth of chosen frames; a mask without unknown pixels is dropped."""
    known, sigma = (
        one if one is None or one.ndim < 3 else one[chosen]
        for one in (truth.known, truth.clean_sigma)
    )
    return replace(truth, known=None if known is None or known.all() else known, clean_sigma=sigma)


def known_in(frames: np.ndarray, clean: np.ndarray, truth: Truth) -> Truth:
    """Return a truth that is unknown outside of (T,) bool `frames`; `clean` is (T, H, W)."""
    if frames.all():
        return truth
    known = np.broadcast_to(frames[:, None, None], clean.shape)
    return replace(truth, known=known if truth.known is None else known & truth.known)


def first_known(clean: np.ndarray, known: np.ndarray | None) -> np.ndarray:
    """Return (H, W) the first known clean depth of each pixel, of (T, H, W) frames."""
    # A pixel that is unknown in the first frame may stand still all the same.
    if known is None or known.ndim < 3:
        return np.asarray(clean[0])
    return np.take_along_axis(clean, known.argmax(axis=0)[None], axis=0)[0]


def still(truth: Truth, there: np.ndarray) -> Truth:
    """
    Return the truth of one image for a still scene.

    A pixel is known if all frames know it that have a clean image, (T,) `there`. Its sigma is the
    largest of all frames.
    """
    known, sigma = truth.known, truth.clean_sigma
    return replace(
        truth,
        known=known[there].all(axis=0) if known is not None and known.ndim == 3 else known,
        clean_sigma=sigma.max(axis=0) if sigma is not None and sigma.ndim == 3 else sigma,
    )
