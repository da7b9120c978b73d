"""Find the board in each frame of a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.board import find_board
from flexx2_sim_ros.truth.files import reason_of
from flexx2_sim_ros.truth.gray import Gray, GrayFit
from flexx2_sim_ros.truth.gray_frames import gray_images, has_gray, has_gray_frames
from flexx2_sim_ros.truth.observation import observe
from flexx2_sim_ros.truth.printed import Printed
from flexx2_sim_ros.truth.target import Target
import numpy as np


@dataclass(frozen=True)
class BoardJob:
    """
    A recording and the board in it.

    Attributes
    ----------
    path : pathlib.Path
    target : Target or Printed
    camera : str or None
        Which camera of a bag that has several.
    profile : Profile or None
    motion : str
        ``auto``, ``still`` or ``moving``.
    lens_error : float
        Standard deviation of the focal length, as a fraction.
    wall : bool
        Whether the board is glued to a wall, whose rest is known as well.

    """

    path: Path
    target: Target | Printed
    camera: str | None
    profile: Profile | None
    motion: str
    lens_error: float
    wall: bool = False


@dataclass(frozen=True)
class BoardPoses:
    """
    The poses of the camera relative to the board in a recording.

    Attributes
    ----------
    moving : bool
    poses : tuple
        Poses of the camera in the frame of the board, as `Pose.numbers`: one for a still
        recording, one for each frame of a moving one; None where the board is not found.
    covariances : tuple
        (6, 6) covariances of their motions, or None.
    blur, contrast, power : float
        Medians of these values of `GrayFit`.
    reason : str
        Why the board is not found; empty if it is found in a frame.

    """

    moving: bool
    poses: tuple[tuple[float, ...] | None, ...]
    covariances: tuple[Any, ...]
    blur: float
    contrast: float
    power: float
    reason: str


def place_board(job: BoardJob) -> BoardPoses:
    """Find the board in a recording, or the reason why it is not found."""
    try:
        return _found(job)
    except InputError as error:  # The others can be used.
        return _placed(False, [reason_of(error, job.path)])


def _found(job: BoardJob) -> BoardPoses:
    reader = open_recording(job.path, job.camera, job.profile)
    footage = observe(reader, job.profile, job.motion)
    moving, rays = footage.moving, footage.still.rays
    if not has_gray(reader):
        return _placed(moving, ['it has no gray image (amplitude)'])
    if moving and not has_gray_frames(reader):
        return _placed(moving, ['it has one gray image for all frames, but moves'])
    found: list[GrayFit | str] = []
    before = None
    for image in gray_images(reader, moving):
        fit = find_board(job.target, Gray(image, rays), job.lens_error, before)
        found.append(fit)
        before = None if isinstance(fit, str) else fit
    return _placed(moving, found)


def _placed(moving: bool, found: list[Any]) -> BoardPoses:
    fits = [fit for fit in found if isinstance(fit, GrayFit)]
    reasons = [fit for fit in found if isinstance(fit, str)]
    good = [isinstance(fit, GrayFit) for fit in found]

    def middle(name: str) -> float:
        return float(np.median([getattr(fit, name) for fit in fits])) if fits else 0.0

    return BoardPoses(
        moving,
        tuple(
            tuple(fit.pose.numbers()) if ok else None for fit, ok in zip(found, good, strict=True)
        ),
        tuple(fit.covariance if ok else None for fit, ok in zip(found, good, strict=True)),
        middle('blur'),
        middle('contrast'),
        middle('power'),
        '' if fits else max(set(reasons), key=reasons.count),
    )
