"""What goes into the simulated camera, or a driver's bags, comes out of the characterization."""

from dataclasses import replace
import re

from flexx2_sim_ros.camera import Camera, flexx2, Intrinsics, NoiseModel
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.characterize.capture import capture, conditions
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.files import load_profile, ProfileFile, save_profile
from made_bags import DISTORTION, DRIVER, driver_bag, MATRIX
import numpy as np
from programs import call_flexx2
import pytest


@pytest.fixture
def camera():
    """Return a camera of 80 x 60 pixels, for quick captures."""
    return replace(
        flexx2(), intrinsics=replace(flexx2().intrinsics, width=80, height=60, cx=39.5, cy=29.5)
    )


def test_from_a_capture_to_a_running_camera(tmp_path, camera, monkeypatch):
    """Assert the three commands of the documentation, one after the other."""
    monkeypatch.chdir(tmp_path)
    save_profile(tmp_path / 'small.yaml', ProfileFile(camera))
    grid = '--usecase Mode_5_30fps --distances 0.4 0.7 1.0 --angles 0 45 --frames 20'
    call_flexx2(f'characterize capture campaign {grid} --profile small.yaml --jobs 1')
    assert main(['characterize', 'fit', 'campaign', '--out', 'result', '--jobs', '1']) == 0
    np.savez('scene.npz', clean_depth=np.full((60, 80), 1.0), K=camera.intrinsics.matrix)
    call_flexx2('simulate scene.npz out.npz --profile result/profile.yaml --frames 100')
    with np.load('out.npz', allow_pickle=False) as recording:
        assert recording['usecase'] == 'Mode_5_30fps'
        sigma = recording['depth'][:, 20:40, 30:50].astype(float).std(axis=0, ddof=1).mean()
    # 100 x 400 samples know it to 0.35 %; the profile to 1 %.
    assert sigma == pytest.approx(
        float(flexx2().mode('Mode_5_30fps').noise.sigma_z(1.0, 0.0)), rel=0.06
    )


def test_an_interrupted_capture_resumes(tmp_path, camera):
    wanted = conditions(camera, ['Mode_5_30fps'], [0.5, 0.8], [0, 30])
    first = dict(capture(tmp_path, wanted, camera, frames=3))
    assert list(first.values()) == [True] * 4
    lost, cut, flipped, other = sorted(first)
    kept = {path: path.read_bytes() for path in first}
    lost.unlink()
    cut.write_bytes(cut.read_bytes()[:1000])
    data = bytearray(flipped.read_bytes())
    data[len(data) // 2] ^= 1  # in a frame
    flipped.write_bytes(data)
    with np.load(other) as arrays:
        np.savez(other, **{**arrays, 'depth': arrays['depth'] + np.float32(0.01)})
    (tmp_path / '.flexx2-0.part').mkdir()
    (tmp_path / '.flexx2-0.part' / lost.name).write_bytes(b'of a capture that was killed')
    said = []
    again = dict(capture(tmp_path, wanted, camera, frames=3, say=said.append))
    assert all(again.values())
    assert [sum(str(path) in text for text in said) for path in sorted(first)] == [0, 1, 1, 1]
    assert all('recorded again' in text for text in said)
    assert {path: path.read_bytes() for path in first} == kept
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in first}
    assert not any(dict(capture(tmp_path, wanted, camera, frames=3)).values())
    assert len(characterize(tmp_path).modes[0].cells) == 4


@pytest.mark.parametrize('lost', [('seed',), ('seed', 'K')])
def test_a_capture_overwrites_no_real_recording(lost, tmp_path, camera):
    wanted = conditions(camera, ['Mode_5_30fps'], [0.5], [0])
    path = next(capture(tmp_path, wanted, camera, frames=3))[0]
    with np.load(path) as arrays:
        np.savez(path, **{key: arrays[key] for key in arrays if key not in lost})
    before = path.read_bytes()
    with pytest.raises(InputError, match='not overwritten'):
        list(capture(tmp_path, wanted, camera, frames=3))
    assert path.read_bytes() == before


def test_a_lens_that_distorts_changes_no_result(tmp_path, camera):
    """
    Assert planes and edges are straightened: neither bends into the noise.

    An edge that leans over pixels adds 1/12 px^2 when it is looked up, another when it is found.
    False failures: 9,000 pixels of 60 frames know sigma to 0.1 %, each edge to 1.5 %.
    """
    bent = replace(
        camera,
        intrinsics=Intrinsics(112, 86, 105.3, 106.4, 55.5, 42.5, (-0.2, 0.0, 0.001, 0.0, 0.0)),
    )
    wanted = conditions(bent, ['Mode_5_30fps'], [0.5, 1.5], [0, 40])
    list(capture(tmp_path, wanted, bent, frames=60))
    result = characterize(tmp_path)
    true = flexx2().mode('Mode_5_30fps').noise.sigma_x
    edges = []
    for cell in result.modes[0].cells:
        m = cell.measurement
        assert m.angle_deg == pytest.approx(m.condition.angle_deg, abs=0.05)
        assert m.pixels.flatness < 0.0002
        assert abs(cell.axial.debiased) < 0.002
        edges += [edge.sigma for edge in m.edges]
    assert len(edges) >= 2
    for sigma in edges:
        assert true * 0.94 < sigma < np.sqrt(true**2 + 2 / 12) * 1.06


