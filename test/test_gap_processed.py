"""The gap after a robot's own processing, from files to files."""

from contextlib import chdir
import json
from pathlib import Path
import re

from bench.gap_campaigns import write_campaign
from campaigns import leaving, read_all
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.gap.features.confirm import apart
from flexx2_sim_ros.gap.features.processed import process_both
from flexx2_sim_ros.gap.features.simulation import PlacedScene
from flexx2_sim_ros.gap.report.sizes import processed_in_short
from flexx2_sim_ros.processing import parse_chain
import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'recordings.md'
TEXT = PAGE.read_text().split('## Your own processing')[1].split('\n## ')[0]
EFFECTS = {'offset': {'bias': 0.02}, 'grazing_dropout': {}}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('processed')
    size = {'seed': 104, 'recordings': 3, 'frames': 6, 'scale': 0.5, 'moving': 1}
    write_campaign(folder / 'recordings', effects=EFFECTS, **size)
    return folder


def diagnose(folder, stages, *more):
    """Run the command of the documentation in a folder, and return ``diagnosis.json``."""
    (command,) = re.findall(r'\n(flexx2 gap diagnose .*)\n', TEXT)
    (folder / 'chain.yaml').write_text(stages)
    with chdir(folder):
        assert main([*command.split()[1:], '--jobs', '1', *more]) == 0
    return json.loads((folder / 'diagnosis/diagnosis.json').read_text())


def test_without_stages_it_is_the_gap_of_the_recordings(folder):
    for recording in read_all(folder / 'recordings'):
        for motion in (np.zeros(6), np.array([0.004, -0.003, 0.01, 0.2, 0.1, -0.1])):
            scene = PlacedScene.at(recording, motion)
            found = process_both(scene, EFFECTS, [], 3)
            wanted = apart(scene, EFFECTS, 3)
            for unit, values in wanted.physical.items():
                assert found.apart.physical[unit] == values
            assert set(found.parts) == set(EFFECTS)
            whole = found.apart.far(0) - found.apart.far(1)
            np.testing.assert_allclose(sum(found.parts.values()), whole, atol=1e-9)


def test_a_diagnosis_says_what_is_left_after_processing(folder, capsys):
    """Assert that filled pixels are no gap anymore, and the offset is, as large as it was."""
    (chain,) = re.findall(r'```yaml\n(.*?)```', TEXT, re.S)
    table = diagnose(folder, chain, '--pose-prior', '0.002', '0.125', *leaving(*EFFECTS))
    own = table['processed']
    stages = 'crop decimate median spatial smooth fill fill resize clip'
    assert own['stages'] == stages.split()
    assert own['not_measured'] == ['normalise', 'rate', 'delay']
    assert table['gap']['invalid_rate']['before'] > 0.02
    assert own['invalid_rate']['before'] == 0
    assert own['wasserstein_mm']['after'] < 0.25 * own['wasserstein_mm']['before']
    taken = own['effects']['offset']['mm']
    assert taken['mean'] > 0.5 * own['wasserstein_mm']['before']
    assert taken['interval'][0] <= taken['mean'] <= taken['interval'][1]
    line = processed_in_short(table)
    assert line in ' '.join(capsys.readouterr().err.split())
    assert line.startswith(
        f'After your processing ({stages.replace(" ", ", ")}, before normalise)'
    )
    assert 'because of offset, which takes off' in line
    page = (folder / 'diagnosis/report.html').read_text()
    assert 'After your own processing' in page
    assert line in page


def test_recordings_that_are_processed_are_diagnosed_as_they_are(folder, tmp_path, capsys):
    (tmp_path / 'recordings').mkdir()
    stages = '{schema: 1, process: [{crop: {left: 4}}, median]}'
    (tmp_path / 'chain.yaml').write_text(stages)
    for path in (folder / 'recordings').iterdir():
        target = tmp_path / 'recordings' / path.name
        words = [str(path), str(target), '--process', str(tmp_path / 'chain.yaml')]
        assert main(['convert', *words]) == 0
    table = diagnose(tmp_path, stages, *leaving())
    assert table['processed'] == {
        'reason': 'the recordings are processed already, and diagnosed as they are'
    }
    said = ' '.join(capsys.readouterr().err.split())
    assert 'depth: processed by crop, median (flexx2 convert)' in said
    assert 'do not process its simulation again' in said
    assert f'not measured: {table["processed"]["reason"]}.' in said


def test_images_that_are_too_small_are_no_reason_to_fail(folder):
    stages = '{schema: 1, process: [{crop: {left: 500}}]}'
    table = diagnose(folder, stages, *leaving())
    assert 'crop: must leave pixels' in table['processed']['reason']
    (recording, *_) = read_all(folder / 'recordings')
    tiny = parse_chain([{'resize': {'width': 2, 'height': 2}}]).stages
    why = process_both(PlacedScene.at(recording, np.zeros(6)), {}, tiny, 0)
    assert 'process: must leave more than 50 depths' in why
