"""The documented road with a camera that is no Flexx2 and whose modulation nobody knows."""

from bench.wall_campaigns import wall
from flexx2_sim_ros.camera import Camera
from flexx2_sim_ros.effects import registry
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import measure
from flexx2_sim_ros.profiles.files import load_profile
import numpy as np
from programs import call_flexx2
import pytest

SIZE = 48, 64
K = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 23.5], [0.0, 0.0, 1.0]])
PHASE = {
    'flying_pixels', 'multipath', 'stray_light', 'motion_artefact', 'wiggling',
    'phase_noise_wiggling', 'range_wrap', 'motion_dropout',
}  # fmt: skip


@pytest.fixture(scope='module')
def profile(tmp_path_factory):
    """Record boards with a camera of one's own, and fit its profile."""
    folder = tmp_path_factory.mktemp('boards')
    rng = np.random.default_rng(5)
    for i, (distance, angle) in enumerate(((0.6, 5), (0.9, 40), (1.3, 10), (1.8, 45), (2.2, 20))):
        clean = wall(distance, angle, K, SIZE)
        depth = clean + (0.001 + 0.001 * clean**2) * rng.standard_normal((30, *SIZE))
        np.savez(
            folder / f'board{i}.npz',
            depth=depth.astype(np.float32),
            K=K,
            stamp=np.arange(30) / 15,
            usecase='stereo',
        )
    call_flexx2(f'characterize fit {folder} --out {folder}/result --jobs 1')
    return folder / 'result' / 'profile.yaml'


def write_campaign(profile, folder, bias):
    """Simulate six walls with an offset of `bias` metres."""
    effects = folder / 'offset.yaml'
    effects.write_text(f'schema: 1\neffects: {{offset: {{bias: {bias}}}}}\n')
    for i, (distance, angle) in enumerate(
        ((0.7, 10), (0.9, 30), (1.1, 0), (1.4, 40), (1.6, 20), (1.8, 5))
    ):
        scene = folder / f'scene{i}'
        np.savez(scene, clean_depth=wall(distance, angle, K, SIZE), K=K)
        (folder / 'recordings').mkdir(exist_ok=True)
        words = f'{scene}.npz {folder}/recordings/wall{i}.npz --frames 10 --effects {effects}'
        call_flexx2(f'simulate {words} --profile {profile}')
    return folder / 'recordings'


def test_only_effects_on_phases_need_the_modulation(profile):
    camera = load_profile(profile)
    assert {name for name, kind in registry().items() if kind.needs_modulation} == PHASE
    clean, stamps = wall(1.0, 30, K, SIZE), np.arange(3) * 66_000_000
    dark = np.full(SIZE, 0.02)

    def shot(effects):
        seen = Camera('stereo', profile=camera, effects=effects)
        return seen.capture(clean, K, stamps, dark).depth

    plain = shot({})
    for name in registry():
        strong = {name: {'strength': 4.0}}
        if name in PHASE:
            with pytest.raises(InputError, match=rf'^effects: {name}: .*stereo\.modulation_hz'):
                shot(strong)
        elif name not in ('time_offset', 'lateral_noise', 'saturation'):  # Of other scenes.
            assert not np.array_equal(shot(strong), plain, equal_nan=True), name
    moved = shot({'offset': {'bias': 0.05}})
    assert np.nanmedian(moved - plain) == pytest.approx(0.05, abs=1e-6)


def test_given_effects_are_measured_on_such_a_camera(profile, tmp_path):
    """
    Assert it on walls, where a pose error of 2 cm looks like the offset.

    Noise changes the loss by about 10, and the gap is 280: a reduction of 0.9 is not by chance.
    """
    camera = load_profile(profile)
    campaign = write_campaign(profile, tmp_path, 0.02)
    assert measure(campaign, {'offset': {'bias': 0.02}}, profile=camera)['shrink'] > 0.9
    worse = measure(campaign, {'offset': {'bias': -0.02}}, profile=camera)
    assert worse['after'] > worse['before']
    with pytest.raises(InputError, match='wiggling: .*modulation frequencies'):
        measure(campaign, {'wiggling': {}}, profile=camera)


def test_without_a_gap_there_is_no_reduction(profile, tmp_path):
    """Assert it for an offset of 2.5 mm, which poses take over completely."""
    campaign = write_campaign(profile, tmp_path, 0.0025)
    found = measure(campaign, {'offset': {'bias': 0.0025}}, profile=load_profile(profile))
    assert found['shrink'] is None
    assert found['after'] < found['before']
