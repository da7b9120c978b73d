"""From a capture to a profile, and noise from bags that the vendor's driver writes."""

from dataclasses import replace
from pathlib import Path
import re

from flexx2_sim_ros.camera import flexx2, Intrinsics
from flexx2_sim_ros.characterize import characterize, to_profile
from flexx2_sim_ros.characterize.capture import capture, conditions
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.physics.geometry import pixel_rays
from flexx2_sim_ros.profiles.files import ProfileFile, save_profile
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


RANGES = ((0.1, 0.5), (0.02, 0.15), (0.25, 0.3), (1.0, 7.0), (9.0, 12.0), (0.001, 1000.0))


@pytest.mark.parametrize('limits', RANGES)
def test_a_campaign_without_distances_is_inside_any_range(
    limits, tmp_path, camera, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    mode = one_mode(camera, limits)
    save_profile('own.yaml', ProfileFile(mode))
    own = ['--profile', 'own.yaml', '--angles', '0', '--frames', '1']
    assert main(['characterize', 'plan', *own]) == 0
    planned = re.findall(r'- \[ \] `own_(\S+)m_0deg`', capsys.readouterr().out)
    assert all(limits[0] <= float(distance) <= limits[1] for distance in planned)
    assert main(['characterize', 'capture', 'campaign', *own, '--jobs', '1']) == 0
    assert len(list(Path('campaign').iterdir())) == len(planned)


def one_mode(camera, limits):
    """Return a camera with one mode of a range; sigma_z is 1 % of depth."""
    noise = replace(camera.modes[0].noise, a=0.0, b=0.01, c=0.0, d=0.0)
    near, far = limits
    mode = replace(
        camera.modes[0], name='own', noise_of='own', noise=noise, range_min=near, range_max=far
    )
    return replace(camera, modes=(mode,))


@pytest.mark.parametrize(
    ('limits', 'named'),
    [
        ((0.001, 0.009), 'range_m of own: must hold a whole centimetre'),
        ((0.01, 0.08), '--distances: must be 0.1 to 10 m, where the simulated board can be'),
        ((12.0, 100.0), '--distances: must be 0.1 to 10 m, where the simulated board can be'),
    ],
)
def test_a_range_in_which_no_board_can_be_is_named(limits, named, tmp_path, camera, capsys):
    profile = tmp_path / 'own.yaml'
    save_profile(profile, ProfileFile(one_mode(camera, limits)))
    arguments = ['capture', str(tmp_path / 'campaign'), '--profile', str(profile)]
    assert main(['characterize', *arguments]) == 2
    assert named in capsys.readouterr().err


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
        (['plan', '--distances', 'nan'], '--distances'),
        (['plan', '--angles', '85'], '--angles'),
        (['plan', '--angles', '-5'], '--angles'),
        (['plan', '--frames', '0'], '--frames'),
        (['capture', 'x', '--frames', '0'], '--frames'),
        (['capture', 'x', '--jobs', '0'], '--jobs'),
        (['capture', '/dev/null/x'], 'cannot be written'),
        (['fit', 'no such folder'], 'must be a folder'),
        (['fit', '.', '--box', '5', '5', '1', '1'], 'must have recordings'),
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
