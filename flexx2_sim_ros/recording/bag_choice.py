"""Choose a camera of a bag, or say why there is none."""

from collections.abc import Iterator
from dataclasses import replace

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.messages.compressed_depth import SUFFIX
from flexx2_sim_ros.recording import bag_messages as messages
from flexx2_sim_ros.recording.bag_cameras import (
    by_shape,
    CameraTopics,
    info_of,
    may_be_depth,
    Sample,
    Survey,
    survey,
)
from flexx2_sim_ros.recording.bag_files import Bag


def survey_bag(bag: Bag, infrared: str | None = None, *clean: str, lens: bool = False) -> Survey:
    """
    Return the cameras of a bag; the topics `infrared` and `clean` are not the depth of one.

    With `lens`, depth images need no camera info.
    """
    samples = {topic: one for topic, one in bag.samples.items() if topic not in (infrared, *clean)}
    topics = {topic: kind for topic, kind in bag.topics.items() if topic not in clean}
    return survey(topics, samples, lens)


def choose_camera(
    bag: Bag,
    camera: str | None,
    infrared: str | None = None,
    clean: str | None = None,
    lens: bool = False,
) -> CameraTopics:
    """
    Return a camera of a bag, by its name or the topic of its depth image; None for the only one.

    ``infrared`` is the topic of its infrared image, where the bag does not tell, ``clean`` that of
    its clean depth images, if it is not ``clean/depth_image``. If the ``lens`` is known, it needs
    no camera info. Raises InputError when there is none or several; the message has all names, and
    why topics are none.
    """
    for option, topic in (('infrared', infrared), ('clean', clean)):
        if topic is not None and bag.topics.get(topic) != messages.IMAGE:
            images = ', '.join(_images(bag)) or 'none'
            raise InputError(
                f'--{option}: must be the topic of an image of {bag.path} ({images}), '
                f'got {topic!r}'
            )
    if clean is None:
        chosen = _choose(bag, camera, survey_bag(bag, infrared, lens=lens))
    else:
        seen = info_of(clean, bag.samples) if clean in bag.samples else None
        info = seen or clean.rpartition('/')[0] + '/camera_info'
        chosen = _choose(bag, camera, survey_bag(bag, infrared, clean, info, lens=lens))
        chosen = replace(chosen, inputs={chosen.clean: clean, chosen.clean_info: info})
    return chosen if infrared is None else replace(chosen, gray=infrared)


def _choose(bag: Bag, camera: str | None, found: Survey) -> CameraTopics:
    cameras = found.cameras
    if camera is None and len(cameras) == 1 and not found.unclear:
        return next(iter(cameras.values()))
    if camera is not None and camera.strip('/') in cameras:
        return cameras[camera.strip('/')]
    if camera is not None and camera in _images(bag):
        beside = camera.rpartition('/')[0] + '/camera_info'
        info = info_of(camera, bag.samples) if camera in bag.samples else None
        return by_shape(
            camera, info or beside, bag.topics, {camera: Sample((0, 0), ''), **bag.samples}
        )
    several = camera is None and (cameras or found.unclear)
    got = 'several cameras' if several else repr(camera or 'no camera')
    why = '' if cameras or found.unclear else ''.join(f'; {reason}' for reason in _reasons(bag))
    raise InputError(
        f'{bag.path}: camera: must be one of its cameras ({", ".join(cameras) or "none"}) or the '
        f'topic of a depth image ({", ".join(_images(bag)) or "none"}) (flexx2 convert --camera '
        f'selects one), got {got}{why}'
    )


def _images(bag: Bag) -> list[str]:
    return [topic for topic, kind in bag.topics.items() if messages.has_depth_pixels(topic, kind)]


def _reasons(bag: Bag) -> Iterator[str]:
    # Why each image of a bag without cameras is not the depth of one.
    for topic, kind in bag.topics.items():
        if kind == messages.COMPRESSED and not topic.endswith(SUFFIX):
            yield f'{topic}: compressed with loss'
    for topic in _images(bag):
        found = bag.samples.get(topic)
        if found is None:
            label = f'{bag.path}: {topic}: '
            notes = (note.removeprefix(label) for note in bag.notes if note.startswith(label))
            yield f'{topic}: {next(notes, "not depth by its name")}'
        elif not may_be_depth(topic, bag.samples):
            yield f'{topic}: {found.encoding} under this name is no depth'
        else:
            size = f'{found.size[1]} x {found.size[0]}'
            yield (
                f'{topic}: no camera info has its size {size} and frame {found.frame_id!r} '
                '(flexx2 convert --calibration FILE says the lens)'
            )
