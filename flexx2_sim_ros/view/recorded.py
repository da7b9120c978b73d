"""Recordings behind the page: any of their frames, and what a simulated camera makes of it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from flexx2_sim_ros.camera.camera import Camera
from flexx2_sim_ros.effects import aged, Effect
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording.reader import RecordingReader
from flexx2_sim_ros.recording.truth import read_truth
from flexx2_sim_ros.view.packing import ViewedFrame
import numpy as np

# What depth is compared with: keys of requests, and their names on the page.
CLEAN, SIMULATED, EFFECTS = 'clean', 'simulated', 'effects'
REFERENCES = {
    CLEAN: 'clean depth',
    SIMULATED: 'simulated depth',
    EFFECTS: 'simulated with the diagnosed effects',
}
_STACKS = ('depth', 'clean_depth', 'reflectivity')
# Frames before a chosen one that are simulated too, for effects that remember them.
_WARM_UP = 10

Images = Mapping[str, np.ndarray]


class FrameReader:
    """
    Any frame of a file that is read front to back.

    The latest frames stay in memory, so that going back does not read the file again: up to
    ``most_bytes``, but one frame is always kept.
    """

    def __init__(self, reader: RecordingReader, most_bytes: int) -> None:
        """Read nothing yet."""
        self._reader = reader
        self._keys = [key for key in _STACKS if key in reader.layouts]
        size = sum(
            reader.layouts[key].dtype.itemsize * int(np.prod(reader.layouts[key].shape))
            for key in self._keys
        )
        self._most = max(1, most_bytes // size)
        self._kept: dict[int, Images] = {}
        self._next = 0
        self._sources: dict[str, Iterator[np.ndarray]] = {}

    def at(self, number: int) -> Images:
        """
        Return the images of a frame, by key.

        Raises InputError when the file cannot be read up to there.
        """
        if number in self._kept:
            return self._kept[number]
        if number < self._next or not self._sources:
            self._next = 0
            self._sources = {key: self._reader.frames(key) for key in self._keys}
        try:
            while self._next <= number:
                images = {key: next(source) for key, source in self._sources.items()}
                self._keep(self._next, images)
                self._next += 1
        except BaseException:
            self._sources = {}  # A generator that has raised cannot go on.
            raise
        return self._kept[number]

    def _keep(self, number: int, images: Images) -> None:
        self._kept[number] = images
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]


class RecordedCamera:
    """
    A camera's recording, frame by frame, beside what it is compared with.

    ``profile`` is the camera that is simulated at the recording's ground truth; the Flexx2 if
    None. ``effects`` are those of a diagnosis; None without one. ``most_bytes`` is as for
    `FrameReader`. Raises InputError when the recording has no usable camera matrix, a key of its
    ground truth is wrong, or its first frame cannot be read.

    Attributes
    ----------
    name : str
        The camera in a bag, else the file.
    references : list of str
        Keys of `REFERENCES` that it can be compared with.
    notes : list of str
        What a person should know.

    """

    def __init__(
        self,
        reader: RecordingReader,
        profile: Profile | None,
        effects: Sequence[Effect] | None,
        most_bytes: int,
    ) -> None:
        """Find out what it can be compared with; frames are read later."""
        _, height, width = reader.shape
        try:
            pinhole = Intrinsics.from_matrix(reader.K, width, height)
            self._intrinsics = replace(pinhole, distortion=reader.distortion)
        except InputError as error:
            raise InputError(f'{reader.path}: {error}') from error
        self.name = reader.camera or reader.path.stem
        self.notes = list(reader.notes)
        self._reader = reader
        self._known = read_truth(reader.path, reader.arrays, reader.shape).known
        self._frames = FrameReader(reader, most_bytes)
        self._simulations: dict[str, _Simulation] = {}
        self.references: list[str] = []
        if 'clean_depth' in {*reader.layouts, *reader.arrays}:
            self.references.append(CLEAN)
            self._simulate(SIMULATED, (), profile)
            if effects is not None:
                self._simulate(EFFECTS, effects, profile)
        else:
            self.notes.append('no clean_depth: depth is compared with nothing')

    @property
    def count(self) -> int:
        """Return how many frames there are."""
        return len(self._reader.stamp)

    def describe(self) -> dict[str, Any]:
        """Return what the page has to know before it asks for frames."""
        # A clock that goes back would play frames in another order.
        seconds = np.maximum.accumulate(self._reader.stamp - self._reader.stamp[0])
        return {
            'name': self.name,
            'usecase': self._reader.usecase or '',
            'start': float(self._reader.stamp[0]),
            'stamps': np.round(seconds, 4).tolist(),
            'references': [[key, REFERENCES[key]] for key in self.references],
            'notes': self.notes,
        }

    def frame(self, number: int, reference: str) -> ViewedFrame:
        """
        Return a frame, counted from 0, and what it is compared with.

        ``reference`` is one of `references`; nothing is compared with any other. Raises InputError
        when the file cannot be read up to there.
        """
        images = self._frames.at(number)
        compared = without = None
        if reference == CLEAN and CLEAN in self.references:
            compared = self._clean(number)
        elif reference in self._simulations:
            compared = self._simulations[reference].at(number)
        if reference == EFFECTS and compared is not None:
            without = self._simulations[SIMULATED].at(number)
        return ViewedFrame(
            number,
            int(self._reader.stamp_ns[number]),
            images['depth'],
            compared,
            self._intrinsics,
            without,
        )

    def _clean(self, number: int) -> np.ndarray:
        clean = self._image('clean_depth', number)
        assert clean is not None
        if self._known is None:
            return clean
        known = self._known[number] if self._known.ndim == 3 else self._known
        return np.where(known, clean, np.float32(np.nan))

    def _image(self, key: str, number: int) -> np.ndarray | None:
        array = self._reader.arrays.get(key)
        if array is None:
            return self._frames.at(number).get(key)
        return array[number] if array.ndim == 3 else array

    def _simulate(self, key: str, effects: Sequence[Effect], profile: Profile | None) -> None:
        # The name gives noise that no recording of `flexx2 simulate` has.
        try:
            if self._reader.usecase is None:
                raise InputError('usecase: must be in the recording, got none')
            camera = Camera(
                self._reader.usecase,
                profile=profile,
                effects=aged(effects, _first(self._reader.arrays.get('uptime'))),
                name='flexx2 view',
            )
        except InputError as error:
            self.notes.append(f'no {REFERENCES[key]}: {error}')
            return
        self._simulations[key] = _Simulation(camera, self)
        self.references.append(key)

    def capture(self, camera: Camera, number: int) -> np.ndarray:
        """Return what a camera makes of the ground truth of a frame: (H, W) metres."""
        return camera.capture(
            self._clean(number),
            self._reader.K,
            int(self._reader.stamp_ns[number]),
            self._image('reflectivity', number),
        ).depth

    def skip(self, camera: Camera, number: int) -> None:
        """Let the time of a frame pass for a camera, as if it had captured it."""
        camera.skip(int(self._reader.stamp_ns[number]))


class _Simulation:
    # A simulated camera at any frame of a recording; some effects remember earlier frames.

    def __init__(self, camera: Camera, recorded: RecordedCamera) -> None:
        self._camera, self._recorded = camera, recorded
        self._last = -1
        self._depth = np.empty((0, 0), np.float32)

    def at(self, number: int) -> np.ndarray:
        if number == self._last:
            return self._depth
        start = number
        if number != self._last + 1:
            self._camera.reset()
            start = max(0, number - _WARM_UP) if self._camera.effects else number
            for one in range(start):  # A drift began at the first frame of the recording.
                self._recorded.skip(self._camera, one)
        self._last = -1
        for one in range(start, number + 1):
            self._depth = self._recorded.capture(self._camera, one)
        self._last = number
        return self._depth


def _first(uptime: np.ndarray | None) -> float | None:
    # The time since power-on at the recording's first frame, if it is known.
    if uptime is None or uptime.dtype.kind not in 'fiu' or not uptime.size:
        return None
    return float(uptime.flat[0])
