"""The diagnosis on real frames of another camera; skipped where they are not."""

from flexx2_sim_ros.gap import diagnose
import kinect_campaign
import pytest
from test_effects_real import needs_kinect, views


@needs_kinect
def test_kinect_frames_saturate(tmp_path):
    # The noise is measured on other views than those diagnosed.
    profile = kinect_campaign.profile(range(1, 102, 4))
    kinect_campaign.write_campaign(tmp_path, range(0, 102, 6))
    table = diagnose(tmp_path, profile=profile, forms='catalogue')
    effects = {row['name']: row['parameters'] for row in table['effects']}
    # Far more is wrong with it than the catalogue knows: its noise is not the Flexx2's.
    assert table['verdict'] == 'partly'
    # Seeds 0 to 2 all name these two; the others change with the seed, and with rounding.
    assert {'saturation', 'amplitude_bias'} <= set(effects)
    # Its depth comes in whole millimetres, where that is named.
    if 'quantisation' in effects:
        assert effects['quantisation']['step'] == pytest.approx(0.001, rel=0.1)
    assert 'pose_error' not in {*effects, *(row['name'] for row in table['alternatives'])}
    # No square darker than saturation loses a pixel: low signal is not what loses them here.
    dark = [(view.white | view.black) & (view.infrared < 30_000) for view in views()]
    assert sum((view.depth[part] <= 0).sum() for view, part in zip(views(), dark, strict=True)) < (
        0.002 * sum(part.sum() for part in dark)
    )
    assert 'low_signal_dropout' not in effects
    low, high = table['gap']['interval']
    assert low <= table['gap']['shrink'] <= high
    assert table['gap']['shrink'] > 0.1
