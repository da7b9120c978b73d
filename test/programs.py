"""Programs of this checkout, as tests run them: in this process or in one of their own."""

import json
from pathlib import Path
import shlex
import signal
import subprocess
import sys

from flexx2_sim_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 60.0


def run_python(*words, **more):
    """Run Python with these arguments, and return what it said."""
    usual = {'capture_output': True, 'text': True, 'timeout': 300, 'check': False}
    return subprocess.run([sys.executable, *map(str, words)], **{**usual, **more})


def run_flexx2(*words, **more):
    """Run the command `flexx2`, and return what it said."""
    return run_python('-m', 'flexx2_sim_ros.cli.main', *words, **more)


def call_flexx2(words):
    """Run the command `flexx2` in this process; it has to succeed."""
    assert main(shlex.split(words)) == 0, words


def node_words(name, *words):
    """Return the command that runs a node with these arguments of ROS."""
    return [sys.executable, '-m', f'flexx2_sim_ros.nodes.{name}', '--ros-args', *map(str, words)]


def run_node(name, *words, **more):
    """Run a node that ends by itself, and return what it said."""
    return run_python(*node_words(name, *words)[1:], **more)


def measured(call, env):
    """Return what a measurement of `bench` returns; `call` is Python: 'bench.soak.run()'."""
    module = call.partition('(')[0].rpartition('.')[0]
    code = f'import json; from pathlib import Path; import {module}; print(json.dumps({call}))'
    done = run_python('-c', code, env=env, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def first_line(command, cwd=ROOT):
    """Return the first line that a node logs; assert that it ends quietly on Ctrl-C."""
    with subprocess.Popen(command, cwd=cwd, stderr=subprocess.PIPE, text=True) as process:
        line = process.stderr.readline()
        while 'compiling the camera' in line:  # once, where nothing is compiled yet
            line = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(PATIENCE) == 0, line + rest
    assert 'Traceback' not in rest
    return line
