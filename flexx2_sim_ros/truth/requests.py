"""What `make_truth` is asked for: recordings, and what is known of what they show."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from flexx2_sim_ros.camera import Profile
from flexx2_sim_ros.recording import open_recording, RecordingReader
from flexx2_sim_ros.truth.observation import Footage, observe
from flexx2_sim_ros.truth.trajectory import PoseSource


@dataclass(frozen=True, kw_only=True)
class TruthRequest:
    """
    The options that all kinds of ground truth share.

    Attributes
    ----------
    recordings : tuple of pathlib.Path
        Bags, ``.npz`` files, or folders of them.
    out : pathlib.Path
        The campaign's folder.
    camera : str or None
        Which camera of bags that have several.
    profile : Profile or None
        The camera (None: the Flexx2).
    motion : str
        ``auto``, ``still`` or ``moving``.
    jobs : int
        Number of processes.
    scheduler : str or None
        Address of a Dask scheduler.
    uptime : float or None
        Seconds from power-on to the first frame of the earliest recording (None: unknown).
    command : str
        The command line, stored in ``truth.yaml``.

    """

    recordings: tuple[Path, ...]
    out: Path
    camera: str | None = None
    profile: Profile | None = None
    motion: str = 'auto'
    jobs: int = 1
    scheduler: str | None = None
    uptime: float | None = None
    command: str = ''

    def settings(self) -> Self:
        """Return the request without what may differ when an interrupted run goes on."""
        return replace(
            self, recordings=(), out=Path(), jobs=1, scheduler=None, uptime=None, command=''
        )

    def opened(self, path: Path) -> RecordingReader:
        """Open one of the recordings."""
        return open_recording(path, self.camera, self.profile)


@dataclass(frozen=True)
class Placing:
    """A recording at `path` whose surfaces are to be placed, and the settings of the run."""

    path: Path
    request: TruthRequest

    @property
    def files(self) -> list[Path]:
        """Return the files that are read for it."""
        return [self.path]

    def footage(self, moving: bool | None = None) -> Footage:
        """Open it to place its frames; None: detect whether it moves."""
        motion = self.request.motion if moving is None else ('moving' if moving else 'still')
        return observe(self.request.opened(self.path), self.request.profile, motion)


@dataclass(frozen=True, kw_only=True)
class RoomRequest(TruthRequest):
    """
    A request for ground truth from a room.

    Attributes
    ----------
    room : pathlib.Path
        A mesh or a MuJoCo model; see `load_room`.
    poses : tuple of tuple of float
        Rough poses: none, one for all recordings, or one for each.
    up : str
        Direction of the room that is up; see `search.UPS`.
    room_error : float or None
        Standard deviation of the room's surfaces along their normals, metres (None: estimated from
        the recordings, see `verdict.room_error`).
    told : PoseSource or None
        Source of rough poses: motion capture, odometry or TF.

    """

    room: Path
    poses: tuple[tuple[float, ...], ...] = ()
    up: str = '+z'
    room_error: float | None = None
    told: PoseSource | None = None


@dataclass(frozen=True, kw_only=True)
class BoardRequest(TruthRequest):
    """
    A request for ground truth from a printed board.

    The recordings have gray images; ``motion`` is that of the camera as seen from the board.

    Attributes
    ----------
    board : str or pathlib.Path
        The board, or its file; see `read_board`.
    lens_error : float
        Standard deviation of the focal length, as a fraction.
    wall : bool
        Whether the board is glued to a wall, whose rest is known as well.

    """

    board: str | Path
    lens_error: float = 0.003
    wall: bool = False


@dataclass(frozen=True, kw_only=True)
class PlaneRequest(TruthRequest):
    """
    A request for ground truth from planes; the camera stands still in each recording.

    Attributes
    ----------
    planes : pathlib.Path
        ``planes.yaml``; see `read_planes`.
    room_error : float
        Standard deviation of surfaces whose flatness is not in the file, metres.

    """

    planes: Path
    room_error: float = 0.0
