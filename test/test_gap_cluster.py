"""The diagnosis on a Dask cluster: a real scheduler, two workers, one of which is killed."""

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from bench.gap_campaigns import write_campaign
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose, work
import pytest

distributed = pytest.importorskip('distributed', reason='extra cluster is not installed')
ROOT = Path(__file__).resolve().parents[1]


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a module of distributed as a process; killed at the end."""
    environment = {
        **os.environ,
        'PYTHONPATH': os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])),
    }
    started = subprocess.Popen(
        [sys.executable, '-m', *arguments],
        env=environment,
        text=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        yield started
    finally:
        if started.poll() is None:
            os.killpg(started.pid, signal.SIGKILL)
        started.wait()
        assert started.stderr is not None
        started.stderr.close()


def wait_for(condition, seconds: float = 60.0) -> None:  # type: ignore[no-untyped-def]
    """Poll until something is true."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        threading.Event().wait(0.05)


def test_a_lost_worker_changes_nothing(tmp_path: Path) -> None:
    campaign = tmp_path / 'campaign'
    write_campaign(
        campaign,
        seed=12,
        scale=0.25,
        recordings=4,
        frames=6,
        moving=0,
        effects={'excess_noise': {}},
    )
    local = diagnose(campaign)
    ready = tmp_path / 'scheduler.json'
    workers = [
        'distributed.cli.dask_worker',
        '--scheduler-file',
        str(ready),
        '--nthreads',
        '1',
        '--no-nanny',
        '--no-dashboard',
        '--local-directory',
        str(tmp_path),
    ]
    with process(
        'distributed.cli.dask_scheduler',
        '--host',
        '127.0.0.1',
        '--port',
        '0',
        '--no-dashboard',
        '--scheduler-file',
        str(ready),
    ):
        wait_for(ready.exists)
        with process(*workers) as doomed, process(*workers):
            with distributed.Client(scheduler_file=str(ready), set_as_default=False) as client:
                client.wait_for_workers(2, timeout=60)
                address = client.scheduler.address
            killed = []

            def kill(text: str, share: float) -> None:
                # After the first recording, while others are being worked on.
                if share > 0.1 and not killed:
                    killed.append(share)
                    os.killpg(doomed.pid, signal.SIGKILL)

            spread = diagnose(campaign, scheduler=address, progress=kill)
    assert killed
    assert killed[0] < 0.72  # while recordings were still being simulated
    for table in (local, spread):
        for key in ('seconds', 'peak_mb'):
            del table[key]
    assert spread == local


def test_a_scheduler_without_workers_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_campaign(tmp_path / 'campaign', seed=13, scale=0.25, recordings=1, frames=4, moving=0)
    ready = tmp_path / 'scheduler.json'
    monkeypatch.setattr(work, '_PATIENCE', 1)
    with process(
        'distributed.cli.dask_scheduler',
        '--host',
        '127.0.0.1',
        '--port',
        '0',
        '--no-dashboard',
        '--scheduler-file',
        str(ready),
    ):
        wait_for(ready.exists)
        address = json.loads(ready.read_text())['address']
        with pytest.raises(InputError, match='--scheduler: must have at least one worker'):
            diagnose(tmp_path / 'campaign', scheduler=address)


def test_a_scheduler_that_ends_midway_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert one sentence and no output; by a path that only this process's folder explains."""
    write_campaign(tmp_path / 'campaign', seed=14, scale=0.25, recordings=4, frames=6, moving=0)
    ready = tmp_path / 'scheduler.json'
    monkeypatch.chdir(tmp_path)
    with process(
        'distributed.cli.dask_scheduler',
        '--host',
        '127.0.0.1',
        '--port',
        '0',
        '--no-dashboard',
        '--scheduler-file',
        str(ready),
    ) as scheduler:
        wait_for(ready.exists)
        address = json.loads(ready.read_text())['address']
        with process(
            'distributed.cli.dask_worker',
            '--scheduler-file',
            str(ready),
            '--nthreads',
            '1',
            '--no-nanny',
            '--no-dashboard',
            '--local-directory',
            str(tmp_path),
        ):
            seen = []

            def kill(text: str, share: float) -> None:
                if share > 0.1 and not seen:
                    seen.append(share)
                    os.killpg(scheduler.pid, signal.SIGKILL)

            with pytest.raises(InputError, match='--scheduler: .* the connection was lost'):
                diagnose('campaign', scheduler=address, progress=kill, out='out')
    assert seen
    assert not list(tmp_path.glob('out/*'))


@pytest.mark.parametrize('address', ['', 'nonsense', 'no://such', 'tcp://127.0.0.1:99999999'])
def test_no_address_is_said(tmp_path: Path, address: str) -> None:
    write_campaign(tmp_path, seed=13, scale=0.25, recordings=1, frames=4, moving=0)
    with pytest.raises(InputError, match='scheduler'):
        diagnose(tmp_path, scheduler=address)


def test_no_scheduler_there_is_said(tmp_path: Path) -> None:
    write_campaign(tmp_path, seed=13, scale=0.25, recordings=1, frames=4, moving=0)
    with pytest.raises(InputError, match='scheduler'):
        diagnose(tmp_path, scheduler='tcp://127.0.0.1:9')
