"""What cannot be used, in every command: one sentence, exit status 2, nothing written."""

import argparse
import json
import os
from pathlib import Path
import subprocess

from flexx2_sim_ros.cli import commands
from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_scene
import numpy as np
from programs import run_flexx2, run_python
import pytest

K = np.array([[52.0, 0.0, 27.5], [0.0, 53.0, 21.0], [0.0, 0.0, 1.0]])
# What each command needs beside the option in question.
NEEDS = {
    'simulate': ['in.npz', 'out.npz'],
    'characterize capture': ['out'],
    'characterize fit': ['campaign'],
    'replay': ['bag'],
    'record': ['out'],
    'convert': ['in.npz', 'out.npz'],
    'gap diagnose': ['campaign', '--out', 'out'],
    'gap check': ['diagnosis', 'fresh'],
    'gap next': ['diagnosis', 'campaign'],
    'gap cost': ['campaign', '--diagnosis', 'diagnosis', '--out', 'out'],
    'gap randomise': ['diagnosis', '--out', 'out.yaml'],
    'gap walk': ['diagnosis', '--out', 'out'],
    'gap truth': ['in.npz', '--scan', 'room.ply', '--out', 'out'],
}
NUMBERS = ['nan', 'inf', '-inf', '-1e30', '1e400', '', 'x', '\udcff', '9' * 5000]


def parsers(parser, name=''):
    """Iterate over all commands, those within others included."""
    groups = [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]
    for group in groups:
        for word, inner in group.choices.items():
            yield from parsers(inner, f'{name} {word}'.strip())
    if not groups:
        yield name, parser