def one_mode(camera, limits):
    """Return a camera with one mode of a range; sigma_z is 1 % of depth."""
    noise = replace(camera.modes[0].noise, a=0.0, b=0.01, c=0.0, d=0.0)
    near, far = limits
    mode = replace(
        camera.modes[0], name='own', noise_of='own', noise=noise, range_min=near, range_max=far
    )
    return replace(camera, modes=(mode,))


@pytest.mark.parametrize(
    'limits', [(0.1, 0.5), (0.02, 0.15), (0.25, 0.3), (1.0, 7.0), (9.0, 12.0), (0.001, 1000.0)]
)
def test_a_campaign_without_distances_is_where_range_and_board_can_be(limits, camera):
    near, far = max(limits[0], 0.1), min(limits[1], 10.0)
    wanted = conditions(one_mode(camera, limits))
    assert all(near <= condition.distance <= far for condition in wanted)
    assert {condition.usecase for condition in wanted} == {'own'}


@pytest.mark.parametrize(
    ('limits', 'named'),
    [
        ((0.001, 0.009), 'range_m of own: must hold a whole centimetre'),
        ((0.01, 0.08), '--distances: must be 0.1 to 10 m, where the simulated board can be'),
        ((12.0, 100.0), '--distances: must be 0.1 to 10 m, where the simulated board can be'),
    ],
)
def test_a_range_in_which_no_board_can_be_is_named(limits, named, tmp_path, camera):
    own = one_mode(camera, limits)
    with pytest.raises(InputError, match=named):
        list(capture(tmp_path / 'campaign', conditions(own), own))


def test_the_plan_is_the_captures_campaign(capsys):
    assert main(['characterize', 'plan']) == 0
    printed = capsys.readouterr().out
    names = re.findall(r'- \[ \] `(\S+)`', printed)
    assert names == [c.name for c in conditions(flexx2())]
    assert len(names) == len(set(names)) == 3 * 8 * 5
    assert 'Mode_9_30fps_1.00m_15deg' in names
    # Recorded as said there, a real camera's bags are of the real driver's topics.
    for topic in ('depth_image_0', 'camera_info', 'gray_image_0'):
        assert f'{DRIVER}/{topic}' in printed
    assert f'ros2 param set {DRIVER} usecase' in printed
    grid = '--usecase mode_9_5fps --distances 1 2 --angles 0 --frames 10'
    call_flexx2(f'characterize plan {grid}')
    printed = capsys.readouterr().out
    assert re.findall(r'- \[ \] `(\S+)`', printed) == [
        'Mode_9_5fps_1.00m_0deg',
        'Mode_9_5fps_2.00m_0deg',
    ]
    assert '3 s or more give 10 frames' in printed
    convert = 'flexx2 convert RECORDING FOLDER/Mode_9_5fps_1.00m_0deg.npz --usecase Mode_9_5fps'
    assert convert in printed


