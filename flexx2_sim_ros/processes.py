"""
Processes that a command starts: workers and nodes.

They end when the command ends, even after a crash: each has one end of a pipe whose other end only
the command has.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
import multiprocessing
from multiprocessing import connection
import os
import signal
import sys
import threading
import time
from typing import Any

from flexx2_sim_ros.errors import InputError, MachineError
from flexx2_sim_ros.signals import before_leaving, exit_status, leave, leave_on_signals, SIGNALS

_THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS')
_NO_WARNING = 'ignore:resource_tracker:UserWarning'
_GRACE_SECONDS = 5.0
# Environment variable of a process whose standard input is a pipe from its parent.
_WATCH = 'FLEXX2_ENDS_WITH_STDIN'

Submit = Callable[[Callable[[Any], Any], Sequence[Any]], list['Future[Any]']]


def available_cores() -> int:
    """Return how many cores this process may use, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0))


def watched_environment() -> dict[str, str]:
    """Return the environment for a child that ends when its standard input does."""
    return {**os.environ, _WATCH: '1'}


def end_with_parent() -> None:
    """End this process as SIGTERM does, when its parent has ended."""
    # Processes that this one starts must not inherit it.
    if os.environ.pop(_WATCH, None):
        threading.Thread(target=_watch_stdin, name='parent watch', daemon=True).start()


def _watch_stdin() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_SECONDS)
    leave(exit_status(signal.SIGTERM))


@contextmanager
def workers(count: int, one_thread: bool = False, besides: int = 0) -> Iterator[Submit]:
    """
    Run at most `count` processes that end with the block and with this process.

    Yielded is a function that submits a function for each of some items, and returns the futures.
    With ``one_thread``, numeric libraries in a worker use one thread only. ``besides`` is how many
    jobs this process does itself, for the error. Raises MachineError when a worker ends before its
    work does.
    """
    if sys.platform != 'win32':
        _start_resource_tracker()  # Started here, because a later start would not block signals.
    # Spawned, not forked: this process has threads, whose locks would stay locked.
    context = multiprocessing.get_context('spawn')
    pool = ProcessPoolExecutor(
        count, mp_context=context, initializer=_begin_worker, initargs=(one_thread,)
    )

    def submit(function: Callable[[Any], Any], items: Sequence[Any]) -> list['Future[Any]']:
        with _signals_later():
            return [pool.submit(function, item) for item in items]

    try:
        yield submit
    except BrokenProcessPool as error:
        raise MachineError(
            f'--jobs: must be fewer, got {count + besides}, of which a process ended before its '
            "work did: out of memory? (In a script, jobs need `if __name__ == '__main__':`.)"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def in_processes(work: Callable[[Any], Any], tasks: Sequence[Any], count: int) -> Iterator[Any]:
    """Yield what work returns of each task, or its `InputError`, as they end."""

    def outcome(do: Callable[[], Any]) -> Any:
        try:
            return do()
        except InputError as error:
            return error

    if count <= 1 or len(tasks) <= 1:
        yield from (outcome(partial(work, task)) for task in tasks)
        return
    with workers(min(count, len(tasks))) as submit:
        for future in as_completed(submit(work, tasks)):
            yield outcome(future.result)


@contextmanager
def server(function: Callable[..., None], *arguments: Any) -> Iterator[connection.Connection]:
    """
    Run a function in a process that is killed at the end of the block, whatever it does then.

    What it has started is killed with it, and also when this process ends. The function is one of
    a module, called with its end of a pipe and the arguments, which must be picklable. This end of
    the pipe is yielded.
    """
    if sys.platform != 'win32':
        _start_resource_tracker()
    context = multiprocessing.get_context('spawn')
    own, its = context.Pipe()
    process = context.Process(target=_begin_server, args=(function, its, arguments), daemon=True)
    with _signals_later():
        process.start()
    its.close()
    try:
        yield own
    finally:
        own.close()
        if sys.platform != 'win32' and process.pid is not None:
            with suppress(ProcessLookupError):  # It may not lead its group yet.
                os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.join()


def _begin_server(
    function: Callable[..., None], its: connection.Connection, arguments: tuple[Any, ...]
) -> None:
    if sys.platform != 'win32':
        os.setsid()
        before_leaving(lambda: os.killpg(0, signal.SIGKILL))  # this process with its children
    _begin_worker(True)
    function(its, *arguments)
    leave(0)


@contextmanager
def _signals_later() -> Iterator[None]:
    # Workers start inside this block with signals blocked until they can handle them.
    if sys.platform == 'win32':
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_resource_tracker() -> None:
    # It frees the semaphores of a terminated process, which needs no warning.
    from multiprocessing import resource_tracker

    before = os.environ.get('PYTHONWARNINGS')
    os.environ['PYTHONWARNINGS'] = ','.join(filter(None, [before, _NO_WARNING]))
    try:
        resource_tracker.ensure_running()
    finally:
        if before is None:
            del os.environ['PYTHONWARNINGS']
        else:
            os.environ['PYTHONWARNINGS'] = before


def _begin_worker(one_thread: bool) -> None:
    # The parent handles Ctrl-C of the terminal.
    leave_on_signals()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != 'win32':
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    threading.Thread(target=_watch_parent, name='parent watch', daemon=True).start()
    if one_thread:
        os.environ.update(dict.fromkeys(_THREADS, '1'))


def _watch_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    leave(exit_status(signal.SIGTERM))
