"""The diagnosis on real frames of another camera; skipped where they are not."""

from pathlib import Path

from flexx2_sim_ros.gap import diagnose
import kinect_campaign


def test_kinect_frames_saturate_lose_dark_squares_and_are_filtered(tmp_path: Path) -> None:
    # The noise is measured on other views than those diagnosed.
    profile = kinect_campaign.profile(range(1, 102, 4))
    kinect_campaign.write_campaign(tmp_path, range(0, 102, 6))
    table = diagnose(tmp_path, profile=profile, jobs=2)
    named = {row['name'] for row in table['effects'] + table['alternatives']}
    print(table['verdict'], named, [(r['name'], r['share']) for r in table['effects']])
    assert table['verdict'] in ('identified', 'partly')
    assert 'pose_error' not in named
