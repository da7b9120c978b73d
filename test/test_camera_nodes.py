"""Several cameras in one process: each is a node of its own, and none stops the others."""

from programs import node_words, PATIENCE, started
import pytest
from sensor_msgs.msg import CameraInfo, Image
from streams import boards, FLEXX2, image_message, info_message, listening

PARAMETERS = """
/robot/left/flexx2_camera:
  ros__parameters: {usecase: Mode_5_60fps, serial: one}
/robot/right/flexx2_camera:
  ros__parameters: {usecase: Mode_9_5fps, serial: two}
/robot/wrong/flexx2_camera:
  ros__parameters: {usecase: Mode_7}
"""


@pytest.fixture
def robot(child_env, tmp_path):
    """Return a process of two cameras and of three that cannot start."""
    (tmp_path / 'cameras.yaml').write_text(PARAMETERS)
    words = node_words('flexx2_camera', '-r', '__ns:=/robot', '--params-file', 'cameras.yaml')
    at = words.index('--ros-args')
    names = ['left', 'wrong', '/robot/left', 'no-name', 'right']
    with started(
        [*words[:at], *names, *words[at:], '-r', '/robot/right/clean/depth_image:=/seen'],
        cwd=tmp_path,
        env=child_env,
    ) as process:
        yield process


def test_cameras_share_a_process(robot):
    with listening() as user:
        names = '/robot/left', '/robot/right'
        heard = {name: user.listen(f'{name}/flexx2_camera/depth_image_0', Image) for name in names}
        user.spin_until(
            lambda: (
                {space for _, space in user.node.get_node_names_and_namespaces()} == {'/', *names}
            ),
            'the two cameras and nothing left of the others',
        )
        for name, wanted in zip(
            names, (['Mode_5_60fps', 'one'], ['Mode_9_5fps', 'two']), strict=True
        ):
            node = f'{name}/flexx2_camera'
            assert user.parameters_of(node, 'usecase', 'serial') == wanted
        inputs = {
            name: (
                user.node.create_publisher(CameraInfo, f'{name}/clean/camera_info', 10),
                user.node.create_publisher(Image, topic, 10),
            )
            for name, topic in zip(names, ('/robot/left/clean/depth_image', '/seen'), strict=True)
        }
        user.spin_until(
            lambda: all(one.get_subscription_count() for both in inputs.values() for one in both),
            'inputs',
        )
        stamp = 0

        def feed():
            # The left camera gets an image that it cannot use before each good one.
            nonlocal stamp
            for good in (False, True):
                stamp += 10**9 // 60
                for name, (info, image) in inputs.items():
                    info.publish(info_message(FLEXX2, stamp))
                    message = image_message(boards(), stamp)
                    if not good and name == names[0]:
                        message.encoding = 'rgb8'
                    image.publish(message)
            return all(len(images) > 2 for images in heard.values())

        user.spin_until(feed, 'images of both')
        user.spin_until(
            lambda: any('depth_image: encoding' in entry.msg for entry in user.log),
            'the rejection',
        )
        by = {entry.name for entry in user.log if 'depth_image: encoding' in entry.msg}
        assert by == {'robot.left.flexx2_camera'}
    robot.terminate()
    said = robot.communicate(timeout=PATIENCE)[1]
    assert robot.returncode == 1
    errors = [line for line in said.splitlines() if line.startswith('error: ')]
    assert [line.split(': ')[1] for line in errors] == ['wrong', '/robot/left', 'no-name']
    assert 'error: wrong: usecase: must be one of Mode_5_15fps' in said
    assert 'error: /robot/left: namespace: must be given once' in said
    assert 'Traceback' not in said
