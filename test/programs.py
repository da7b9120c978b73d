"""Programs of this checkout that tests run as processes of their own."""

from collections.abc import Mapping
import json
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 60.0


def measured(call: str, env: Mapping[str, str]) -> Any:
    """Return what a measurement of `bench` returns; `call` is Python: 'bench.soak.run()'."""
    module = call.partition('(')[0].rpartition('.')[0]
    code = f'import json; from pathlib import Path; import {module}; print(json.dumps({call}))'
    done = subprocess.run(
        [sys.executable, '-c', code],
        env=env,
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def first_line(command: list[str], cwd: Path = ROOT) -> str:
    """Return the first line that a node logs; assert that it ends quietly on Ctrl-C."""
    with subprocess.Popen(command, cwd=cwd, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(PATIENCE) == 0, line + rest
    assert 'Traceback' not in rest
    return line
