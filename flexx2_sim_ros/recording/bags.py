"""Recordings in bags, made with our nodes, the real driver or `flexx2 convert`."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from flexx2_sim_ros.errors import InputError, unquoted
from flexx2_sim_ros.messages.camera_info import is_rectified
from flexx2_sim_ros.messages.decoding import decode_image, image_pixels
from flexx2_sim_ros.npz_arrays import decode_npy
from flexx2_sim_ros.profiles.modes import Profile
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording.bag_cameras import DEPTH_ENCODINGS, EVENTS, INPUTS
from flexx2_sim_ros.recording.bag_choice import choose_camera, survey_bag
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_lens import BagLens, looked_up, view_of
from flexx2_sim_ros.recording.calibration import Calibration
from flexx2_sim_ros.recording.matching import ABSENT, match, Topic
from flexx2_sim_ros.recording.reader import Content, Layout, ONE_EACH, RecordingReader, TIMES
from flexx2_sim_ros.recording.stamps import stamps_of
import numpy as np

_GRAYS = ('mono8', '8UC1', 'mono16', '16UC1', '32FC1')
_FLOATS = {7: 'f4', 8: 'f8'}  # sensor_msgs/PointField

Decoder = Callable[[bytes], np.ndarray]


@dataclass(frozen=True)
class _Stack:
    """The source of a stack's images: a topic, and the number of its message for each frame."""

    topic: str
    decoder: Decoder
    numbers: np.ndarray