@pytest.mark.parametrize(
    ('arguments', 'named'),
    [
        (['plan', '--usecase', 'Mode_7'], 'usecase'),
        (['plan', '--distances', '3'], '--distances: must be 0.1 to 2.4 m'),
        (['plan', '--angles', '85'], '--angles'),
        (['plan', '--angles', '-5'], '--angles'),
        (['plan', '--frames', '0'], '--frames'),
        (['capture', 'x', '--frames', '0'], '--frames'),
        (['capture', 'x', '--jobs', '0'], '--jobs'),
        (['fit', 'no such folder'], 'must be a folder'),
    ],
)
def test_bad_arguments_are_named(arguments, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(['characterize', *arguments]) == 2
    assert named in capsys.readouterr().err
    assert not list(tmp_path.glob('**/*.npz'))


def test_the_real_drivers_bags_give_its_noise(tmp_path):
    """
    Assert distance, incidence and sigma_z from the driver's topics, through its lens.

    False failures: 30,000 pixels of 12 frames know sigma to 0.12 %, the angle to 0.01 degrees.
    """
    camera = Intrinsics.from_matrix(MATRIX, 224, 172, DISTORTION)
    x, y = pixel_rays(camera)
    generator = np.random.default_rng(3)
    sigma = 0.004
    for distance, angle in ((0.8, 0), (1.0, 30), (1.4, 45)):
        clean = distance / (1 - np.tan(np.radians(angle)) * x)
        depth = clean + sigma * generator.standard_normal((12, *clean.shape))
        depth[generator.random(depth.shape) < 0.01] = 0.0  # no light came back
        driver_bag(tmp_path / f'Mode_5_45fps_{distance:.2f}m_{angle}deg', depth.astype(np.float32))
    result = characterize(tmp_path)
    assert not result.left_out
    profile = to_profile(result).profile
    assert (profile.model, profile.names) == ('Flexx2', ['Mode_5_45fps'])
    assert profile.intrinsics == camera
    for cell in result.modes[0].cells:
        m = cell.measurement
        assert m.distance == pytest.approx(m.condition.distance, abs=0.001)
        assert m.angle_deg == pytest.approx(m.condition.angle_deg, abs=0.1)
        assert cell.sigma == pytest.approx(sigma, rel=0.01)
        assert m.pixels.invalid == pytest.approx(0.01, abs=0.002)
        # Without the lens the plane would be bent by 3 mm and more.
        assert m.pixels.flatness < 0.0003
        assert m.rate_hz == pytest.approx(45.0, rel=1e-3)
        assert m.amplitude is not None


USECASE = 'Mode_9_30fps'
DISTANCES, ANGLES = (0.75, 1.5, 3.0, 4.5), (0.0, 30.0, 60.0)


def measured(folder, profile, frames):
    """Simulate a campaign and analyse it."""
    wanted = conditions(profile, [USECASE], DISTANCES, ANGLES)
    done = list(capture(folder, wanted, profile, frames=frames, seed=5))
    assert [new for _, new in done] == [True] * 12
    return characterize(folder)


def worst_ratio(found, true):
    """Return the largest relative deviation of sigma_z on the measured grid."""
    z, theta = np.meshgrid(np.linspace(0.75, 4.5, 20), np.radians(np.linspace(0, 60, 13)))
    return float(np.abs(found.sigma_z(z, theta) / true.sigma_z(z, theta) - 1).max())


def test_the_papers_coefficients_come_back(tmp_path):
    """
    Assert sigma_z within 2 %, n within 0.1, sigma_x within 3 %, mean KL at most 0.005 nats.

    0.0033 nats are what a perfect model has with 300 frames.

    False failures: every one of 12 recordings knows sigma_z to 0.3 % or better, so the curve is
    known to less; 2 % is beyond 6 standard errors, also where the curve is least sure (4.5 m and
    60 degrees: 0.3 %). n is known to 0.02. sigma_x is the largest but one of ten or more edges,
    each known to 1 %: some 1 % high, 3 % is beyond 6 standard errors of a percentile of edges.
    """
    true = flexx2().mode(USECASE).noise
    result = measured(tmp_path, flexx2(), 300)
    assert not result.left_out
    mode = result.mode(USECASE)
    assert len(mode.cells) == 12
    fit = mode.axial
    assert worst_ratio(fit.model(), true) < 0.02
    assert fit.coefficients['n'] == pytest.approx(2.7, abs=0.1)
    assert fit.interval_n[1] - fit.interval_n[0] < 0.4
    assert mode.sigma_x == pytest.approx(true.sigma_x, rel=0.03)
    assert len(mode.edges) >= 8
    raw = np.mean([cell.axial.raw for cell in mode.cells])
    floor = np.mean([cell.axial.floor for cell in mode.cells])
    assert floor == pytest.approx(1 / 300, rel=0.02)
    assert raw <= 0.005
    lateral = [cell.lateral for cell in mode.cells if cell.lateral is not None]
    assert abs(np.mean([kl.debiased for kl in lateral])) < 0.003


def test_another_cameras_coefficients_come_back(tmp_path):
    """
    Assert the same of other coefficients, drawn at random; and the profile runs as that camera.

    False failures: as above.
    """
    true = NoiseModel(0.00458, 0.0018, 0.00046, 0.00057, 1.1, 1.166)
    mode = replace(flexx2().mode(USECASE), noise=true)
    camera = replace(flexx2(), model='Other', modes=(mode,))
    result = measured(tmp_path, camera, 60)
    found = result.modes[0]
    assert worst_ratio(found.axial.model(), true) < 0.02
    low, high = found.axial.interval_n
    assert abs(found.axial.coefficients['n'] - true.n) < 0.11 or low <= true.n <= high
    assert found.sigma_x == pytest.approx(true.sigma_x, rel=0.03)

    save_profile(tmp_path / 'profile.yaml', to_profile(result, 'Other'))
    loaded = load_profile(tmp_path / 'profile.yaml')
    assert loaded.intrinsics == camera.intrinsics
    scene = np.full((60, 80), 2.0, np.float32)
    matrix = np.array([[210.6, 0, 39.5], [0, 212.9, 29.5], [0, 0, 1]])
    one, other = (
        Camera(mode.name, profile=profile).capture(scene, matrix, 0).sigma
        for profile in (camera, loaded)
    )
    np.testing.assert_allclose(one, other, rtol=0.02)
