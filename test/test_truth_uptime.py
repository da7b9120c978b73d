"""The time since power-on that `flexx2 gap truth` takes from stamps."""

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.recording import open_recording
from flexx2_sim_ros.truth.files import uptimes
import numpy as np
import pytest

START = 1.7e9


def readers(folder, starts, **more):
    """Write recordings of three frames that begin at these stamps, and open them."""
    out = []
    for number, start in enumerate(starts):
        path = folder / f'{number}.npz'
        depth = np.ones((3, 8, 8), np.float32)
        K = np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]])  # noqa: N806
        np.savez(path, depth=depth, K=K, stamp=start + np.arange(3) * 0.5, **more)
        out.append(open_recording(path))
    return out


def test_stamps_say_how_long_after_one_another_recordings_were_made(tmp_path):
    opened = readers(tmp_path, [START + 60, START, START + 600])
    counted = uptimes(opened)
    assert [None if one is None else one.tolist() for one in counted] == [
        [60, 60.5, 61],
        [0, 0.5, 1],
        [600, 600.5, 601],
    ]
    told = uptimes(opened, 20.0)
    assert told[1][0] == 20


def test_what_a_recording_says_is_kept(tmp_path):
    opened = readers(tmp_path, [START, START + 60], uptime=np.array(300.0))
    first = uptimes(opened)[0]
    assert first.tolist() == [300, 300.5, 301]
    with pytest.raises(InputError, match='--uptime: must not be given'):
        uptimes(opened, 20.0)


@pytest.mark.parametrize('starts', [(0.0, 0.0), (START, START + 0.5), (START, START + 2e5)])
def test_stamps_of_several_clocks_or_sessions_say_nothing(tmp_path, starts):
    opened = readers(tmp_path, starts)
    assert uptimes(opened) == [None, None]
    with pytest.raises(InputError, match='--uptime: must be given for recordings of one session'):
        uptimes(opened, 20.0)
