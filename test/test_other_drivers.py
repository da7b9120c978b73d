"""Bags of other cameras' drivers, as these write them: topics, encodings, frames and lenses."""

from pathlib import Path
from typing import Any

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import load_recording
from made_bags import DISTORTION, Entry, EPOCH, IMAGE, image, info, MATRIX, SECOND, write
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_typestore, Stores

ROS1 = get_typestore(Stores.ROS1_NOETIC)
INFO = 'sensor_msgs/msg/CameraInfo'
SIZE = 12, 16
RATIONAL = np.array([2.09, 1.36, 1e-4, -2e-5, 0.07, 2.42, 2.05, 0.37])
COUNT = 3


def depths() -> np.ndarray:
    """Return (COUNT, H, W) float32 metres with zeros for invalid, whole millimetres."""
    metres = np.random.default_rng(0).integers(300, 4000, (COUNT, *SIZE)) / 1000
    metres[:, 0, :3] = 0
    return metres.astype(np.float32)


def millimetres(metres: np.ndarray) -> np.ndarray:
    return np.rint(1000 * metres).astype(np.uint16)


def ros1_bag(path: Path, entries: list[Entry]) -> Path:
    """Write the same messages as ROS 1 does."""
    with Writer(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, received, message in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            head = message.header
            fields = {name: getattr(message, name) for name in message.__dataclass_fields__} | {
                'header': ROS1.types['std_msgs/msg/Header'](
                    7,
                    ROS1.types['builtin_interfaces/msg/Time'](head.stamp.sec, head.stamp.nanosec),
                    head.frame_id,
                )
            }
            if kind == INFO:
                region = ROS1.types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False)
                fields |= {'roi': region}
                fields |= {name.upper(): fields.pop(name) for name in 'dkrp'}
            data = ROS1.serialize_ros1(ROS1.types[kind](**fields), kind)
            writer.write(connections[topic], received, data)
    return path


def with_frame(entry: Entry, frame_id: str, **changes: Any) -> Entry:
    """Change a message's frame and other fields."""
    entry[3].header.frame_id = frame_id
    for name, value in changes.items():
        setattr(entry[3], name, value)
    return entry


