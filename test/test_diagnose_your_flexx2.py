"""Every command of the page "Diagnose your Flexx2", in its order, on a stand-in of a camera."""

import json
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys

from campaigns import shorter, TWO_WALLS
from flexx2_sim_ros.cli.commands import make_parser
from flexx2_sim_ros.cli.main import main
import numpy as np
from programs import first_line
import pytest
from stand_in import DRIVER
from study.blind.meshes import write_mesh
from study.blind.scanned import ScannedCamera

pytestmark = pytest.mark.usefixtures('ros')

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / 'docs' / 'diagnose_your_flexx2.md').read_text(encoding='utf-8')
PAGE = PAGE.split('\n## The plan\n')[0]


def lines(language):
    """Return the lines of the page's boxes in a language."""
    boxes = re.findall(rf'```{language}\n(.*?)```', PAGE, re.DOTALL)
    return [line for box in boxes for line in box.splitlines()]


COMMANDS = lines('bash')
# Views of a folder that are recorded over topics, by the name of the bag; the other views are
# written as bags.
PLACES = {'recordings/corner': range(3), 'fresh/window': range(3, 4)}


@pytest.fixture(scope='module')
def views(tmp_path_factory):
    """Write what a camera with a temporal filter sees in four places, and the room's scan."""
    folder = tmp_path_factory.mktemp('views')
    camera = ScannedCamera(5, {'temporal_filter': 1.0}, 4, 8, width=112, height=86)
    camera.record(folder)
    for path in folder.glob('*.npz'):
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in ('depth', 'K', 'stamp', 'usecase')}
            gray = np.clip(archive['amplitude'], 0, 255).astype(np.uint8)
        np.savez(path, **arrays, amplitude=np.broadcast_to(gray, arrays['depth'].shape))
    write_mesh(camera.solids, folder / 'room.ply')
    return folder


def record(words, views, env):
    """Run the command while the stand-in publishes one view; write the other bags."""
    first, *others = PLACES[words[1]]
    env = env | {'COLUMNS': '200'}  # so that no topic's name is folded
    stand_in = [sys.executable, str(ROOT / 'test' / 'stand_in.py'), str(views / f'{first}.npz')]
    with subprocess.Popen(stand_in, env=env) as driver:
        flexx2 = [sys.executable, '-m', 'flexx2_sim_ros.cli.main']
        try:
            done = subprocess.run(
                [*flexx2, *words],
                env=env,
                capture_output=True,
                text=True,
                timeout=120,
                check=False,
            )
        finally:
            driver.terminate()  # It would wait for a subscriber for ever.
    assert done.returncode == 0, done.stderr
    for topic in ('depth_image_0', 'gray_image_0', 'camera_info'):
        assert f'/{DRIVER}/{topic}' in done.stdout
    assert '0 messages lost' in done.stdout
    for number in others:
        bag = Path(words[1]).with_name(f'view{number}')
        assert main(['convert', str(views / f'{number}.npz'), str(bag), '--camera', DRIVER]) == 0


def test_every_command_leads_to_the_next(views, tmp_path, monkeypatch, child_env):
    monkeypatch.chdir(tmp_path)
    shutil.copy(views / 'room.ply', tmp_path)
    Path('plan.yaml').write_text(TWO_WALLS)
    for command in COMMANDS:
        program, *words = shlex.split(command)
        if program == 'mkdir':
            Path(*words).mkdir()
        elif words[0] == 'record':
            record(words, views, child_env)
        elif program == 'flexx2':
            assert main(shorter(words)) == 0, command
        else:
            assert program == 'flexx2_camera'
            node = [sys.executable, '-m', 'flexx2_sim_ros.nodes.flexx2_camera', *words]
            assert '[INFO]' in first_line(node, tmp_path)
    table = json.loads((tmp_path / 'diagnosis' / 'diagnosis.json').read_text())
    assert [row['name'] for row in table['effects']] == ['temporal_filter']
    assert json.loads((tmp_path / 'diagnosis' / 'check.json').read_text())['holds']
    for page in ('plan/plan.html', 'campaign/truth.html', 'diagnosis/report.html'):
        assert (tmp_path / page).is_file()
    with np.load(tmp_path / 'simulated.npz', allow_pickle=False) as simulated:
        assert 'temporal_filter' in str(simulated['effects'])


def test_the_commands_for_another_camera_exist():
    parser = make_parser()
    commands = [shlex.split(line)[1:] for line in lines('text') if line.startswith('flexx2 ')]
    profiles = [parser.parse_args(words).profile for words in commands]
    assert profiles == ['my_camera.yaml'] * 7
