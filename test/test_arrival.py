"""When images arrive: in recordings and bags, and what the diagnosis makes of it."""

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.effects import parse_effects, save_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.data.campaign import check
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.recording.bag_files import Bag
from flexx2_sim_ros.recording.bag_messages import header_stamp
from flexx2_sim_ros.recording.convert import convert
from made_bags import DRIVER, EPOCH, image, info, MATRIX, SECOND, write
import numpy as np
import pytest

MS = SECOND // 1000


def late(path, latency=0.0, delay=0.08):
    """Write a file of effects."""
    save_effects(path, parse_effects({'time_offset': {'latency': latency, 'delay': delay}}))
    return str(path)


def scene(path, **more):
    """Write a scene of 4 frames."""
    np.savez(path, clean_depth=np.full((4, 20, 30), 1.5), K=MATRIX, stamp=7 + np.arange(4), **more)
    return str(path)


def test_a_simulated_recording_and_its_bag_have_the_times_of_arrival(tmp_path):
    source, out = scene(tmp_path / 'in.npz', received=np.zeros(4)), tmp_path / 'out.npz'
    assert main(['simulate', source, str(out), '--effects', late(tmp_path / 'late.yaml')]) == 0
    convert(out, tmp_path / 'bag')
    for path in (out, tmp_path / 'bag'):
        reader = open_recording(path)
        assert reader.received_ns is not None
        assert (reader.received_ns - reader.stamp_ns).tolist() == [80 * MS] * 4
    messages = list(Bag(tmp_path / 'bag').messages({'/camera/flexx2_camera/depth_image_0'}))
    assert [time - header_stamp(data, '') for _, _, time, data in messages] == [80 * MS] * 4
    # Without a delay nothing is known of the arrival: it is not that of the scene's camera.
    assert main(['simulate', source, str(tmp_path / 'plain.npz')]) == 0
    assert open_recording(tmp_path / 'plain.npz').received_ns is None


def test_a_real_bag_says_when_its_images_were_received(tmp_path):
    depth, entries = np.full((8, 9), 1.5, np.float32), []
    for k in range(3):
        stamp = EPOCH + k * SECOND
        entries += [
            info(f'{DRIVER}/camera_info', stamp, depth.shape),
            image(f'{DRIVER}/depth_image_0', stamp, depth, received=stamp + (50 + k) * MS),
        ]
    write(tmp_path / 'bag', entries)
    convert(tmp_path / 'bag', tmp_path / 'out.npz')
    convert(tmp_path / 'out.npz', tmp_path / 'again')
    for name in ('bag', 'out.npz', 'again'):
        reader = open_recording(tmp_path / name)
        assert reader.received_ns is not None
        ages = (reader.received_ns - reader.stamp_ns) / MS
        assert ages == pytest.approx([50, 51, 52], abs=1e-3)


@pytest.mark.parametrize('difference', [-0.3, 1.7e9])
def test_times_of_another_clock_are_noted_and_not_used(difference, tmp_path):
    stamp, flat = np.arange(4.0), np.full((4, 20, 30), 1.5, np.float32)
    arrays = {'depth': flat, 'clean_depth': flat, 'K': MATRIX, 'stamp': stamp}
    path = tmp_path / 'in.npz'
    np.savez(path, usecase='Mode_9_5fps', received=stamp + difference, **arrays)
    found = check(path, None)
    assert found.arrival is None
    assert any(
        f'{found.path}: received: not used: its clock is not that of stamp' in one
        for one in found.notes
    )
    np.savez(path, usecase='Mode_9_5fps', received=stamp + 0.05, **arrays)
    found = check(path, None)
    assert found.arrival.median == pytest.approx(0.05)
    assert not found.notes


@pytest.mark.parametrize(
    'received', [np.zeros(3), np.full(4, np.nan), np.array(['a'] * 4), np.full(4, 1e12)]
)
def test_wrong_times_of_arrival_are_refused(received, tmp_path):
    path = tmp_path / 'in.npz'
    np.savez(path, depth=np.ones((4, 8, 9), np.float32), K=MATRIX, received=received)
    with pytest.raises(InputError, match='received: must be seconds'):
        convert(path, tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()
