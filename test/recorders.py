"""Cameras whose topics are recorded, and the commands `flexx2 record` and `flexx2 replay`."""

import itertools

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
import numpy as np
import programs
from programs import flexx2_words, PATIENCE, started
from rclpy.duration import Duration
import streams
from streams import CameraInfo, Image, image_message, info_message

SECOND = 1_000_000_000

STEP = SECOND // 60

CAMERAS = ('left', 'right')

_numbers = itertools.count()


def flexx2(child_env, *words):
    """Run the command as a process, which is over at the end of the block."""
    return started(flexx2_words(*words), env=child_env | {'COLUMNS': '200'})


def finish(process, number=None):
    """End a command, if it does not by itself, and return what it printed; all has to be well."""
    return programs.finish(process, number, 0 if number is None else 128 + number)


class Source:
    """What two cameras publish, frame by frame; every frame is another."""

    def __init__(self, listener, depth=1000):
        """Open the topics; names are this source's own."""
        space = f'/source_{next(_numbers)}'
        self.cameras = [f'{space}/{name}' for name in CAMERAS]
        self.listener = listener
        kinds = {
            'clean/camera_info': CameraInfo,
            'flexx2_camera/camera_info': CameraInfo,
            'clean/depth_image': Image,
            'clean/reflectivity': Image,
            'flexx2_camera/depth_image_0': Image,
        }
        self.publishers = {
            f'{camera}/{topic}': listener.node.create_publisher(kind, f'{camera}/{topic}', depth)
            for camera in self.cameras
            for topic, kind in kinds.items()
        }
        self.sent = {topic: [] for topic in self.publishers}

    @property
    def names(self):
        """Return the cameras' names."""
        return [camera.strip('/') for camera in self.cameras]

    def wait(self):
        """Wait until every topic has a subscriber."""
        self.listener.spin_until(
            lambda: all(
                publisher.get_subscription_count() for publisher in self.publishers.values()
            ),
            'subscribers',
        )

    def publish(self, count):
        """Publish the next frames."""
        first = len(next(iter(self.sent.values())))
        for index in range(first, first + count):
            rng = np.random.default_rng(index)
            for topic, publisher in self.publishers.items():
                stamp = SECOND + index * STEP
                if topic.endswith('info'):
                    message = info_message(streams.FLEXX2, stamp)
                else:
                    pixels = rng.uniform(0.1, 7.0, (172, 224)).astype('f4')
                    message = image_message(pixels, stamp)
                publisher.publish(message)
                self.sent[topic].append(message)

    def settle(self):
        """Wait until everything has reached its subscribers."""
        for topic, publisher in self.publishers.items():
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE)), topic

    def pixels(self, topic):
        """Return what was published, (T, H, W)."""
        return np.stack([streams.array_of(message) for message in self.sent[topic]])


def rows(text):
    """Return the report's cells by topic: messages, from, rate, MB, lost, gaps."""
    return {
        line.split()[0]: line.split()[1:] for line in text.splitlines() if line.startswith('/')
    }


def whole(bag, count):
    """Say whether a bag that is being written has so many frames, all else, and the mode."""
    try:
        recording = load_recording(bag)
    except InputError:
        return False
    # The first note is that there is no metadata yet, the second that the file has no end.
    return (
        len(recording.depth) == count
        and len(recording.notes) == 2
        and (recording.usecase is not None)
    )
