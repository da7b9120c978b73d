"""Every command and program of the README and of the pages for users does what it says."""

from contextlib import chdir
from pathlib import Path
import re
import shlex
import subprocess
import sys
import tarfile

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording
from made_bags import write
from made_driver_bags import azure_kinect, INFO, pico_flexx, realsense, ros1_bag
from made_images import counts, folder_of, metres, ost, save, SIZE
import numpy as np
from programs import first_line, run_flexx2
import pytest

ROOT = Path(__file__).parent.parent
README = ''.join(
    (ROOT / name).read_text(encoding='utf-8')
    for name in (
        'README.md',
        'docs/characterize.md',
        'docs/diagnosis.md',
        'docs/diagnosis_evidence.md',
        'docs/install.md',
        'docs/nodes.md',
        'docs/recordings.md',
        'docs/view.md',
    )
)
EXECUTABLES = {
    'flexx2_camera': 'flexx2_sim_ros.nodes.flexx2_camera',
    'go1_cameras': 'flexx2_sim_ros.nodes.go1_cameras',
}
# Run by the tests named here instead.
ELSEWHERE = {
    'colcon build': 'test_package.py',
    'rosdep install --from-paths . --ignore-src --rosdistro jazzy -y': (
        'a ROS installation, which has rosdep'
    ),
    'make shell': 'test_checkout.py',
    "pip install --break-system-packages mujoco rosbags 'numba>=0.59'": 'a machine of its own',
    'ros2 run flexx2_sim_ros flexx2 modes': 'test_package.py',
    'source install/setup.bash': 'test_package.py',
    'flexx2 record walk --seconds 10': 'test_record.py',
    "flexx2 replay walk --rate 0.5 --topics '*/clean/*'": 'test_replay.py',
    'flexx2 convert walk walk.npz --camera front_left': 'test_bags.py',
    'flexx2 compile': 'test_compile_command.py',
    'ros2 launch flexx2_sim_ros go1.launch.py rviz:=true': 'test_drop_in.py',
    'ros2 launch flexx2_sim_ros flexx2_driver.launch.py': 'test_drop_in.py',
    'flexx2 view --demo': 'test_view.py',
    'flexx2 view out.npz': 'test_view_recording.py',
    'flexx2 view recordings': 'test_view_recording.py',
    'flexx2 view diagnosis recordings': 'test_view_recording.py',
    'flexx2 view recordings --planes planes.yaml': 'test_view_playback.py',
    'flexx2 gap benchmark --quick --out benchmark': 'test_gap_benchmark.py',
    'flexx2 characterize capture campaign': 'test_characterize_capture.py',
    'flexx2 characterize fit campaign --out result': 'test_characterize_capture.py',
    'flexx2 simulate scene.npz out.npz --profile result/profile.yaml': 'test_profile.py',
    'ros2 run flexx2_sim_ros flexx2_camera --ros-args -p profile:=result/profile.yaml': (
        'test_profile.py'
    ),
    'flexx2 convert walk.npz walk_sqlite3 --storage sqlite3': 'test_bags.py',
}
# Nodes that other commands here start with these options, and with more.
NODE = 'ros2 run flexx2_sim_ros'
WITH_MORE = (
    f'{NODE} go1_cameras',
    f'{NODE} go1_cameras --ros-args -r __ns:=/left -p frame_prefix:=left/',
    f'{NODE} flexx2_camera --ros-args -r __ns:=/front_left',
    f'{NODE} flexx2_camera --ros-args -r __ns:=/front_right -p usecase:=Mode_5_60fps',
)


def blocks(language):
    return re.findall(rf'```{language}\n(.*?)```', README, re.DOTALL)


for block in blocks('bash'):
    if block.startswith('mkdir recordings'):
        ELSEWHERE |= dict.fromkeys(block.splitlines(), 'test_gap_diagnosis.py')
    if 'chain.yaml' in block:
        ELSEWHERE |= dict.fromkeys(block.splitlines(), 'test_gap_processed.py')
COMMANDS = dict.fromkeys(
    line.split('  #')[0].strip()
    for block in blocks('bash')
    for line in block.splitlines()
    if line.strip()
)


