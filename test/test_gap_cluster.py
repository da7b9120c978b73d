"""The diagnosis on a Dask cluster: a real scheduler, two workers, one of which is killed."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys

from bench.gap_campaigns import write_campaign
from campaigns import all_but
from flexx2_sim_ros import jobs
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import check, diagnose
from programs import ROOT, until
import pytest

distributed = pytest.importorskip('distributed', reason='extra cluster is not installed')
LEFT_OUT = all_but('excess_noise', 'heavy_tails', 'pose_error')


@contextmanager
def process(*arguments):
    """Run a module of distributed as a process; killed at the end."""
    paths = filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])
    started = subprocess.Popen(
        [sys.executable, '-m', *map(str, arguments)],
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield started
    finally:
        if started.poll() is None:
            os.killpg(started.pid, signal.SIGKILL)
        started.wait()


SMALL = {'scale': 0.25, 'frames': 6, 'moving': 0, 'effects': {'excess_noise': {}}}


@pytest.fixture(scope='module')
def campaign(tmp_path_factory):
    """Return a folder of four small recordings with too much noise."""
    folder = tmp_path_factory.mktemp('cluster') / 'campaign'
    write_campaign(folder, seed=12, recordings=4, **SMALL)
    return folder


@contextmanager
def scheduler(folder):
    """Run a scheduler that writes its address to ``scheduler.json`` in a folder; return both."""
    ready = folder / 'scheduler.json'
    options = '--host', '127.0.0.1', '--port', '0', '--no-dashboard', '--scheduler-file', ready
    with process('distributed.cli.dask_scheduler', *options) as started:
        until(lambda: ready.exists() and ready.read_text().rstrip().endswith('}'))
        yield started, json.loads(ready.read_text())['address']


def worker(folder):
    """Run a worker of the scheduler whose address is in a folder."""
    options = '--scheduler-file', folder / 'scheduler.json', '--local-directory', folder
    return process(
        'distributed.cli.dask_worker', *options, '--nthreads', '1', '--no-nanny', '--no-dashboard'
    )


def test_what_a_cluster_lacks_or_loses(campaign, tmp_path, monkeypatch):
    lost = []

    def lose(process):
        lost.clear()

        def progress(_text, share):
            # After the first recording, while others are being worked on.
            if share > 0.1 and not lost:
                lost.append(share)
                os.killpg(process.pid, signal.SIGKILL)

        return progress

    # The workers know the campaign only by a path that this process's folder explains.
    monkeypatch.chdir(campaign.parent)
    local = diagnose(campaign, out=tmp_path / 'diagnosis', without=LEFT_OUT)
    fresh = campaign.parent / 'fresh'
    write_campaign(fresh, seed=13, recordings=2, **SMALL)
    checked = check(tmp_path / 'diagnosis', fresh)
    with scheduler(tmp_path) as (leader, address):
        with monkeypatch.context() as patch:
            patch.setattr(jobs, '_PATIENCE', 1)
            with pytest.raises(InputError, match='--scheduler: must have at least one worker'):
                diagnose(campaign.name, scheduler=address)
        with worker(tmp_path) as doomed, worker(tmp_path):
            with distributed.Client(address, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=60)
                another = next(iter(client.scheduler_info()['workers']))
            with pytest.raises(InputError, match='--scheduler: .* this is a Worker'):
                diagnose(campaign.name, scheduler=another)
            spread = diagnose(
                campaign.name, scheduler=address, progress=lose(doomed), without=LEFT_OUT
            )
            assert lost[0] < 0.72  # while recordings were still being simulated
            checked_there = check(tmp_path / 'diagnosis', fresh.name, scheduler=address)
            with pytest.raises(InputError, match='--scheduler: .* the connection was lost'):
                diagnose(
                    campaign.name,
                    scheduler=address,
                    progress=lose(leader),
                    out='out',
                    without=LEFT_OUT,
                )
            assert lost
    assert not Path('out').exists() or not list(Path('out').iterdir())
    for table in (local, spread):
        for key in ('seconds', 'peak_mb'):
            del table[key]
    assert spread == local
    del checked['seconds'], checked_there['seconds']
    assert checked_there == checked


@pytest.mark.parametrize(
    'address', ['', 'nonsense', 'no://such', 'tcp://127.0.0.1:99999999', 'tcp://127.0.0.1:9']
)
def test_a_missing_scheduler_is_reported(campaign, monkeypatch, address):
    monkeypatch.setattr(jobs, '_CONNECT_SECONDS', 0.5)
    with pytest.raises(InputError, match='--scheduler: must be the address of a running'):
        diagnose(campaign, scheduler=address)


@pytest.mark.parametrize(
    ('greeting', 'seconds', 'said'),
    [(b'SSH-2.0-OpenSSH_9.2\r\n', 10.0, 'no scheduler'), (b'', 0.5, 'it does not answer')],
)
def test_another_program_is_reported(campaign, monkeypatch, greeting, seconds, said):
    monkeypatch.setattr(jobs, '_CONNECT_SECONDS', seconds)
    with socket.create_server(('127.0.0.1', 0)) as other, ThreadPoolExecutor(1) as thread:

        def greet():
            connection, _ = other.accept()
            connection.sendall(greeting)
            return connection

        kept = thread.submit(greet)  # Closed by nobody else.
        with pytest.raises(InputError, match=f'--scheduler: .* {said}'):
            diagnose(campaign, scheduler=f'127.0.0.1:{other.getsockname()[1]}')
        kept.result().close()
