"""Map a function over items: here, in local processes or on a Dask cluster."""

import asyncio
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any

from flexx2_sim_ros import processes
from flexx2_sim_ros.errors import InputError, MachineError
from threadpoolctl import threadpool_limits

_CONNECT_SECONDS = 10.0
_PATIENCE = 30  # seconds
Map = Callable[[Callable[[Any], Any], Sequence[Any], Callable[[], None]], list[Any]]


@contextmanager
def workers(jobs: int, scheduler: str | None) -> Iterator[Map]:
    """
    Yield a function that maps a function over items, in order.

    Each local process, this one included, uses one thread for linear algebra: the matrices are
    small, and threads of several processes would wait for each other. This process is one of the
    local ``jobs``, and works while the others start. ``scheduler`` is the address of a Dask
    scheduler, whose workers read the recordings by the same paths. Raises InputError when it
    cannot be reached or Dask is not installed.
    """
    if scheduler is not None:
        with _dask(scheduler) as mapped:
            yield mapped
    elif jobs > 1:
        with (
            threadpool_limits(1, 'blas'),
            processes.workers(jobs - 1, one_thread=True, besides=1) as submit,
        ):
            yield partial(_shared, submit, jobs - 1)
    else:
        with threadpool_limits(1, 'blas'):
            yield here


def here(
    function: Callable[[Any], Any], items: Sequence[Any], tick: Callable[[], None]
) -> list[Any]:
    """Map a function over items in this process."""
    out = []
    for item in items:
        out.append(function(item))
        tick()
    return out


def _shared(
    submit: processes.Submit,
    others: int,
    function: Callable[[Any], Any],
    items: Sequence[Any],
    tick: Callable[[], None],
) -> list[Any]:
    # This process takes items from the end, each of the others has a thread that hands it items
    # from the beginning, one at a time: a pool of processes would take some ahead.
    left = deque(enumerate(items))
    done: SimpleQueue[tuple[int, Future[Any]]] = SimpleQueue()

    def hand_over() -> None:
        while left:
            try:
                place, item = left.popleft()
            except IndexError:  # Another thread took the last one.
                return
            try:
                (future,) = submit(function, [item])
                wait([future])
            except RuntimeError as error:  # A process has died, or the work was given up.
                future = Future()
                future.set_exception(error)
            done.put((place, future))

    for _ in range(min(others, len(items) - 1)):
        Thread(target=hand_over, name='hands over items', daemon=True).start()
    out: dict[int, Any] = {}
    try:
        while len(out) < len(items):
            if left and done.empty():
                try:
                    place, item = left.pop()
                except IndexError:
                    continue
                out[place] = function(item)
            else:
                place, future = done.get()
                out[place] = future.result()
            tick()
    finally:
        left.clear()
    return [out[place] for place in range(len(items))]


@contextmanager
def _dask(address: str) -> Iterator[Map]:
    try:
        import distributed  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError as error:
        raise InputError(
            '--scheduler: must have Dask installed, got none: pip install flexx2_sim_ros[cluster]'
        ) from error

    async def ask() -> None:
        security = distributed.Security().get_connection_args('client')
        try:
            async with (
                asyncio.timeout(_CONNECT_SECONDS),
                distributed.rpc(address, connection_args=security) as scheduler,
            ):
                kind = (await scheduler.identity())['type']
        except OSError:
            raise
        except Exception as error:  # Another program's answer can mean anything: 10^18 bytes.
            raise ValueError(f'it is no scheduler ({type(error).__name__})') from error
        if not str(kind).endswith('Scheduler'):
            raise ValueError(f'this is a {kind}')

    try:
        # A Client that finds no scheduler is left half made. When it is collected, it waits for a
        # lock that the next Client may hold: for ever. So ask first, in an event loop of its own.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, ask()).result()
        client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, OverflowError) as error:
        raise InputError(
            f'--scheduler: must be the address of a running scheduler, got {address!r}: '
            f'{str(error) or "it does not answer"}'
        ) from error
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        client.close()
        raise InputError(
            f'--scheduler: must have at least one worker, got none at {address!r} after '
            f'{_PATIENCE} s'
        ) from error

    def run(
        function: Callable[[Any], Any], items: Sequence[Any], tick: Callable[[], None]
    ) -> list[Any]:
        # Pure: what was lost with a worker is done again, with the same outcome.
        with client.as_current():
            futures = client.map(function, list(items), pure=False, retries=3)
            for _ in distributed.as_completed(futures):
                tick()
            return list(client.gather(futures))

    try:
        yield run
    except distributed.KilledWorker as error:
        raise MachineError(
            f'--scheduler: {address}: its workers were lost again and again: {error}'
        ) from error
    except (CancelledError, RuntimeError, OSError) as error:
        # Whatever breaks on the way when the scheduler goes, the client is then not connected.
        if client.status == 'running':
            raise
        raise MachineError(
            f'--scheduler: {address}: the connection was lost; nothing was written'
        ) from error
    finally:
        client.close()


def bind(function: Callable[..., Any], **fixed: Any) -> Callable[[Any], Any]:
    """Return a function of one argument that other processes can be sent."""
    return partial(function, **fixed)
