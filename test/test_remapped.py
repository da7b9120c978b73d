"""Clean images with the names of a simulator, which the camera node takes by remaps."""

from contextlib import closing

from flexx2_sim_ros.nodes.camera_node import Flexx2Camera
from flexx2_sim_ros.nodes.viewer import Viewer
from flexx2_sim_ros.recording import load_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_writer import BagWriter
from flexx2_sim_ros.recording.opening import recording_cameras
import numpy as np
from programs import call_flexx2
import pytest
from recorders import finish, flexx2
from streams import CameraInfo, FLEXX2, Image, image_message, info_message, NodeUser

SPACE = '/remapped/left'
TOPICS = {
    'clean/depth_image': '/simulator/depth/image_raw',
    'clean/camera_info': '/simulator/depth/camera_info',
    'clean/reflectivity': '/simulator/albedo',
}
STEP = 100_000_000
CLEAN = np.full((172, 224), 1.5, 'f4')

pytestmark = pytest.mark.usefixtures('ros')


class Simulator(NodeUser):
    """Publishes a wall on topics of its own; a camera node takes them."""

    def __init__(self, topics):
        remaps = [word for name in topics for word in ('-r', f'{name}:={TOPICS[name]}')]
        super().__init__(
            f'{SPACE}/flexx2_camera',
            lambda: Flexx2Camera(namespace=SPACE, cli_args=['--ros-args', *remaps]),
        )
        self.camera = self._node
        self._send = {
            name: self.node.create_publisher(kind, TOPICS[name], 10)
            for name, kind in zip(TOPICS, (Image, CameraInfo, Image), strict=True)
            if name in topics
        }
        self._stamp = 0
        inputs = [one for one in self.camera.subscriptions if one.topic_name in TOPICS.values()]
        self.spin_until(
            lambda: (
                all(publisher.get_subscription_count() for publisher in self._send.values())
                and sum(one.get_publisher_count() for one in inputs) == len(topics)
            ),
            'inputs',
        )

    def show(self):
        """Publish the next images."""
        self._stamp += STEP
        received = self.camera._statistics.received
        self._send['clean/camera_info'].publish(info_message(FLEXX2, self._stamp))
        for name, value in (('clean/reflectivity', 0.5), ('clean/depth_image', 1.5)):
            if name in self._send:
                image = np.full_like(CLEAN, value)
                self._send[name].publish(image_message(image, self._stamp))
        self.spin_until(lambda: self.camera._statistics.received > received, 'the image')


@pytest.fixture
def simulator(request):
    with closing(Simulator(getattr(request, 'param', list(TOPICS)))) as made:
        yield made


@pytest.mark.parametrize(
    'simulator', [list(TOPICS), list(TOPICS)[:2]], ids=['all', 'no reflectivity'], indirect=True
)
def test_a_recording_has_the_ground_truth_and_no_second_camera(simulator, child_env, tmp_path):
    bag = tmp_path / 'bag'
    with flexx2(child_env, 'record', bag, '--seconds', 1) as process:
        while process.poll() is None:
            simulator.show()
        finish(process)
    assert recording_cameras(bag) == ['remapped/left']
    recording = load_recording(bag)
    shown = recording.clean_depth[np.isfinite(recording.clean_depth).all(axis=(1, 2))]
    assert len(shown)
    np.testing.assert_allclose(shown, 1.5, rtol=1e-5)
    # As other recorders do, with the topics' own names: it takes an option.
    own = f'{SPACE}/flexx2_camera'
    topics = [*TOPICS.values(), f'{own}/depth_image_0', f'{own}/camera_info']
    names = {f'{SPACE}/{name}': topic for name, topic in TOPICS.items()}
    with BagWriter(tmp_path / 'other') as writer:
        for topic, kind, when, data in Bag(bag).messages(None):
            topic = names.get(topic, topic)
            if topic in topics:
                writer.write(topic, kind, when, data)
    given = f'--usecase Mode_9_30fps --clean {TOPICS["clean/depth_image"]}'
    call_flexx2(f'convert {tmp_path}/other {tmp_path}/one.npz {given}')
    other = load_recording(tmp_path / 'one.npz')
    np.testing.assert_array_equal(other.clean_depth, recording.clean_depth)
    np.testing.assert_array_equal(other.depth, recording.depth)


def test_the_page_shows_clean_depth(simulator):
    viewer = Viewer([], '/remapped/cmd_vel')
    simulator.add(viewer)
    try:
        viewer.watch(True)

        def clean_is_shown():
            simulator.show()
            shot = viewer.shots.get('remapped/left')
            return shot is not None and shot.clean is not None

        simulator.spin_until(clean_is_shown, 'clean depth')
        assert list(viewer.shots) == ['remapped/left']
    finally:
        viewer.destroy_node()