def numeric_options():
    """Return the command, the option and its number of values, for every number there is."""
    return [
        (name, action.option_strings[0], action.nargs if isinstance(action.nargs, int) else 1)
        for name, parser in parsers(commands.make_parser())
        for action in parser._actions
        if action.type not in (None, Path)
    ]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Go to a folder with a scene, a campaign and targets that cannot be."""
    monkeypatch.chdir(tmp_path)
    recording = {'clean_depth': np.full((43, 56), 1.5), 'K': K}
    np.savez('in.npz', **recording)
    Path('campaign').mkdir()
    np.savez(
        'campaign/a.npz',
        **recording,
        usecase='Mode_9_30fps',
        depth=np.full((2, 43, 56), 1.5, np.float32),
        stamp=np.arange(2) / 30,
    )
    Path('loop').symlink_to('loop')
    Path('link.npz').symlink_to('in.npz')
    os.link('in.npz', 'hard.npz')
    Path('file').touch()
    Path('dir').mkdir()
    return tmp_path


def refused(words, capsys):
    """Run a command that has to refuse; return its sentence."""
    before = sorted(Path().rglob('*'))
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.strip().startswith('flexx2: error: ')  # A progress bar ends its line first.
    assert said.strip().count('\n') == 0, said
    assert len(said) < 400  # Long names and values are not repeated.
    assert sorted(Path().rglob('*')) == before
    return said


def test_every_number_is_checked():
    """Assert that the options below are found at all."""
    known = {'--frames', '--seed', '--jobs', '--seconds', '--rate', '--port', '--box'}
    assert known | {'--pose-prior', '--num-envs'} <= {option for _, option, _ in numeric_options()}


@pytest.mark.parametrize(('name', 'option', 'count'), numeric_options())
def test_numbers(folder, capsys, name, option, count):
    for value in NUMBERS:
        words = [*name.split(), *NEEDS.get(name, []), *[f'{option}={value}'] * (count == 1)]
        if count > 1:
            words += [option, *[value] * count]
        assert option in refused(words, capsys)


@pytest.mark.parametrize(
    ('words', 'what'),
    [
        (['simulate', 'in.npz', '{}'], 'npz'),
        (['convert', 'campaign/a.npz', '{}'], 'npz'),
        (['convert', 'campaign/a.npz', '{}'], 'mcap'),
        (['convert', 'campaign/a.npz', '{}'], ''),
        (['effects', 'show', 'offset', '--out', '{}'], 'png'),
        (['batch', '--num-envs', '1', '--out', '{}'], 'png'),
    ],
)
def test_files_to_write(folder, capsys, words, what):
    ending = f'.{what}' if what else ''
    for target in ('missing/a', 'file/a', 'loop', 'loop/a', 'n' * 4000, '/proc/self/a'):
        if target == 'loop' and ending:
            Path(f'loop{ending}').unlink(missing_ok=True)
            Path(f'loop{ending}').symlink_to(f'loop{ending}')
        refused([word.format(target + ending) for word in words], capsys)


@pytest.mark.parametrize(
    'words',
    [
        ['gap', 'diagnose', 'campaign', '--out', '{}'],
        ['characterize', 'capture', '{}'],
        ['characterize', 'fit', 'campaign', '--out', '{}'],
        ['effects', '--write-presets', '{}'],
        ['demo', '--out', '{}'],
        ['record', '{}'],
        ['gap', 'benchmark', '--quick', '--out', '{}'],
    ],
)
def test_folders_to_write(folder, capsys, words):
    for target in ('file', 'file/a', 'loop', 'loop/a', 'n' * 256, '/proc/self/a'):
        refused([word.format(target) for word in words], capsys)


@pytest.mark.parametrize('command', ['simulate', 'convert'])
@pytest.mark.parametrize('target', ['in.npz', './in.npz', 'dir/../in.npz', 'link.npz', 'hard.npz'])
def test_the_output_is_the_input(folder, capsys, command, target):
    before = Path('in.npz').read_bytes()
    assert 'must be another file than the input' in refused([command, 'in.npz', target], capsys)
    assert Path('in.npz').read_bytes() == before


TRUTH = ['gap', 'truth', 'campaign', '--out', 'out', '--jobs', '1']


@pytest.mark.parametrize(
    ('words', 'sentence'),
    [
        (['gap', 'nosuch'], 'COMMAND: must be one of start, diagnose, plan, target, check'),
        (['export', 'nosuch'], "isaac_lab, mujoco_playground, all, got 'nosuch' (see flexx2 exp"),
        (['simulate', 'in.npz', 'out.mcap'], 'OUT.npz: must end in .npz, got out.mcap'),
        (['simulate', 'dir', 'out.npz'], 'dir: must be an .npz archive, got a folder'),
        (['simulate', 'nan.npz', 'out.npz'], 'nan.npz: stamp: must be finite, got NaN or infin'),
        (['simulate', 'in.npz', 'out.npz', '--effects', 'x'], 'x: must be a file, a preset such'),
        (['simulate', 'in.npz', 'out.npz', '--effects', 'n' * 256], 'must be a file, a preset'),
        (
            ['simulate', 'in.npz', 'out.npz', '--effects', 'typical#3'],
            'typical: randomisation: must be in a file of flexx2 gap randomise, got no such file',
        ),
        (['convert', 'campaign/a.npz', 'out.npz', '--camera', 'x'], '--camera: must be left out'),
        (['convert', '/dev/null', 'out'], '.bag file), got something else'),
        (['convert', 'file', 'out'], 'or the folder of a bag, got a file without an ending'),
        (
            ['gap', 'diagnose', 'campaign/a.npz', '--out', 'out'],
            'campaign/a.npz: must be a folder with recordings (.npz or bags), got a file',
        ),
        ([*TRUTH, '--board', 'list.yaml'], 'list.yaml: target: must be a table that is not empty'),
        ([*TRUTH, '--scan', ''], "--scan: must not be empty, got ''"),
        ([*TRUTH, '--scene', 'empty.xml'], 'empty.xml: must have visible geoms, got none'),
    ],
)
def test_what_was_given_is_named(folder, capsys, words, sentence):
    np.savez('nan.npz', clean_depth=np.ones((2, 4, 4)), K=K, stamp=[0.0, np.nan])
    Path('list.yaml').write_text('schema: 1\nplanes: []\n')
    Path('empty.xml').write_text('<mujoco/>')
    assert sentence in refused(words, capsys)


def test_a_scene_in_millimetres_is_noticed(folder, capsys):
    np.savez('mm.npz', clean_depth=np.full((43, 56), 1500.0, np.float32), K=K)
    assert main(['simulate', 'mm.npz', 'out.npz', '--frames', '1']) == 0
    said = ' '.join(capsys.readouterr().err.split())
    assert 'mm.npz: clean_depth: its median is 1500: taken for millimetres' in said
    assert load_scene('out.npz').clean_depth.max() == pytest.approx(1.5)
    np.savez('mm.npz', clean_depth=np.full((43, 56), 1500, np.uint16), K=K)
    assert main(['simulate', 'mm.npz', 'whole.npz', '--frames', '1']) == 2
    assert 'clean_depth: must be metres, got uint16' in ' '.join(capsys.readouterr().err.split())
    assert not Path('whole.npz').exists()


def test_each_command_has_an_example_and_its_help_fits_80_columns(monkeypatch):
    monkeypatch.setenv('COLUMNS', '80')
    for name, parser in parsers(commands.make_parser()):
        text = parser.format_help()
        assert f'flexx2 {name}' in text.partition('example')[2].replace('\n', ' '), name
        # Above the first empty line is the usage: argparse does not break alternatives in it.
        assert max(map(len, text.partition('\n\n')[2].splitlines())) <= 80, name


@pytest.mark.parametrize('words', ['--help', 'gap --help'])
def test_help_loads_no_command_and_lists_all(words):
    program = (
        'import sys; from flexx2_sim_ros.cli import commands\n'
        'try: commands.make_parser(sys.argv[1:]).parse_args(sys.argv[1:])\n'
        'except BaseException as end: print(end)\n'
        "assert not {'numpy', 'numba', 'yaml', 'rich'} & set(sys.modules)"
    )
    done = run_python('-c', program, *words.split(), check=True)
    said = ' '.join(done.stdout.split())
    of_group = commands.COMMANDS if words != 'gap --help' else commands.GAP_COMMANDS
    assert all(name in said for name in of_group), said


# Calls commands one after the other where no file may grow beyond 4 KB; prints how each ended.
SMALL_FILES = """
import contextlib, io, json, resource, sys
from flexx2_sim_ros.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
ends = []
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stderr(io.StringIO()) as said:
        ends.append((main(words), said.getvalue()))
