"""Work that is shared between this process and others."""

from multiprocessing import parent_process
import os

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.jobs import bind, workers
import pytest


def scaled(number, factor):
    """Return a number times a factor, and the process that computed it."""
    return number * factor, os.getpid()


def dies_elsewhere(number):
    """Return the number here; end any other process."""
    if parent_process() is not None:
        os._exit(3)
    return number


def refuses(number):
    """Refuse one number, in whichever process."""
    if number == 3:
        raise IndexError('3 is refused')
    return number


@pytest.mark.parametrize(('jobs', 'count'), [(1, 3), (2, 1), (2, 6), (3, 0), (4, 2)])
def test_outcomes_are_in_the_order_of_the_items(jobs, count):
    ticks = []
    with workers(jobs, None) as mapped:
        for _ in range(2):  # The processes stay.
            out = mapped(bind(scaled, factor=7), range(count), lambda: ticks.append(1))
            assert [number for number, _ in out] == [7 * i for i in range(count)]
            processes = {process for _, process in out}
            # The first items are for others, the last one is for this process.
            assert len(processes) >= min(jobs, count, 2)
            assert (os.getpid() in processes) == bool(count)
    assert len(ticks) == 2 * count


def test_a_process_that_dies_is_an_error():
    refused = pytest.raises(InputError, match='--jobs: must be fewer, got 3')
    with refused, workers(3, None) as mapped:
        mapped(dies_elsewhere, range(8), lambda: None)


@pytest.mark.parametrize('count', [4, 8])
def test_an_error_is_that_of_the_function(count):
    with pytest.raises(IndexError, match='3 is refused'), workers(2, None) as mapped:
        mapped(refuses, range(count), lambda: None)