class BagRecording(RecordingReader):
    """
    A camera's recording in a rosbag2 bag: a folder, or a ``.mcap`` or ``.db3`` file.

    Frames are the messages of the depth image, or of the cloud if there is no image. Other
    images belong to the frame with their stamp. Zero, negative and infinite depths become NaN
    (invalid). A bag from `flexx2 convert` returns the original recording exactly. Arguments are as
    for `open_recording`. Raises InputError when there is no such bag or camera, or no lens.
    """

    def __init__(
        self,
        path: Path,
        camera: str | None = None,
        profile: Profile | None = None,
        clean: str | None = None,
        infrared: str | None = None,
        lens: Calibration | None = None,
        rectified: bool | None = None,
    ) -> None:
        """Read the bag once, keeping stamps but no images."""
        self._bag = Bag(path)
        self._where = choose_camera(self._bag, camera, infrared, clean, lens is not None)
        self._infrared = infrared
        self._given = lens, rectified
        self._found: dict[str, Topic] = {}
        self._carried: dict[str, np.ndarray | None] = {}
        self._stacks: dict[str, _Stack] = {}
        self._usecases: list[tuple[int, str, str, bool]] = []
        self._infos: list[tuple[int, Any]] = []
        self._inputs: dict[str, dict[str, str]] = {name: {} for name in INPUTS}  # by node
        self._index()
        super().__init__(path, self._where.name, self._content(path), profile)

    def _index(self) -> None:
        where = self._where
        source = where.depth if where.depth in self._bag.topics else where.cloud
        self._source = source
        stamped = {
            source,
            where.clean,
            where.clean_info,
            where.reflectivity,
            where.gray,
            where.info,
        }
        last_info = b''
        # Another program's topic may have this name.
        ours = self._bag.topics.get(where.carried) == messages.BYTES
        carried = {where.carried} if ours else set()
        for topic, _, time, data in self._bag.messages({*stamped, *carried, EVENTS}):
            label = f'{self._bag.path}: {topic}'
            if topic in carried:
                key, content = messages.decode_bytes(data, label)
                self._carried[key] = (
                    decode_npy(content, f'{label}: {unquoted(key)}') if content else None
                )
            elif topic == EVENTS:
                self._take_event(time, data, label)
            else:
                found = self._found.setdefault(topic, Topic(data, [], []))
                found.stamps.append(messages.header_stamp(data, label))
                found.times.append(time)
                if topic == where.info and data[12:] != last_info:
                    last_info = data[12:]
                    self._infos.append((time, messages.decode(messages.CAMERA_INFO, data, label)))

    def _take_event(self, time: int, data: bytes, label: str) -> None:
        try:
            node, texts = messages.decode_text_parameters(data, label)
        except InputError as error:  # Frames are useful without it.
            if str(error) not in self._bag.notes:
                self._bag.notes.append(str(error))
            return
        if self._where.node in ('', node):
            if 'usecase' in texts:
                self._usecases.append((time, node, *texts['usecase']))
            for name in texts.keys() & self._inputs.keys():
                self._inputs[name][node], _ = texts[name]

    def _content(self, path: Path) -> Content:
        where = self._where
        if self._source not in self._found:
            raise InputError(
                f'{path}: {self._source}: must have depth images, got no complete message'
            )
        if self._carried.get('depth') is not None:
            raise InputError(
                f'{path}: depth: must be the images of {self._source}, got an array on '
                f'{where.carried}'
            )
        for topics in survey_bag(self._bag, self._infrared).unclear:
            if where.depth not in topics:
                self._bag.notes.append(
                    f'{path}: {", ".join(topics)}: not read: they have the same camera info, so '
                    'it is not clear which one is the depth of a camera; --camera TOPIC reads one'
                )
        # A driver may send empty ones before it has read its calibration.
        self._infos = [one for one in self._infos if any(one[1].k)] or self._infos
        content = Content({}, {}, self._bag.notes, frames=len(self._found[self._source].stamps))
        first = self._infos[0][1] if self._infos else None
        self._lens_of = BagLens(str(self._bag.path), where, first, *self._given)
        depth = partial(
            self._cloud_depth if self._source == where.cloud else self._depth, self._source
        )
        self._add_stack(content, 'depth', self._source, depth)
        size = content.layouts['depth'].shape
        if self._source == where.depth:  # A cloud is read in the size of the lens.
            self._lens_of.check_size(size)
        own = not self._carried
        if own or self._given[0] is not None:
            self._camera = self._lens_of.camera(size, content.notes)
        self._add_clean_stacks(content)
        if own or 'amplitude' in self._carried:
            self._add_stack(
                content, 'amplitude', where.gray, partial(self._image, where.gray, _GRAYS)
            )
        if own:
            self._add_own_arrays(content)
        else:
            self._add_carried_arrays(content)
        if own or self._given[0] is not None:
            content.arrays['K'] = self._camera.matrix
            content.arrays.pop('distortion', None)
            if any(self._camera.distortion):
                content.arrays['distortion'] = np.array(self._camera.distortion)
        return content

    def _add_stack(self, content: Content, key: str, topic: str, decoder: Decoder) -> None:
        if topic not in self._found or self._carried.get(key) is not None:
            return
        image = decoder(self._found[topic].first)
        if key != 'depth' and image.shape != content.layouts['depth'].shape:
            content.notes.append(
                f'{self._bag.path}: {key}: left out: {image.shape[1]} x {image.shape[0]} pixels '
                'are another view than that of depth'
            )
            return
        numbers = match(self._found[self._source], self._found[topic])
        missing = int((numbers == ABSENT).sum())
        if missing:
            if missing == len(numbers):
                content.notes.append(
                    f'{self._bag.path}: {key}: left out: no image of {topic} has '
                    'the stamp of a depth image'
                )
                return
            content.notes.append(
                f'{self._bag.path}: {key}: {missing} of {len(numbers)} frames '
                f'have none of their stamp in {topic}'
            )
        content.layouts[key] = Layout(image.dtype, (image.shape[0], image.shape[1]))
        self._stacks[key] = _Stack(topic, decoder, numbers)

    def _add_clean_stacks(self, content: Content) -> None:
        where = self._where
        clean: Decoder = self._clean
        reflectivity: Decoder = partial(self._image, where.reflectivity, ('32FC1',))
        own, view = not self._carried, None
        if own and where.clean_info in self._found:
            label = f'{self._bag.path}: {where.clean_info}'
            data = self._found[where.clean_info].first
            source = messages.decode(messages.CAMERA_INFO, data, label)
            radial = set(self._inputs['input_depth'].values()) == {'radial'}
            lens = set(self._inputs['input_lens'].values()) - {'auto'}
            rectified = lens == {'rectified'} if lens else is_rectified(where.clean)
            view = view_of(self._camera, source, radial, rectified)
        if view is not None:
            clean = looked_up(clean, view, depth=True)
            reflectivity = looked_up(reflectivity, view, depth=False)
        if own or 'clean_depth' in self._carried:
            self._add_stack(content, 'clean_depth', where.clean, clean)
        if own or 'reflectivity' in self._carried:
            self._add_stack(content, 'reflectivity', where.reflectivity, reflectivity)
        if view is not None and 'clean_depth' in content.layouts:
            what = 'distances along the ray' if view.radial else 'another lens or size'
            content.notes.append(
                f'{self._bag.path}: clean_depth: looked up at the pixels of {self._source}: '
                f'{where.clean} has {what}'
            )

    def _add_own_arrays(self, content: Content) -> None:
        stamps = np.array(self._found[self._source].stamps, np.int64)
        content.arrays['stamp'] = stamps / 1e9
        if (np.rint(content.arrays['stamp'] * 1e9).astype(np.int64) != stamps).any():
            content.arrays['stamp_ns'] = stamps
        content.arrays['received'] = np.array(self._found[self._source].times, np.int64) / 1e9
        for time, info in self._infos[1:] if self._given[0] is None else ():
            frame, first = self._frame(time), self._infos[0][1]
            if self._before_the_end(frame) and not np.array_equal(info.k, first.k):
                content.changes.append(
                    f'{self._bag.path}: K: changes at frame {frame} from {first.k.tolist()} to '
                    f'{info.k.tolist()}'
                )
                break
        self._add_usecases(content)
        content.notes.extend(content.changes)
        content.arrays['camera'] = np.array(self._where.name)
        content.arrays['frame_id'] = np.array(self._frame_id())

    def _frame_id(self) -> str:
        if self._infos:
            return str(self._infos[0][1].header.frame_id)
        topic = self._source
        first, label = self._found[topic].first, f'{self._bag.path}: {topic}'
        return str(messages.decode(self._bag.topics[topic], first, label).header.frame_id)

    def _add_usecases(self, content: Content) -> None:
        nodes = sorted({node for _, node, _, _ in self._usecases})
        if len(nodes) > 1:  # The camera's node is not known.
            content.notes.append(
                f'{self._bag.path}: usecase: left out: which of the nodes '
                f'{", ".join(nodes)} is the camera is not known'
            )
            return
        before = None
        for time, _, usecase, changed in self._usecases:
            frame = self._frame(time)
            if (changed or before is not None) and not self._before_the_end(frame):
                return
            if before is None or not frame:
                content.arrays['usecase'] = np.array(usecase)
            if frame and (changed if before is None else usecase != before):
                content.changes.append(
                    f'{self._bag.path}: usecase: {usecase} from about frame {frame} on'
                )
            before = usecase

    def _add_carried_arrays(self, content: Content) -> None:
        left = self._left()
        for key, array in self._carried.items():
            if array is not None:
                one_each = array.ndim == (1 if key in TIMES else 3) and key in ONE_EACH
                longer = one_each and len(array) > max(len(left), left[-1])
                content.arrays[key] = array[left] if longer else array

    def _left(self) -> list[int]:
        # The numbers of the frames in the recording that was converted. A bag that was cut off or
        # damaged has fewer: their stamps say which.
        found = self._found[self._source].stamps
        left: list[int] = []
        for number, stamp in enumerate(stamps_of(self._carried)):
            if len(left) < len(found) and stamp == found[len(left)]:
                left.append(number)
        return left if len(left) == len(found) else list(range(len(found)))

    def _frame(self, time: int) -> int:
        # The first frame that was received at a time or after it.
        return int(np.searchsorted(self._found[self._source].times, time))

    def _before_the_end(self, frame: int) -> bool:
        # Whether the recording has this frame: what changes after the last one does not matter.
        return frame < len(self._found[self._source].times)

    def frames(self, key: str) -> Iterator[np.ndarray]:
        """Iterate over the images of a stack; see `RecordingReader.frames`."""
        stack, layout = self._stacks[key], self.layouts[key]
        absent = np.full(layout.shape, np.nan if layout.dtype.kind == 'f' else 0, layout.dtype)
        wanted = set(stack.numbers.tolist())
        kept: dict[int, np.ndarray] = {ABSENT: absent}
        source = enumerate(self._bag.messages({stack.topic}))
        for index, number in enumerate(stack.numbers.tolist()):
            while number not in kept:
                at, message = next(source, (0, None))
                if message is None:
                    raise InputError(
                        f'{self.path}: {stack.topic}: must have {len(stack.numbers)} frames, '
                        f'got {index}: the bag has changed'
                    )
                if at in wanted:
                    kept[at] = stack.decoder(message.data)
            image = kept[number]
            if image.shape != layout.shape or image.dtype != layout.dtype:
                raise InputError(
                    f'{self.path}: {stack.topic}: frame {index}: must be {layout.shape} '
                    f'{layout.dtype} as before, got {image.shape} {image.dtype}'
                )
            yield image
            if number != ABSENT and number not in stack.numbers[index + 1 : index + 2]:
                del kept[number]

    def _image(self, topic: str, encodings: tuple[str, ...], data: bytes) -> np.ndarray:
        label = f'{self._bag.path}: {topic}'
        message = messages.decode_pixels(self._bag.topics[topic], data, label)
        pixels = image_pixels(message, label, encodings)
        return pixels.astype(pixels.dtype.newbyteorder('='), copy=False)

    def _depth(self, topic: str, data: bytes) -> np.ndarray:
        label = f'{self._bag.path}: {topic}'
        message = messages.decode_pixels(self._bag.topics[topic], data, label)
        if message.encoding == 'mono16':
            message.encoding = '16UC1'  # Another name of the same pixels.
        return self._valid(decode_image(message, label, DEPTH_ENCODINGS))

    def _clean(self, data: bytes) -> np.ndarray:
        # float64 stays float64: a recording may have it.
        label = f'{self._bag.path}: {self._where.clean}'
        message = messages.decode(messages.IMAGE, data, label)
        if message.encoding == '64FC1':
            return self._valid(self._image(self._where.clean, DEPTH_ENCODINGS, data))
        return self._valid(decode_image(message, label, DEPTH_ENCODINGS))

    def _cloud_depth(self, topic: str, data: bytes) -> np.ndarray:
        label = f'{self._bag.path}: {topic}'
        cloud = messages.decode(messages.POINT_CLOUD, data, label)
        field = next((field for field in cloud.fields if field.name == 'z'), None)
        if field is None or field.datatype not in _FLOATS:
            raise InputError(
                f'{label}: fields: must include a floating-point z, got '
                f'{[each.name for each in cloud.fields]}'
            )
        # The real driver exchanges width and height of the cloud, but not its points. The camera
        # info is right.
        count = cloud.width * cloud.height
        sizes = self._lens_of.sizes or [(0, 0)]
        height, width = next((one for one in sizes if one[0] * one[1] == count), sizes[0])
        if (
            count != height * width
            or not count
            or len(cloud.data) != height * width * cloud.point_step
        ):
            raise InputError(
                f'{label}: size: must be {width} x {height} as in camera_info, got '
                f'{cloud.width} x {cloud.height} points in {len(cloud.data)} bytes'
            )
        dtype = np.dtype(('>' if cloud.is_bigendian else '<') + _FLOATS[field.datatype])
        if field.offset + dtype.itemsize > cloud.point_step:
            raise InputError(
                f'{label}: fields: z must end within the point_step of {cloud.point_step} bytes, '
                f'got it at {field.offset}'
            )
        z: np.ndarray = np.ndarray(
            (height, width),
            dtype,
            cloud.data,
            field.offset,
            (width * cloud.point_step, cloud.point_step),
        )
        return self._valid(z.astype(np.float32))

    def _valid(self, depth: np.ndarray) -> np.ndarray:
        if self._carried:
            return depth
        with np.errstate(invalid='ignore'):
            return np.where(np.isfinite(depth) & (depth > 0), depth, depth.dtype.type(np.nan))