def stamps() -> list[int]:
    return [EPOCH + index * SECOND // 30 for index in range(COUNT)]


def pico_flexx() -> list[Entry]:
    """Return what pico_flexx_driver publishes: metres, 0 for invalid, raw and shown gray."""
    entries = []
    for stamp, depth in zip(stamps(), depths(), strict=True):
        raw = millimetres(depth)
        for name, pixels, encoding in (
            ('image_mono16', raw, 'mono16'),
            ('image_mono8', (raw // 16).astype(np.uint8), 'mono8'),
            ('image_depth', depth, '32FC1'),
            ('image_noise', depth / 1000, '32FC1'),
        ):
            entries.append(image(f'/pico_flexx/{name}', stamp, pixels, encoding))
        entries.append(info('/pico_flexx/camera_info', stamp, SIZE))
    return [with_frame(entry, 'pico_flexx_optical_frame') for entry in entries]


def realsense() -> list[Entry]:
    """Return what realsense-ros publishes: millimetres, the left infrared image in its frame."""
    entries = []
    for stamp, depth in zip(stamps(), depths(), strict=True):
        raw = millimetres(depth)
        for name, pixels, encoding in (
            ('depth', raw, '16UC1'),
            ('infra1', (raw // 16).astype(np.uint8), 'mono8'),
            ('infra2', (raw // 32).astype(np.uint8), 'mono8'),
        ):
            frame = f'camera_{name}_optical_frame'
            space = f'/camera/camera/{name}'
            entries += [
                with_frame(image(f'{space}/image_rect_raw', stamp, pixels, encoding), frame),
                with_frame(
                    info(f'{space}/camera_info', stamp, SIZE, distortion=np.zeros(5)), frame
                ),
            ]
    return entries


def azure_kinect() -> list[Entry]:
    """Return what the driver of Azure Kinect publishes: millimetres, a rational lens."""
    entries = []
    for stamp, depth in zip(stamps(), depths(), strict=True):
        raw = millimetres(depth)
        for name, encoding in (('depth', '16UC1'), ('ir', 'mono16')):
            lens = {'distortion_model': 'rational_polynomial', 'd': RATIONAL}
            entries += [
                image(f'/{name}/image_raw', stamp, raw, encoding),
                with_frame(info(f'/{name}/camera_info', stamp, SIZE), '', **lens),
            ]
    return [with_frame(entry, 'depth_camera_link') for entry in entries]


@pytest.mark.parametrize('ros', [1, 2])
@pytest.mark.parametrize(
    ('driver', 'distortion', 'bits'),
    [(pico_flexx, DISTORTION, 16), (realsense, None, 8), (azure_kinect, RATIONAL, 16)],
)
def test_a_drivers_bag_becomes_a_recording(
    driver: Any, distortion: np.ndarray | None, bits: int, ros: int, tmp_path: Path
) -> None:
    name, writer = ('a.bag', ros1_bag) if ros == 1 else ('a', write)
    bag = writer(tmp_path / name, driver())
    out = tmp_path / 'out.npz'
    assert main(['convert', str(bag), str(out), '--usecase', 'my_mode']) == 0
    found = load_recording(out)
    expected = np.where(depths() > 0, depths(), np.nan)
    np.testing.assert_allclose(found.depth, expected, rtol=1e-6)
    np.testing.assert_array_equal(found.K, MATRIX)
    assert found.stamp_ns.tolist() == stamps()
    assert found.usecase == 'my_mode'
    raw = millimetres(depths())
    assert found.amplitude is not None
    np.testing.assert_array_equal(found.amplitude, raw if bits == 16 else raw // 16)
    assert found.amplitude.dtype.itemsize * 8 == bits
    if distortion is None:
        assert 'distortion' not in found.extra
    else:
        np.testing.assert_array_equal(found.extra['distortion'], distortion)
    # And back: the lens is in the camera info under its own name.
    assert main(['convert', str(out), str(tmp_path / 'back')]) == 0
    again = load_recording(tmp_path / 'back')
    np.testing.assert_array_equal(again.depth, found.depth)
    assert main(['convert', str(tmp_path / 'back'), str(tmp_path / 'second.npz')]) == 0


def test_a_fisheye_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entries = [
        with_frame(entry, 'f', distortion_model='equidistant', d=np.full(4, 0.1))
        if entry[1] == INFO
        else with_frame(entry, 'f')
        for entry in azure_kinect()
    ]
    bag = write(tmp_path / 'a', entries)
    assert main(['convert', str(bag), str(tmp_path / 'out.npz')]) == 2
    said = ' '.join(capsys.readouterr().err.split())
    assert 'distortion_model: must be plumb_bob or rational_polynomial' in said
    assert 'equidistant' in said
    assert not (tmp_path / 'out.npz').exists()


def test_broken_bags_of_ros_1(tmp_path: Path) -> None:
    whole = ros1_bag(tmp_path / 'a.bag', pico_flexx()).read_bytes()
    for name, content in (
        ('empty', b''),
        ('text', b'text' * 500),
        ('cut off', whole[: len(whole) // 2]),
        ('head', whole[:4000]),
    ):
        path = tmp_path / f'{name}.bag'
        path.write_bytes(content)
        with pytest.raises(InputError, match='closed and indexed ROS 1 bag'):
            load_recording(path)
    # Images of a size that they do not have.
    lying = [
        with_frame(entry, 'f', width=400) if entry[1] == IMAGE else entry for entry in pico_flexx()
    ]
    with pytest.raises(InputError, match='step: must be at least'):
        load_recording(ros1_bag(tmp_path / 'lying.bag', lying), '/pico_flexx/image_depth')


def test_ros_1_bags_are_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write(tmp_path / 'a', azure_kinect())
    assert main(['convert', str(bag), str(tmp_path / 'out.bag')]) == 2
    assert 'ROS 1' in capsys.readouterr().err
    assert not (tmp_path / 'out.bag').exists()
