"""Spread independent work over processes, each on one core."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from typing import TypeVar

from flexx2_sim_ros import processes
from flexx2_sim_ros.errors import InputError

Task = TypeVar('Task')
Result = TypeVar('Result')


def in_processes(
    work: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[Result | InputError]:
    """
    Do tasks in processes; in this one when there is only one worker.

    Parameters
    ----------
    work : callable
        A module's function.
    tasks : sequence
        What to call it with, one each.
    workers : int
        How many processes.

    Yields
    ------
    Result or InputError
        What it returned, or the `InputError` that it raised, in the order in which tasks end.

    """
    if workers <= 1 or len(tasks) <= 1:
        for task in tasks:
            try:
                yield work(task)
            except InputError as error:
                yield error
        return
    with processes.workers(min(workers, len(tasks))) as submit:
        for future in as_completed(submit(work, tasks)):
            try:
                yield future.result()
            except InputError as error:
                yield error