@pytest.fixture(scope='module')
def other_cameras(tmp_path_factory):
    """Write what the page about recordings converts, by its names."""
    folder = tmp_path_factory.mktemp('other_cameras')
    ros1_bag(folder / 'pico_flexx.bag', pico_flexx())
    write(folder / 'realsense_bag', realsense())
    ros1_bag(folder / 'azure_kinect.bag', azure_kinect())
    without = [entry for entry in realsense() if entry[1] != INFO]
    ros1_bag(folder / 'no_camera_info.bag', without)
    folder_of(folder / 'images', ['1.png', '2.png', '3.png'])
    save(folder / 'frame.png', counts()[0])
    save(folder / 'known.png', np.eye(*SIZE, dtype=bool))
    (folder / 'ost.yaml').write_text(ost())
    with tarfile.open(Path(__file__).with_name('lerobot_0_6_1.tar.xz')) as packed:
        packed.extractall(folder, filter='data')
    (folder / 'image').rename(folder / 'lerobot_set')
    np.savez(folder / 'sdk.npz', depth_mm=counts(), ir16=counts() // 2)
    return folder


def python(module):
    return [sys.executable, '-m', module]


@pytest.mark.parametrize('command', [c for c in COMMANDS if c not in (*ELSEWHERE, *WITH_MORE)])
def test_command(command, other_cameras, tmp_path):
    words = shlex.split(command)
    if words[0] == 'make':
        # The target's own recipe is what is run below, as `flexx2 demo`.
        recipe = subprocess.run(
            ['make', '-n', words[1]], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        assert 'flexx2 demo' in recipe
    elif words[:3] == ['ros2', 'run', 'flexx2_sim_ros']:
        pytest.importorskip('rclpy')
        assert '[INFO]' in first_line(python(EXECUTABLES[words[3]]) + words[4:], tmp_path)
    else:
        assert words[0] == 'flexx2'
        if words[1] == 'demo':
            pytest.importorskip('rclpy')
        scene = np.full((172, 224), 1.5)
        camera = np.array([[210.6, 0, 111.5], [0, 212.9, 85.5], [0, 0, 1]])
        np.savez(tmp_path / 'scene.npz', clean_depth=scene, K=camera)
        (tmp_path / 'config').symlink_to(ROOT / 'config')
        if words[1] == 'convert':
            for path in other_cameras.iterdir():
                (tmp_path / path.name).symlink_to(path)
        if words[1] == 'demo':  # It starts ROS, which has been started here.
            done = run_flexx2(*words[1:], '--seconds', '1', cwd=tmp_path)  # the last one counts
            assert done.returncode == 0, done.stderr
        else:
            with chdir(tmp_path):
                assert main(words[1:]) == 0
        if words[1] == 'simulate':
            with np.load(tmp_path / words[3], allow_pickle=False) as recording:
                assert recording['depth'].shape == (300, 172, 224)
                assert recording['usecase'] == 'Mode_9_30fps'
        if words[1] == 'convert':
            found = load_recording(tmp_path / words[3])
            if '--usecase' in words:
                assert found.usecase == words[words.index('--usecase') + 1]
            if words[2] == 'frame.png':
                np.testing.assert_array_equal(found.depth, metres(0.0002)[:1])
                np.testing.assert_array_equal(found.extra['known'], np.eye(*SIZE, dtype=bool))
            else:
                assert 0.3 <= np.nanmin(found.depth) < np.nanmax(found.depth) <= 4
        if words[1] == 'demo':
            assert (tmp_path / 'demo_output' / 'demo.png').read_bytes().startswith(b'\x89PNG')
            for name in ('front_left', 'front_right'):
                rows = re.findall(rf'{name} +(Mode_\w+) +\d+ +([\d.]+) .* ([\d.]+)\n', done.stdout)
                assert [row[0] for row in rows] == ['Mode_5_30fps', 'Mode_5_60fps', 'Mode_9_30fps']
                # Measured against modelled sigma: 30 frames of 20,000 pixels know it to 0.1 %.
                assert [float(row[2]) for row in rows] == pytest.approx([1.0] * 3, abs=0.03)


# test_processing.py runs what needs a chain.
PROGRAMS = [one for one in blocks('python') if 'chain.yaml' not in one]
TESTS = [program for program in PROGRAMS if 'def test_' in program]


@pytest.mark.parametrize('program', [program for program in PROGRAMS if program not in TESTS])
def test_program(program, tmp_path, capsys):
    with chdir(tmp_path):
        exec(compile(program, 'README', 'exec'), {})  # noqa: S102
    if 'print(' in program:
        measured, modelled = map(float, capsys.readouterr().out.split())
        assert measured == pytest.approx(modelled, rel=0.01)


@pytest.mark.parametrize('program', TESTS)
def test_example_of_a_test(program, tmp_path, child_env):
    (tmp_path / 'test_camera.py').write_text(program, encoding='utf-8')
    done = subprocess.run(
        [*python('pytest'), '-q', '-p', 'no:cacheprovider', 'test_camera.py'],
        env=child_env,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert '1 passed' in done.stdout
