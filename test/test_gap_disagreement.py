"""Recordings that disagree are found, and said: some have an effect that the others lack."""

import shutil

from bench.gap_campaigns import write_campaign
from campaigns import among, change, leaving, run_diagnose
from flexx2_sim_ros.gap import diagnose
import pytest

SIZE = {'seed': 5, 'recordings': 6, 'frames': 8, 'scale': 0.35, 'moving': 2}
BOTH = {'wiggling': {'strength': 1.5}}


def test_a_setting_that_was_changed_midway_is_found(tmp_path, capsys):
    changed = {'temporal_filter': {'share': 0.7}}
    before, after, campaign = (tmp_path / name for name in ('before', 'after', 'campaign'))
    write_campaign(before, effects=BOTH, **SIZE)
    write_campaign(after, effects={**BOTH, **changed}, **SIZE)
    names = sorted(path.name for path in before.iterdir())
    campaign.mkdir()
    for i, name in enumerate(names):
        shutil.copy((before, after)[i % 2] / name, campaign / name)
    run_diagnose(campaign, tmp_path / 'out', *leaving('offset', 'pose_error', *BOTH, *changed))
    said = ' '.join(''.join(capsys.readouterr()).split())
    shows, lacks = ', '.join(names[1::2]), ', '.join(names[::2])
    assert f'{shows} show temporal filter; {lacks} do not.' in said
    assert 'Diagnose them apart.' in (tmp_path / 'out' / 'report.html').read_text()


@pytest.mark.parametrize(
    ('real', 'told', 'effects', 'found'),
    [
        ('Mode_9_30fps', 'Mode_5_30fps', {}, 'Mode_9_30fps'),
        ('Mode_5_30fps', 'Mode_5_60fps', {}, 'Mode_5_30fps'),
        ('Mode_5_30fps', 'Mode_5_30fps', {'ambient_light': {}}, ''),
    ],
)
def test_the_noise_of_another_mode_is_said(tmp_path, real, told, effects, found):
    write_campaign(tmp_path, effects=effects, usecase=real, **{**SIZE, 'seed': 7, 'moving': 1})
    for path in tmp_path.iterdir():
        change(path, usecase=told)
    assert diagnose(tmp_path, **among('excess_noise'))['likelier_mode'] == found
