"""What may come into the camera node, and what it makes of it."""

from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.camera.frame import gray_image
from flexx2_sim_ros.physics.geometry import pixel_rays
import numpy as np
import pytest
from streams import (
    array_of,
    boards,
    CLOUD,
    DEPTH,
    FLEXX2,
    GRAY,
    image_message,
    INFO,
    info_message,
    input_stamps,
    library,
    nanoseconds,
    NOISE,
    plane,
    same,
    SECOND,
    START,
    stream,
    WHITE,
)

pytestmark = pytest.mark.usefixtures('ros')


def undistorted(camera):
    """Return the rays of a plumb_bob camera's pixels, by the textbook's iteration."""
    v, u = np.mgrid[: camera.height, : camera.width]
    x = x0 = (u - camera.cx) / camera.fx
    y = y0 = (v - camera.cy) / camera.fy
    k1, k2, p1, p2, k3 = camera.distortion
    for _ in range(20 if any(camera.distortion) else 0):
        r2 = x * x + y * y
        scale = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        x, y = (
            (x0 - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / scale,
            (y0 - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / scale,
        )
    return np.stack([x, y])


BENT = (-0.12, 0.03, 0.001, -0.0015, 0.002)
WIDE = Intrinsics(640, 480, 381.0, 384.0, 319.5, 239.5)
OWN = {'fx': 200.0, 'fy': 220.0, 'cx': 113.0, 'cy': 84.0, 'distortion': list(BENT)}


def expected(seen):
    """Return the depth that the camera measures of the plane."""
    return library(seen, plane(undistorted(seen.camera.settings.intrinsics)), START).depth


@pytest.mark.parametrize(
    ('source', 'kind', 'own'),
    [
        (WIDE, 'planar', {}),
        (Intrinsics(300, 260, 211.0, 214.0, 140.25, 131.5), 'radial', {}),
        (Intrinsics(640, 480, 370.0, 360.0, 330.0, 230.0, BENT), 'radial', {}),
        (WIDE, 'planar', OWN),
    ],
    ids=['wide', 'off-centre', 'distorted input', 'own intrinsics'],
)
def test_other_cameras_input_shows_the_same_plane(source, kind, own):
    with stream(DEPTH, INFO, source=source, input_depth=kind, **own) as seen:
        rays = undistorted(source)
        image = plane(rays) * (np.hypot(1, np.hypot(*rays)) if kind == 'radial' else 1)
        assert seen.show(image, START)
        np.testing.assert_allclose(seen.depths()[0], expected(seen), rtol=0, atol=3e-5)
        info = seen.messages(INFO)[0]
        assert list(info.d) == own.get('distortion', [0.0] * 5)
        assert (info.k[0], info.k[4]) == (own.get('fx', FLEXX2.fx), own.get('fy', FLEXX2.fy))
        assert not seen.logged('outside the view')


@pytest.mark.parametrize('lens', ['raw', 'rectified', 'auto'])
def test_rectified_input_has_the_projection_and_no_distortion(lens):
    source = Intrinsics(640, 480, 370.0, 360.0, 330.0, 230.0, BENT)
    straight = Intrinsics(640, 480, 350.0, 345.0, 319.5, 239.5)
    info = info_message(source, START)
    info.p = np.hstack([straight.matrix, np.zeros((3, 1))]).ravel().tolist()
    with stream(DEPTH, input_lens=lens) as seen:
        rectified = lens == 'rectified'
        image = plane(undistorted(straight if rectified else source))
        assert seen.send(image_message(image, START), info)
        np.testing.assert_allclose(seen.depths()[0], expected(seen), rtol=0, atol=3e-5)
        settings = seen.camera.settings
        assert settings.is_rectified('/sim/image_rect') == (lens != 'raw')
        assert settings.is_rectified('/sim/image_rect_raw') == rectified


def test_a_camera_info_that_is_not_of_the_image_is_converted_and_said():
    """Assert it of a unit matrix beside a projection; see `test_camera_info.py` for others."""
    source = Intrinsics(640, 480, 370.0, 360.0, 319.5, 239.5)
    image = plane(pixel_rays(source))
    with stream(DEPTH) as seen:
        for stamp in (START, START + SECOND):
            info = info_message(source, stamp)
            info.p = np.hstack([source.matrix, np.zeros((3, 1))]).ravel().tolist()
            info.k = np.eye(3).ravel().tolist()
            assert seen.send(image_message(image, stamp), info)
        np.testing.assert_allclose(seen.depths()[0], expected(seen), rtol=0, atol=3e-5)
        assert len(seen.logged('clean/camera_info: K: ')) == 1


def test_depth_is_never_blended_across_a_jump():
    """
    Assert every pixel of two boards, seen at another resolution, is on one of them.

    Noise at 2 m in this mode is 4 mm; beyond 0.05 m lies 12 sigma.
    """
    scene = np.full((480, 640), 2.0, np.float32)
    scene[200:300, 250:400] = 1.0
    with stream(DEPTH, source=WIDE, usecase='Mode_5_30fps') as seen:
        for stamp in input_stamps(2, hz=30):
            assert seen.show(scene, stamp)
        depths = np.stack(seen.depths())
        near, far = np.abs(depths - 1.0) < 0.05, np.abs(depths - 2.0) < 0.05
        assert (near | far).all()
        assert near.mean() == pytest.approx(
            (150 / 381 * FLEXX2.fx) * (100 / 384 * FLEXX2.fy) / (224 * 172), rel=0.05
        )


def test_rays_outside_the_input_are_invalid_and_warned_about_once():
    narrow = Intrinsics(160, 120, 210.0, 210.0, 79.5, 59.5)
    with stream(DEPTH, CLOUD, source=narrow) as seen:
        for stamp in input_stamps(4, hz=30):
            assert seen.show(np.full((120, 160), 1.5, np.float32), stamp)
        rays = pixel_rays(FLEXX2)
        inside = (np.abs(rays[0]) * 210 < 80) & (np.abs(rays[1]) * 210 < 60)
        for depth in seen.depths():
            assert same(np.isfinite(depth), inside)
        confidence = np.frombuffer(seen.messages(CLOUD)[0].data, '<f4')[3::4]
        assert (confidence.reshape(172, 224)[~inside] == 0).all()
        assert len(seen.logged('outside the view of clean/depth_image')) == 1


def test_reflectivity_in_another_unit_is_noticed():
    paint = np.full((172, 224), 0.4, np.float32)
    paint[:60] = 1.0
    with stream(GRAY, auto_exposure_0=False) as seen:
        for stamp in input_stamps(3, hz=30):
            assert seen.show(boards(), stamp, 100 * paint)
        seen.spin_until(lambda: seen.logged('taken for percent'), 'a warning')
        assert len(seen.logged('reflectivity: up to', 'multiplied by 0.01')) == 1
        frame = library(seen, boards(), stamp, reflectivity=paint)
        gray = gray_image(frame.amplitude, 1.0, WHITE).astype(int)
        np.testing.assert_allclose(array_of(seen.messages(GRAY)[-1]).astype(int), gray, atol=1)


def test_reflectivity_changes_the_gray_image_only():
    paint = np.full((172, 224), 0.25, np.float32)
    paint[:60], paint[60] = 1.0, np.nan
    with stream(DEPTH, NOISE, CLOUD, GRAY, auto_exposure_0=False) as seen:
        stamps = input_stamps(7, hz=30)
        assert seen.show(boards(), stamps[0])
        assert seen.show(boards(), stamps[1], paint)
        # This one comes too late, and lets the images to come wait for theirs.
        assert seen.show(boards(), stamps[2])
        seen.publish(reflectivity=image_message(paint, stamps[2]))
        assert seen.show(boards(), stamps[3], paint)
        images = seen.camera._statistics
        for stamp in stamps[4:6]:
            before = images.received, seen.published
            seen.publish(info=info_message(FLEXX2, stamp), image=image_message(boards(), stamp))
            seen.spin_until(lambda was=before: images.received > was[0])
            assert seen.published == before[1]
            if stamp == stamps[4]:
                seen.publish(reflectivity=image_message(paint, stamp))
                seen.spin_until(lambda was=before: seen.published > was[1])
        # It has stopped coming: an image goes on without it when the next one is there.
        seen.show(boards(), stamps[6])
        assert seen.published == 7
        seen.settle()
        for index, stamp in enumerate(stamps):
            with_paint = index in (1, 3, 4)
            frame = library(
                seen, boards(), stamp, reflectivity=np.nan_to_num(paint) if with_paint else None
            )
            plain = library(seen, boards(), stamp)
            assert same(seen.depths()[index], plain.depth)
            assert same(array_of(seen.messages(NOISE)[index]), plain.sigma)
            points = np.frombuffer(seen.messages(CLOUD)[index].data, '<f4')
            assert same(points[3::4].reshape(172, 224), plain.confidence)
            gray = array_of(seen.messages(GRAY)[index])
            assert same(gray, gray_image(frame.amplitude, 1.0, WHITE))
            assert same(gray, gray_image(plain.amplitude, 1.0, WHITE)) != with_paint


def test_a_late_or_single_camera_info_is_enough():
    with stream(DEPTH) as seen:
        seen.publish(image=image_message(boards(), START))
        seen.spin_until(lambda: seen.camera._statistics.received == 1)
        assert seen.published == 0
        seen.publish(info=info_message(FLEXX2, START))
        seen.spin_until(lambda: seen.published == 1)
    with stream(DEPTH) as seen:
        seen.publish(info=info_message(FLEXX2, 0))
        for stamp in input_stamps(10, hz=30):
            seen.publish(image=image_message(boards(), stamp))
            received = seen.camera._statistics.received
            seen.spin_until(lambda so_far=received: seen.camera._statistics.received > so_far)
        seen.spin_until(lambda: seen.published == 10)
        seen.settle()
        assert len(seen.depths()) == 10


def test_stamps_that_repeat_or_go_back():
    with stream(DEPTH) as seen:
        assert seen.show(boards(), START)
        for _ in range(3):
            assert not seen.show(boards(), START)
        assert seen.show(boards(), START + SECOND)
        assert seen.show(boards(), 5)
        assert not seen.show(boards(), 5 + SECOND // 100)
        assert seen.show(boards(), 5 + SECOND // 30)
        assert [nanoseconds(message) for message in seen.messages(DEPTH)] == [
            START,
            START + SECOND,
            5,
            5 + SECOND // 30,
        ]
        seen.spin_until(lambda: seen.logged('header.stamp went back to 5 ns'), 'the log')
        assert len(seen.logged('header.stamp went back to 5 ns')) == 1
        assert len(seen.logged('header.stamp', str(START), 'must be new for every image')) == 1