print(json.dumps(ends))
"""


def test_a_file_that_cannot_grow(folder):
    commands = [
        ['simulate', 'in.npz', 'out.npz', '--frames', '9'],
        ['convert', 'campaign/a.npz', 'out.mcap'],
        ['convert', 'campaign/a.npz', 'out.db3'],
        ['convert', 'campaign/a.npz', 'out'],
        ['effects', 'show', 'offset', '--out', 'out.png'],
        ['convert', 'campaign/a.npz', 'out', '--storage', 'sqlite3'],
    ]
    done = run_python('-c', SMALL_FILES, json.dumps(commands), check=True)
    ends = json.loads(done.stdout)
    assert len(ends) == len(commands)
    for words, (status, said) in zip(commands, ends, strict=True):
        lines = [line for line in said.splitlines() if line.strip()]
        assert status == 2, (words, said)
        assert len(lines) == 1, (words, said)
        assert lines[0].startswith('flexx2: error: '), words
    assert done.stderr == ''
    assert not list(Path().glob('out*'))
    assert not list(Path().rglob('.flexx2-*'))


def test_output_that_cannot_be_written():
    with Path('/dev/full').open('wb') as full:
        done = run_flexx2('modes', capture_output=False, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 2
    assert done.stderr == (
        'flexx2: error: standard output: cannot be written: no space left on device\n'
    )


def test_too_many_open_files_are_not_blamed_on_the_output(folder):
    # Pipes need two file descriptors and have no file name; this leaves room for one.
    program = (
        'import os, resource, sys\n'
        'from flexx2_sim_ros.cli import commands\n'
        'from flexx2_sim_ros.cli.main import main\n'
        'def run(argv):\n'
        '    spare = os.dup(0)\n'
        '    resource.setrlimit(resource.RLIMIT_NOFILE, (spare + 1, spare + 1))\n'
        '    return os.pipe()\n'
        'commands.run = run\n'
        "sys.exit(main(['modes']))\n"
    )
    done = run_python('-c', program)
    assert done.returncode == 2
    assert done.stderr == (
        'flexx2: error: the operating system refused a request: too many open files\n'
    )
