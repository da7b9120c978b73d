"""Simulate the planned recordings, with each kind of ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexx2_sim_ros.camera import Camera, Intrinsics, Profile
from flexx2_sim_ros.gap.calibration.data import GROUND_TRUTH
from flexx2_sim_ros.gap.data.given import given_effects, Table
from flexx2_sim_ros.gap.planning.plan import Plan, PlannedRecording
from flexx2_sim_ros.gap.planning.scenes import Panel, render
from flexx2_sim_ros.truth.absorbed import mostly_hidden
import numpy as np

_SCAN_ERROR = 0.003  # metres: what `flexx2 gap truth` assumes where recordings do not show it
_LOOSE = 0.1, 5.0  # metres, degrees: planes without measurements
_LEAST_PLANE = 0.01  # fraction of the image that a plane must cover
_LEAST_PIXELS = 8  # across an image, as of the smallest cameras


@dataclass(frozen=True)
class TruthKind:
    """
    A kind of ground truth: a name for tables, and words that describe it.

    * `pose`: whether the pose is known from registration, and surfaces from a scan.
    * `plane`: standard deviations of planes, if only planes are known: metres and radians.
    * `fitted`: whether the planes are fitted to the recording itself.
    """

    name: str
    words: str
    pose: bool = False
    plane: tuple[float, float] | None = None
    fitted: bool = False

    @property
    def never(self) -> set[str]:
        """Return the effects that this kind of ground truth always hides."""
        return mostly_hidden(self.name)

    def suits(self, planned: PlannedRecording) -> bool:
        """Return whether a recording can have this ground truth; planes need a still scene."""
        return self.plane is None or not planned.scene.moving


KINDS = (
    TruthKind(
        'exact', 'clean depth without errors, as of a simulated camera or of motion capture'
    ),
    TruthKind('scan', 'flexx2 gap truth --scan, of a room known to 3 mm and its scale', pose=True),
    TruthKind(
        'tape',
        'planes, measured with a tape (3 mm) and a set square (0.3 degrees)',
        plane=(GROUND_TRUTH.tape, GROUND_TRUTH.square),
    ),
    TruthKind(
        'planes',
        'planes fitted to the recordings, nothing measured',
        plane=(_LOOSE[0], float(np.radians(_LOOSE[1]))),
        fitted=True,
    ),
)
# Kinds of `flexx2 gap next` that the table of the plan does not have.
LASER = TruthKind(
    'laser',
    'planes, measured with a laser distance meter (1 mm) and a set square (0.3 degrees)',
    plane=(GROUND_TRUTH.laser, GROUND_TRUTH.square),
)
ALL_KINDS = (*KINDS, LASER)


def write_campaign(
    folder: Path,
    plan: Plan,
    profile: Profile,
    kind: TruthKind,
    effects: Table | None = None,
    seed: int = 0,
) -> None:
    """
    Write the plan's recordings with one kind of ground truth as ``.npz``.

    The folder exists. Moving scenes are left out where the truth consists of planes. `effects` are
    those of the camera, parameters by effect; `seed` is that of the noise.
    """
    for planned in filter(kind.suits, plan.recordings):
        path = folder / f'{planned.name}.npz'
        write_recording(path, plan, planned, profile, kind, effects, seed)


def write_recording(
    path: Path,
    plan: Plan,
    planned: PlannedRecording,
    profile: Profile,
    kind: TruthKind,
    effects: Table | None = None,
    seed: int = 0,
) -> None:
    """Write one recording of the plan; parameters as for `write_campaign`."""
    lens = smaller(profile.intrinsics, plan.scale)
    mode = profile.mode(plan.usecase)
    start = 100.0 + planned.scene.uptime
    stamp = start + np.rint(np.arange(plan.frames) * 1e9 / mode.rate_hz) / 1e9
    clean, reflectivity, panel = render(planned.scene, lens, stamp)
    own = given_effects(effects or {}, planned.scene.uptime)
    device = Camera(plan.usecase, profile=profile, effects=own, seed=seed + 77, name='real')
    depth = device.capture(clean, lens.matrix, stamp, reflectivity).depth
    truth = _truth(planned.scene.panels, panel, kind)
    if 'known' in truth:
        clean = np.where(truth['known'], clean, np.float32(np.nan))
    content: dict[str, Any] = {
        'depth': depth.astype(np.float32),
        'reflectivity': reflectivity,
        'K': lens.matrix,
        'stamp': stamp,
        'uptime': planned.scene.uptime + stamp - stamp[0],
        'usecase': np.array(plan.usecase),
        'clean_depth': clean,
        **truth,
    }
    np.savez(path, **content)


def smaller(lens: Intrinsics, scale: float) -> Intrinsics:
    """Return the lens of a camera whose image is smaller by a factor, at least 8 pixels wide."""
    scale = min(max(scale, _LEAST_PIXELS / min(lens.width, lens.height)), 1.0)
    matrix = lens.matrix.copy()
    matrix[:2] *= scale
    matrix[:2, 2] += (scale - 1) / 2
    size = round(lens.width * scale), round(lens.height * scale)
    return Intrinsics.from_matrix(matrix, *size)


def _truth(panels: Sequence[Panel], visible: np.ndarray, kind: TruthKind) -> dict[str, np.ndarray]:
    # The keys that say how well the ground truth is known (docs/recordings.md); `visible` is from
    # `render`.
    if kind.pose:
        deviation = np.array(GROUND_TRUTH.pose)
        deviation[3:] = np.radians(deviation[3:])
        truth = {'pose_covariance': np.diag(deviation**2), 'clean_sigma': np.array(_SCAN_ERROR)}
        moving = [k for k, one in enumerate(panels, 1) if any(one.velocity)]
        if moving:  # A scan does not contain them.
            truth['known'] = ~np.isin(visible, moving)
        return truth
    if kind.plane is None:
        return {}
    count = len(panels)
    large = [k for k in range(1, count + 1) if (visible == k).mean() >= _LEAST_PLANE]
    plane = np.where(np.isin(visible, large), visible, 0)
    offset, tilt = kind.plane
    deviation = np.tile([offset, tilt, tilt], count)
    return {'plane': plane, 'plane_covariance': np.diag(deviation**2), 'known': plane > 0}
