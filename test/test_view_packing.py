"""Frames as the page gets them: packed depth and colours."""

import json

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.view.packing import pack, pack_depth, UNIT, ViewedFrame
import numpy as np
import pytest

CAMERA = Intrinsics(4, 3, 3.0, 3.0, 1.5, 1.0)


def test_packing_keeps_what_is_valid():
    depth = np.array([[np.nan, 0.0, -1.0, np.inf], [1e-5, 1.5, 7.0, 40.0]], np.float32)
    packed = pack_depth(depth)
    assert packed.dtype == np.dtype('<u2')
    assert packed[0].tolist() == [0, 0, 0, 0]
    assert ViewedFrame(0, 0, depth, None, CAMERA).invalid_fraction == 0.5
    assert packed[1].tolist() == [1, round(1.5 / UNIT), round(7.0 / UNIT), 65535]
    valid = np.random.default_rng(0).uniform(0.05, 16, (172, 224)).astype(np.float32)
    np.testing.assert_allclose(pack_depth(valid) * UNIT, valid, atol=UNIT / 2 + 1e-5)


@pytest.mark.parametrize('with_clean', [True, False])
def test_a_frame_as_bytes(with_clean):
    simulated, clean = (np.full((3, 4), value, np.float32) for value in (1.25, 1.5))
    message = pack(
        'left', ViewedFrame(1, 1_500_000_000, simulated, clean if with_clean else None, CAMERA)
    )
    length = int.from_bytes(message[:4], 'little')
    assert length % 4 == 0
    head = json.loads(message[4 : 4 + length])
    assert head == {
        'camera': 'left',
        'stamp': 1.5,
        'unit': UNIT,
        'width': 4,
        'height': 3,
        'fx': 3.0,
        'fy': 3.0,
        'cx': 1.5,
        'cy': 1.0,
        'distortion': [0.0] * 5,
        'clean': with_clean,
        'without': False,
    }
    images = np.frombuffer(message, '<u2', offset=4 + length).reshape(-1, 3, 4)
    assert len(images) == 1 + with_clean
    np.testing.assert_allclose(images[0] * UNIT, 1.25)
    np.testing.assert_allclose(images[1:] * UNIT, 1.5)
