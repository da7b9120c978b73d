"""Programs of this checkout, as tests run them: in this process or in one of their own."""

from contextlib import contextmanager, ExitStack
import json
from pathlib import Path
import shlex
import signal
import subprocess
import sys
import time

from flexx2_sim_ros.cli.main import main
from flexx2_sim_ros.recording import load_recording

ROOT = Path(__file__).resolve().parents[1]
# Far more than anything takes to start or end; a machine may be busy.
PATIENCE = 60.0


def until(condition, what='it'):
    """Wait for what other processes and threads do."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f'{what}: did not come about within {PATIENCE} s'
        time.sleep(0.01)


@contextmanager
def started(command, **more):
    """Run a command as a process, which is over at the end of the block."""
    usual = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'text': True}
    with subprocess.Popen([*map(str, command)], **{**usual, **more}) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def starting(**usual):
    """Yield a function that runs commands as processes, which are over at the end of the block."""
    with ExitStack() as stack:
        yield lambda command, **more: stack.enter_context(started(command, **usual, **more))


def finish(process, number=None, code=0):
    """End a process, if it does not by itself, and return what it printed; all has to be well."""
    if number is not None:
        process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, f'{out}{err}'
    assert 'Traceback' not in f'{out}{err}', f'{out}{err}'
    return out


def run_python(*words, **more):
    """Run Python with these arguments, and return what it said."""
    usual = {'capture_output': True, 'text': True, 'timeout': 300, 'check': False}
    return subprocess.run([sys.executable, *map(str, words)], **{**usual, **more})


def run_flexx2(*words, **more):
    """Run the command `flexx2`, and return what it said."""
    return run_python(*flexx2_words(*words)[1:], **more)


def flexx2_words(*words):
    """Return the command `flexx2` with these arguments."""
    return [sys.executable, '-m', 'flexx2_sim_ros.cli.main', *map(str, words)]


def call_flexx2(words):
    """Run the command `flexx2` in this process; it has to succeed."""
    assert main(shlex.split(words)) == 0, words


def convert(*words):
    """Run the command `flexx2 convert` in this process; return its exit status."""
    return main(['convert', *map(str, words)])


def converted(source, *options):
    """Return the recording that `flexx2 convert` makes of a file, beside it."""
    out = source.parent / f'{source.name}.npz'
    assert convert(source, out, *options) == 0
    return load_recording(out)


def refusal(capsys, *words):
    """Return in one line why `flexx2 convert` refuses."""
    assert convert(*words) == 2
    return ' '.join(capsys.readouterr().err.split())


def node_words(name, *words):
    """Return the command that runs a node with these arguments of ROS."""
    return [sys.executable, '-m', f'flexx2_sim_ros.nodes.{name}', '--ros-args', *map(str, words)]


def measured(call, env):
    """Return what a measurement of `bench` returns; `call` is Python: 'bench.soak.run()'."""
    module = call.partition('(')[0].rpartition('.')[0]
    code = f'import json; from pathlib import Path; import {module}; print(json.dumps({call}))'
    done = run_python('-c', code, env=env, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def first_line(command, cwd=ROOT):
    """Return the first line that a node logs; assert that it ends quietly on Ctrl-C."""
    with started(command, cwd=cwd) as process:
        line = process.stderr.readline()
        while 'compiling the camera' in line:  # once, where nothing is compiled yet
            line = process.stderr.readline()
        finish(process, signal.SIGINT)
    return line
